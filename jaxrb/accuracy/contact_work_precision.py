"""What accuracy costs where bodies touch: error against CPU time of `solve_contact`, of fixed steps, and of MuJoCo.

The error is the largest of position [m] and attitude [rad] of the worst body at five times of the run, the last of
them its end, against the closed form where there is one, else against `solve_contact` at its least tolerance, which a
run at ten times that confirms. MuJoCo's contact is soft; here it is run as it comes, and made stiffer with the step, so
that it tends to the same law.
"""

import dataclasses
import importlib.util
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.accuracy.contact_scenes import Case, cases_of
from jaxrb.accuracy.mujoco_modules import mujoco_modules
from jaxrb.accuracy.timing import interleaved
from jaxrb.body.state import State
from jaxrb.compilation import compiler_options
from jaxrb.errors import JaxrbError
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Scalar
from jaxrb.scene.adaptive import solve_contact
from jaxrb.scene.scene import Scene

TOLERANCES = tuple(10.0**-k for k in range(2, 11))
FINEST = 1e-11
SAVES = 5
STEPS = tuple(SAVES * n for n in (20, 80, 320, 1280, 5120, 20480))
# A contact of MuJoCo lasts so many steps: shorter ones it cannot resolve.
_CONTACT_STEPS = 20


@dataclasses.dataclass(frozen=True)
class ContactPoint:
    """One way to run a scene: its error (m or rad) and the CPU seconds of a run. `on_front`: nothing cheaper is as
    accurate."""

    scene: str
    who: str
    setting: str
    error: float
    run_seconds: float
    steps: int
    on_front: bool = False


@dataclasses.dataclass(frozen=True)
class ContactWorkPrecision:
    """All points of a scene; `how` the truth is known, and how well (`uncertainty`)."""

    scene: str
    about: str
    how: str
    uncertainty: float
    points: tuple[ContactPoint, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return dataclasses.asdict(self) | {"at_equal_error": self.at_equal_error()}

    def at_equal_error(self) -> list[dict[str, Any]]:
        """For each point of the others, the cheapest run of `solve_contact` that errs no more: its time over theirs."""
        own = [p for p in self.points if p.who == "solve_contact"]
        rows = []
        for other in self.points:
            if other.who in ("solve_contact", "solve_events"):
                continue
            good = [p for p in own if p.error <= max(other.error, self.uncertainty)]
            best = min(good, key=lambda p: p.run_seconds, default=None)
            rows.append(
                {
                    "other": f"{other.who}, {other.setting}",
                    "error": other.error,
                    "solve_contact": "does not arrive" if best is None else best.setting,
                    "time over theirs": None if best is None else best.run_seconds / other.run_seconds,
                }
            )
        return rows


def contact_work_precision(
    names: Sequence[str] = (), progress: Callable[[Sequence[Any]], Iterator[Any]] = iter, quick: bool = False
) -> list[ContactWorkPrecision]:
    """Measure scenes with contact, in float64; by default the ball, the block and the cube. `quick`: fewer points."""
    with jax.enable_x64(True):
        return [_measured(case, quick) for case in progress(cases_of(names))]


def _measured(case: Case, quick: bool) -> ContactWorkPrecision:
    state = case.state()
    times = np.linspace(0.0, case.duration, SAVES + 1)
    truth, how, uncertainty = _truth(case, state, times)
    runs = [*_adaptive(case, state, times, quick), *_fixed(case, state, quick), *_mujoco(case, quick)]
    seconds = interleaved([run for *_, run in runs], rounds=3)
    points = []
    for (who, setting, read, run), spent in zip(runs, seconds, strict=True):
        position, wxyz, steps = read(run())
        error = _error(position, wxyz, truth)
        points.append(ContactPoint(case.name, who, setting, error, spent, steps))
    front = _front(points, uncertainty)
    marked = tuple(dataclasses.replace(p, on_front=i in front) for i, p in enumerate(points))
    return ContactWorkPrecision(case.name, case.about, how, uncertainty, marked)


def _front(points: Sequence[ContactPoint], known: float) -> set[int]:
    front, best = set(), math.inf
    for i in sorted(range(len(points)), key=lambda i: (points[i].run_seconds, points[i].error)):
        error = max(points[i].error, known)
        if error < best:
            front.add(i)
            best = error
    return front


def _truth(case: Case, state: State, times: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], str, float]:
    if case.exact is not None:
        return case.exact(times), "closed form", 1e-14
    fine, coarse = (
        solve_contact(case.scene, state, t1=case.duration, times=times, tolerance=tol)
        for tol in (FINEST, 10 * FINEST)
    )
    truth = _poses(fine.states)
    off = _error(*_poses(coarse.states), truth)
    return truth, f"solve_contact at {FINEST:g}, which {10 * FINEST:g} confirms", off


def _poses(states: State) -> tuple[np.ndarray, np.ndarray]:
    """Positions (k, n, 3) [m] and quaternions (k, n, 4)."""
    return np.asarray(states.position), np.asarray(states.orientation.as_quaternion_array())


def _error(position: np.ndarray, wxyz: np.ndarray, truth: tuple[np.ndarray, np.ndarray]) -> float:
    place, turn = truth
    far = np.linalg.norm(position - place, axis=-1).max()
    # The chord of two quaternions is a quarter of the angle to 1e-16; their product only to 1e-8.
    unit = wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True)
    chord = np.minimum(np.linalg.norm(unit - turn, axis=-1), np.linalg.norm(unit + turn, axis=-1))
    off = float(max(far, (4.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0))).max()))
    return off if np.isfinite(off) else math.inf


def _adaptive(case: Case, state: State, times: np.ndarray, quick: bool) -> Iterator[tuple]:
    for tolerance in TOLERANCES[:: 4 if quick else 1]:

        def run(tolerance: float = tolerance) -> Any:
            return solve_contact(
                case.scene, state, t1=case.duration, times=times, tolerance=tolerance, on_error="flag"
            )

        yield "solve_contact", f"tolerance {tolerance:.0e}", _read_adaptive, run
    if case.events and not quick:
        from jaxrb.scene.events import solve_events

        for dt in (1e-2, 1e-3):

            def run_events(dt: float = dt) -> Any:
                return solve_events(
                    case.scene, state, t1=case.duration, times=times, dt=dt, max_events=128, on_error="flag"
                )

            try:
                run_events()
            except JaxrbError:
                continue
            yield "solve_events", f"dt {dt:g}", _read_path, run_events


def _read_adaptive(path: Any) -> tuple[np.ndarray, np.ndarray, int]:
    return *_poses(path.states), int(path.steps.accepted + path.steps.rejected)


def _read_path(path: Any) -> tuple[np.ndarray, np.ndarray, int]:
    return *_poses(path.states), int(path.events.count)


def _stepped(scene: Scene, state: State, duration: Scalar, stretch: Any) -> State:
    """States (SAVES + 1, …) of a run with `stretch` steps between saves, by the steps of `rollout`."""
    dynamics, method = scene.prepared(state.dtype), RungeKutta4()
    dt = duration / (stretch * SAVES)

    def to_next(carry: Any, _: None) -> Any:
        carry = lax.fori_loop(0, stretch, lambda _, c: method.carried_step(dynamics, c[0], c[1], dt), carry)
        return carry, carry[0]

    start = (state, method.first_carry(dynamics, state))
    _, later = lax.scan(to_next, start, None, length=SAVES)
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), state, later)


def _fixed(case: Case, state: State, quick: bool) -> Iterator[tuple]:
    program = jax.jit(_stepped, compiler_options=compiler_options())
    for steps in STEPS[: 3 if quick else None]:

        def run(steps: int = steps) -> Any:
            return program(case.scene, state, jnp.asarray(case.duration), jnp.asarray(steps // SAVES)), steps

        yield "rollout", f"dt {case.duration / steps:.1e}", lambda r: (*_poses(r[0]), r[1]), run


def _mujoco(case: Case, quick: bool) -> Iterator[tuple]:
    """MuJoCo's own rollout in C on one thread; nothing where it is not installed."""
    if importlib.util.find_spec("mujoco") is None:
        return
    mujoco, threads = mujoco_modules("rollout")
    # 1e5 steps of MuJoCo are as quick as 1e4 of others.
    for steps in (*STEPS[: 3 if quick else None], *(() if quick else (SAVES * 81920,))):
        dt = case.duration / steps
        for who, spring in (("MuJoCo", _solref(case.restitution, dt)), ("MuJoCo, its own spring", None)):
            yield _of_mujoco(mujoco, threads, case, who, spring, steps)


def _of_mujoco(mujoco: Any, threads: Any, case: Case, who: str, spring: Any, steps: int) -> tuple:
    dt = case.duration / steps
    model = mujoco.MjModel.from_xml_string(case.mjcf(dt, spring))
    data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    data.qpos[:], data.qvel[:] = case.start_of_mujoco()
    first = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, first, kind)

    def run(model: Any = model, data: Any = data, first: Any = first, steps: int = steps) -> Any:
        mujoco.mj_resetData(model, data)
        states, _ = threads.rollout(model, data, first[None], nstep=steps)
        return np.concatenate([first[None], np.asarray(states)[0, steps // SAVES - 1 :: steps // SAVES]])

    return who, f"dt {dt:.1e}", lambda rows, n=steps: (rows[:, None, 1:4], rows[:, None, 4:8], n), run


def _solref(restitution: float, dt: float) -> tuple[float, float]:
    """MuJoCo's stiffness and damping (as it wants them, negative) of a contact that lasts `_CONTACT_STEPS` steps and
    gives back that share of the velocity."""
    frequency = math.pi / (_CONTACT_STEPS * dt)
    if restitution <= 0:
        return -(frequency**2), -2.0 * frequency
    loss = -math.log(restitution)
    ratio = loss / math.hypot(math.pi, loss)
    stiffness = frequency**2 / (1.0 - ratio**2)
    return -stiffness, -2.0 * ratio * math.sqrt(stiffness)
