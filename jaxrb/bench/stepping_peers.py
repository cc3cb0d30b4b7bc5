"""Error against CPU time of one body: jaxrb beside MuJoCo's C, diffrax and SciPy in one run.

Two motions: a body that flips about its middle axis, without torque, for 100 s, and a heavy asymmetric top for 20 s.
For every peer that reaches an error, the cheapest run of jaxrb that reaches it too: `ratio` is jaxrb's time over the
peer's. MuJoCo and SciPy run one body at a time, so jaxrb does too; `crowd` is jaxrb's time a body among 1000.

    jaxrb bench --what peers
"""

import dataclasses
import functools
import importlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.mujoco_modules import mujoco_modules
from jaxrb.accuracy.reference import end_state
from jaxrb.bench.adams import GRAVITY, MGR, MOMENTS
from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.effects.custom import CustomForce
from jaxrb.effects.effect import Wrench
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.integrators.three_axis_splitting import ThreeAxisSplitting4
from jaxrb.math.vector import cross
from jaxrb.scene.adams import solve_smooth
from jaxrb.scene.flight import free_flight
from jaxrb.scene.scene import Scene
from jaxrb.scene.solve import solve

CROWD = 1000
REFERENCE_KNOWS = 3e-13  # [rad]: peers' errors below this are not told apart


@dataclasses.dataclass(frozen=True)
class Motion:
    """A motion and its numbers; `moment` is m g r in the body frame [N m], zero for a free body."""

    name: str
    moments: tuple[float, ...]
    spin: tuple[float, ...]
    quaternion: tuple[float, ...]
    moment: tuple[float, ...]
    duration: float

    @property
    def free(self) -> bool:
        """Whether nothing acts."""
        return not any(self.moment)


MOTIONS = (
    Motion(
        "free flip, 100 s", (1.0, 2.0, 3.0), (1e-3, 1.0, 1e-3), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 100.0
    ),
    Motion(
        "heavy top, 20 s",
        tuple(MOMENTS),
        (0.3, -0.2, 2.0),
        (np.sqrt(7 / 8), np.sqrt(1 / 8), 0.0, 0.0),
        tuple(MGR),
        20.0,
    ),
)


@dataclasses.dataclass(frozen=True)
class Run:
    """Something that ends in a unit quaternion (4,) each time it is called."""

    who: str
    setting: str
    call: Callable[[], Any]


def rows(repeats: int = 5) -> Iterator[dict[str, Any]]:
    """One row for each peer and setting, with jaxrb's cheapest at no greater error beside it."""
    with jax.enable_x64(True):
        for motion in MOTIONS:
            exact = _exact(motion)
            own, crowd = (
                [(run, *_timed(run, exact, repeats)) for run in _own(motion, count)] for count in (1, CROWD)
            )
            for run in _peers(motion):
                error, seconds = _timed(run, exact, repeats)
                if not np.isfinite(error) or error > 0.1:
                    continue
                yield _row(motion, run, error, seconds, own, crowd)


def _row(motion: Motion, run: Run, error: float, seconds: float, own: list, crowd: list) -> dict[str, Any]:
    row: dict[str, Any] = {
        "motion": motion.name, "peer": run.who, "setting": run.setting, "error_rad": error, "cpu_us": 1e6 * seconds
    }  # fmt: skip
    for name, runs, count in (("jaxrb", own, 1), ("crowd", crowd, CROWD)):
        good = [entry for entry in runs if entry[1] <= max(error, REFERENCE_KNOWS)]
        best = min(good, key=lambda entry: entry[2], default=None)
        if best is None:
            row |= {f"{name}_run": "does not arrive", f"{name}_us": "", f"{name}_ratio": ""}
            continue
        mine, _, spent = best
        row |= {
            f"{name}_run": f"{mine.who}, {mine.setting}",
            f"{name}_us": 1e6 * spent / count,
            f"{name}_ratio": spent / count / seconds,
        }
    return row


def _timed(run: Run, exact: np.ndarray, repeats: int) -> tuple[float, float]:
    """Attitude error [rad] and median CPU seconds of a call."""
    wxyz = np.asarray(run.call(), float).reshape(-1, 4)[0]
    wxyz = wxyz / np.linalg.norm(wxyz)
    error = float(2 * min(np.linalg.norm(wxyz - exact), np.linalg.norm(wxyz + exact)))
    seconds = []
    for _ in range(repeats):
        before = time.process_time()
        jax.block_until_ready(run.call())
        seconds.append(time.process_time() - before)
    return error, float(np.median(seconds))


def _torque(body: Any, state: Any, moment: Any) -> Wrench:
    up = jnp.asarray([0.0, 0.0, 1.0], state.angular_velocity.dtype)
    return Wrench(torque=cross(state.orientation.unrotate(up), moment))


def scene_of(motion: Motion, count: int) -> tuple[Scene, State]:
    """`count` equal bodies of a motion, at its start."""
    effects = () if motion.free else (CustomForce(_torque, np.asarray(motion.moment)),)
    scene = Scene(replicate(Body(1.0, motion.moments), count), effects)
    start = scene.state(orientation=[motion.quaternion] * count, angular_velocity=[motion.spin] * count)
    return scene, start


def _exact(motion: Motion) -> np.ndarray:
    scene, state = scene_of(motion, 1)
    if motion.free:
        return np.asarray(free_flight(scene, state, motion.duration).orientation.as_quaternion_array()[0])
    path = solve_smooth(scene, state, t1=motion.duration, steps=6000, order=12)
    return np.asarray(path.final.orientation.as_quaternion_array()[0])


def _own(motion: Motion, count: int) -> Iterator[Run]:
    scene, state = scene_of(motion, count)
    if motion.free:
        yield Run(
            "free_flight",
            "",
            lambda: free_flight(scene, state, motion.duration).orientation.as_quaternion_array(),
        )
    method: Method
    for method in (RungeKutta4(), ThreeAxisSplitting4()):
        for steps in (int(motion.duration * rate) for rate in (4, 8, 16, 32, 64, 128, 256, 1024)):
            call = functools.partial(_stepped, scene, state, method, steps, motion.duration)
            yield Run(type(method).__name__, f"{steps} steps", call)
    if not motion.free:
        for order, steps in ((6, 600), (8, 400), (10, 600), (11, 800), (12, 1200), (12, 2000)):
            call = functools.partial(_adams, scene, state, order, steps, motion.duration)
            yield Run("solve_smooth", f"order {order}, {steps} steps", call)


def _stepped(scene: Scene, state: State, method: Method, steps: int, duration: float) -> Any:
    return end_state(
        scene, state, method, jnp.asarray(duration), jnp.asarray(steps)
    ).orientation.as_quaternion_array()


def _adams(scene: Scene, state: State, order: int, steps: int, duration: float) -> Any:
    path = solve_smooth(scene, state, t1=duration, steps=steps, order=order, on_error="flag")
    return path.final.orientation.as_quaternion_array()


def _peers(motion: Motion) -> Iterator[Run]:
    yield from _diffrax(motion)
    for peer, runs in (("scipy", _scipy), ("mujoco", _mujoco)):
        try:
            importlib.import_module(peer)
        except ImportError:
            continue
        yield from runs(motion)


def _diffrax(motion: Motion) -> Iterator[Run]:
    import diffrax

    scene, state = scene_of(motion, 1)
    for solver in (diffrax.Tsit5(), diffrax.Dopri8()):
        for tolerance in (1e-5, 1e-7, 1e-9, 1e-11):

            def call(solver: Any = solver, tolerance: float = tolerance) -> Any:
                path = solve(scene, state, t1=motion.duration, solver=solver, rtol=tolerance, atol=tolerance)
                return path.final.orientation.as_quaternion_array()

            yield Run(f"diffrax {type(solver).__name__}", f"tolerance {tolerance:g}", call)


def _scipy(motion: Motion) -> Iterator[Run]:
    from scipy.integrate import solve_ivp

    i1, i2, i3 = motion.moments
    m1, m2, m3 = motion.moment

    def slope(_: float, y: np.ndarray) -> tuple[float, ...]:
        w, x, y_, z, a, b, c = y.tolist()  # plain numbers: arrays of seven cost twice as much
        u, v, t = 2 * (x * z - w * y_), 2 * (y_ * z + w * x), 1 - 2 * (x * x + y_ * y_)
        return (
            0.5 * (-x * a - y_ * b - z * c), 0.5 * (w * a + y_ * c - z * b), 0.5 * (w * b + z * a - x * c),
            0.5 * (w * c + x * b - y_ * a), ((i2 - i3) * b * c + v * m3 - t * m2) / i1,
            ((i3 - i1) * c * a + t * m1 - u * m3) / i2, ((i1 - i2) * a * b + u * m2 - v * m1) / i3,
        )  # fmt: skip

    start = np.array([*motion.quaternion, *motion.spin])
    for tolerance in (1e-5, 1e-7, 1e-9, 1e-11, 1e-13):

        def call(tolerance: float = tolerance) -> Any:
            path = solve_ivp(slope, (0, motion.duration), start, "DOP853", rtol=tolerance, atol=tolerance)
            return path.y[:4, -1]

        yield Run("SciPy DOP853", f"tolerance {tolerance:g}", call)


_MODEL = """
<mujoco><option timestep="{dt!r}" integrator="RK4" gravity="0 0 -{gravity!r}"/><worldbody><body>
<joint type="ball" damping="0"/><inertial pos="{place}" mass="1" fullinertia="{inertia}"/>
</body></worldbody></mujoco>
"""


def _mujoco(motion: Motion) -> Iterator[Run]:
    mujoco, rollout = mujoco_modules("rollout")
    # Held at a point: r from it to the centre of mass, and the inertia about that. Gravity's torque is z × m g r.
    r = np.asarray(motion.moment) / GRAVITY
    tensor = np.diag(motion.moments) - (r @ r * np.eye(3) - np.outer(r, r))
    six = [tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    for dt in (0.05, 0.02, 0.01, 2e-3, 5e-4):
        model = mujoco.MjModel.from_xml_string(
            _MODEL.format(
                dt=dt, gravity=0.0 if motion.free else GRAVITY, place=" ".join(map(repr, map(float, r))),
                inertia=" ".join(map(repr, map(float, six))),
            )
        )  # fmt: skip
        data = mujoco.MjData(model)
        data.qpos[:4], data.qvel[:3] = motion.quaternion, motion.spin
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        first = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, first, kind)
        steps = round(motion.duration / dt)

        def call(model: Any = model, data: Any = data, first: Any = first, steps: int = steps) -> Any:
            return rollout.rollout(model, data, first[None], nstep=steps)[0][0, -1, 1:5]

        yield Run("MuJoCo RK4", f"dt {dt:g}", call)
