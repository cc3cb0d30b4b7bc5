"""Rows A and B of the scoreboard: bodies in free flight whose exact motion is known, beside what others published."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.reference import closed_form, end_state, reference
from jaxrb.accuracy.timing import compiled
from jaxrb.bench import peers
from jaxrb.bench.published import GAZEBO_BOXES, TUMBLING_BRICK
from jaxrb.bench.timing import both_clocks
from jaxrb.body.state import State
from jaxrb.integrators import METHODS
from jaxrb.integrators.method import Method
from jaxrb.scene.library import Example, gazebo_boxes, gazebo_boxes_simple, tumbling_brick
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

SAMPLES = 10_000  # largest number of states of a run that are compared with the exact motion
RATE_COLUMNS = {
    "body_rate_deg_s": "rate error, largest [deg/s]",
    "body_rate_end_deg_s": "at 30 s [deg/s]",
    "energy": "energy, rel.",
}
BOX_COLUMNS = {"position_m": "position [m]", "angular_momentum": "ang. mom., rel.", "energy": "energy, rel."}

Entry = dict[str, Any]
Judge = Callable[[Any, Any, Any, Any, Any], dict[str, float]]


def tumbling_brick_row() -> Iterator[Entry]:
    """Largest error of the body rates over 30 s [deg/s], at the end too, and of the energy (relative)."""
    example = tumbling_brick()
    moments = np.asarray(example.scene.bodies[0].inertia.moments)

    def judge(times: Any, position: Any, orientation: Any, velocity: Any, omega: Any) -> dict[str, float]:
        exact = _exact(example, times).angular_velocity[:, 0]
        off = np.rad2deg(np.abs(omega - exact))
        turning = 0.5 * (omega**2) @ moments
        return {
            "body_rate_deg_s": float(off.max()),
            "body_rate_end_deg_s": float(off[-1].max()),
            "energy": float(np.abs(turning / turning[0] - 1.0).max()),
        }

    yield from (p.entry() for p in TUMBLING_BRICK)
    yield from _mujoco(example, judge, (0.01,), gravity=0.0)
    yield from _closed_form(example, judge)
    yield from _jaxrb(example, judge, (0.01,), tuple(METHODS))
    yield from _jaxrb(example, judge, (0.1, 0.001), ("RungeKutta4",))


def gazebo_boxes_row() -> Iterator[Entry]:
    """Largest error over 10 s of position [m], and of angular momentum about the centre and energy (both relative)."""
    example = gazebo_boxes()
    yield from (p.entry() for p in GAZEBO_BOXES)
    judge = _box_judge(example, 9.8)
    yield from _mujoco(example, judge, (1e-4, 1e-3), gravity=-9.8, integrators=("RK4",))
    yield from _closed_form(example, judge)
    yield from _jaxrb(example, judge, (1e-4, 1e-3), tuple(METHODS))


def gazebo_boxes_simple_row() -> Iterator[Entry]:
    """The simple case: the same figures; none are carried over from others."""
    example = gazebo_boxes_simple()
    judge = _box_judge(example, 0.0)
    yield from _mujoco(example, judge, (1e-3,), gravity=0.0, integrators=("RK4",))
    yield from _closed_form(example, judge)
    yield from _jaxrb(example, judge, (1e-3,), tuple(METHODS))


def _exact(example: Example, times: np.ndarray) -> Any:
    """Exact states at times (k,), as host arrays with leading axis k."""
    # Always as many times, so that one program serves runs of every step.
    padded = np.concatenate([times, np.zeros(SAMPLES + 1 - len(times))])
    with jax.enable_x64(True):
        flown = _flown(example.scene, example.state(dtype="float64"), padded)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(times)], flown)


@jax.jit
def _flown(scene: Scene, start: State, times: Any) -> State | None:
    return jax.vmap(lambda t: closed_form(scene, start, t))(times)


def _box_judge(example: Example, gravity: float) -> Judge:
    body = example.scene.bodies[0]
    mass, moments = float(body.mass), np.asarray(body.inertia.moments)
    throw = np.asarray(example.start["velocity"])

    def judge(times: Any, position: Any, orientation: Any, velocity: Any, omega: Any) -> dict[str, float]:
        fall = np.array([0.0, 0.0, -gravity])
        exact = throw * times[:, None] + 0.5 * fall * times[:, None] ** 2
        turning = 0.5 * np.sum(moments * omega**2, axis=-1)
        total = 0.5 * mass * np.sum(velocity**2, axis=-1) + turning - mass * position @ fall
        spin = rotated(orientation, moments * omega)
        return {
            "position_m": float(np.linalg.norm(position - exact, axis=-1).max()),
            "angular_momentum": float(
                np.linalg.norm(spin - spin[0], axis=-1).max() / np.linalg.norm(spin[0])
            ),
            "energy": float(np.abs(total / total[0] - 1.0).max()),
        }

    return judge


def rotated(wxyz: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (k, 3) turned by unit quaternions (k, 4), on the host."""
    w, axis = wxyz[:, :1], wxyz[:, 1:]
    across = 2.0 * np.cross(axis, vectors)
    return vectors + w * across + np.cross(axis, across)


def _mujoco(
    example: Example,
    judge: Judge,
    steps_of: Sequence[float],
    gravity: float,
    integrators: Sequence[str] = peers.MUJOCO_INTEGRATORS,
) -> Iterator[Entry]:
    version = peers.mujoco_version()
    if version is None:
        yield {"who": "MuJoCo", "setting": peers.NOT_INSTALLED}
        return
    body = example.scene.bodies[0]
    throw, spin = example.start.get("velocity", (0.0, 0.0, 0.0)), example.start["angular_velocity"]
    for dt in steps_of:
        for integrator in integrators:
            steps = round(example.duration / dt)
            run = peers.mujoco_run(
                float(body.mass), np.asarray(body.inertia.moments), throw, spin,
                dt=dt, steps=steps, integrator=integrator, gravity=gravity,
            )  # fmt: skip
            every = math.ceil(steps / SAMPLES)
            parts = (run.position, run.orientation, run.velocity, run.angular_velocity)
            figures = judge(np.arange(steps + 1)[::every] * dt, *(part[::every] for part in parts))
            costs = {"cpu_s": run.cpu_seconds, "wall_s": run.wall_seconds}
            yield {"who": f"MuJoCo {version} {integrator}", "setting": f"dt {dt:g}, here", **figures, **costs}


def _closed_form(example: Example, judge: Judge) -> Iterator[Entry]:
    """The closed form in the precision of this command. Its rates are judged by Runge–Kutta, not by itself."""
    state = example.state()
    times = np.linspace(0.0, example.duration, SAMPLES + 1)
    flown = _flown(example.scene, state, jnp.asarray(times, state.dtype))
    figures = judge(times, *_host(flown))
    if "body_rate_deg_s" in figures:
        check = reference(example.scene, in_float64_state(example), example.duration)
        known = np.rad2deg(check.uncertainty.attitude)
        figures = {key: max(value, known) if "rate" in key else value for key, value in figures.items()}
    once = jax.jit(lambda state, t: closed_form(example.scene, state, t))
    program, first, _ = compiled(once, state, jnp.asarray(example.duration, state.dtype))
    cpu, wall = both_clocks(lambda: program(state, jnp.asarray(example.duration, state.dtype)))
    yield _entry("closed form", "one call", figures, cpu, wall, first, state)


def in_float64_state(example: Example) -> State:
    """The example's start in float64, whatever JAX's default."""
    with jax.enable_x64(True):
        return example.state(dtype="float64")


def _jaxrb(
    example: Example, judge: Judge, steps_of: Sequence[float], names: Sequence[str]
) -> Iterator[Entry]:
    state = example.state()
    span = jnp.asarray(example.duration, state.dtype)
    for name in names:
        method: Method = METHODS[name]()
        program, first, _ = compiled(end_state, example.scene, state, method, span, jnp.asarray(1))
        for dt in steps_of:
            steps = round(example.duration / dt)
            path = rollout(
                example.scene, state, dt=dt, steps=steps, save_every=math.ceil(steps / SAMPLES), method=method
            )
            figures = judge(np.asarray(path.times, float), *_host(path.states))
            count = jnp.asarray(steps)
            cpu, wall = both_clocks(
                lambda program=program, method=method, count=count: program(
                    example.scene, state, method, span, count
                )
            )
            yield _entry(name, f"dt {dt:g}", figures, cpu, wall, first, state)


def _host(states: State) -> tuple[np.ndarray, ...]:
    """Position, wxyz, velocity and angular velocity of the first body over time, in float64 on the host."""
    parts = (
        states.position,
        states.orientation.as_quaternion_array(),
        states.velocity,
        states.angular_velocity,
    )
    return tuple(np.asarray(part, float)[:, 0] for part in parts)


def _entry(
    name: str, setting: str, figures: dict[str, float], cpu: float, wall: float, first: float, state: State
) -> Entry:
    who = f"jaxrb {name}" if np.dtype(state.dtype) == np.float64 else f"jaxrb {name}, float32"
    return {"who": who, "setting": setting, **figures, "cpu_s": cpu, "wall_s": wall, "compile_cpu_s": first}
