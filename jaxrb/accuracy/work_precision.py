"""What accuracy costs: error against time of every method, step, representation and precision on one scene."""

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.reference import Reference, errors
from jaxrb.accuracy.reference import end_state as end_state
from jaxrb.accuracy.reference import reference as reference_of
from jaxrb.accuracy.timing import compiled, cpu_seconds
from jaxrb.body.state import State
from jaxrb.errors import JaxrbError
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import METHODS
from jaxrb.math.euler_angles import EulerAngles
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.flight import free_flight
from jaxrb.scene.library import Example
from jaxrb.scene.scene import Scene

REPRESENTATIONS: dict[str, type[Rotation]] = {
    "quaternion": Quaternion,
    "matrix": RotationMatrix,
    "euler": EulerAngles,
}
# The coarsest run turns the fastest body by so much a step [rad]; each further one takes a quarter of the step.
COARSEST_TURN = 0.4
SMOOTH_TOLERANCES = {"float64": (1e-4, 1e-7, 1e-10, 1e-12), "float32": (1e-3, 1e-4)}


@dataclasses.dataclass(frozen=True)
class Point:
    """One method at one step: what it costs (CPU seconds of this process; bytes) and what it yields.

    `steps` is 1 for the closed form. `on_front`: no cheaper point is as accurate in attitude. `beyond_reference`: the
    error is below what the reference knows.
    """

    method: str
    representation: str
    steps: int
    dt: float
    attitude_error_rad: float
    run_seconds: float
    compile_seconds: float
    precision: str = "float64"
    position_error_m: float = float("nan")
    energy_error: float = float("nan")
    memory_bytes: int = 0
    on_front: bool = False
    beyond_reference: bool = False

    @property
    def seconds_per_step(self) -> float:
        """CPU time of a step of the whole scene [s]."""
        return self.run_seconds / self.steps

    def row(self) -> dict[str, Any]:
        """The point as plain numbers."""
        return dataclasses.asdict(self) | {"seconds_per_step": self.seconds_per_step}


@dataclasses.dataclass(frozen=True)
class WorkPrecision:
    """All points of a scene, and the reference that judged them."""

    scene: str
    bodies: int
    duration: float
    reference: Reference
    points: tuple[Point, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        about = {"scene": self.scene, "bodies": self.bodies, "duration": self.duration}
        return about | {
            "reference": self.reference.as_dict(),
            "points": [point.row() for point in self.points],
        }


def measure(
    scene: Scene,
    state: State,
    exact: State,
    method: Method,
    duration: float,
    counts: Sequence[int],
    repeats: int = 3,
) -> list[Point]:
    """Errors and CPU time of a method for each number of steps; compilation apart. Runs that end in no number, because
    the step is too large for the method, are left out."""
    span, scene, state = jax.device_put((jnp.asarray(duration, state.dtype), scene, state))
    program, compile_seconds, memory = compiled(end_state, scene, state, method, span, jnp.asarray(1))
    points = []
    for count in counts:
        steps = jnp.asarray(count)
        off = errors(scene, program(scene, state, method, span, steps), exact)
        if not np.isfinite(off.attitude + off.position):
            continue
        points.append(
            Point(
                type(method).__name__,
                state.orientation.name,
                count,
                duration / count,
                off.attitude,
                cpu_seconds(lambda steps=steps: program(scene, state, method, span, steps), repeats),
                compile_seconds,
                np.dtype(state.dtype).name,
                off.position,
                off.energy,
                memory,
            )
        )
    return points


def measure_closed_form(scene: Scene, state: State, exact: State, duration: float) -> list[Point]:
    """The closed form as a point; none where effects act."""
    if scene.effects:
        return []
    span, scene, state = jax.device_put((jnp.asarray(duration, state.dtype), scene, state))
    program, compile_seconds, memory = compiled(jax.jit(free_flight), scene, state, span)
    off = errors(scene, program(scene, state, span), exact)
    seconds = cpu_seconds(lambda: program(scene, state, span))
    name, kind = state.orientation.name, np.dtype(state.dtype).name
    return [
        Point("free_flight", name, 1, duration, off.attitude, seconds, compile_seconds, kind, off.position, off.energy,
              memory)
    ]  # fmt: skip


def measure_smooth(scene: Scene, state: State, exact: State, duration: float) -> list[Point]:
    """`solve_smooth` for a few tolerances, timed without the pilot that found its steps, which counts as compile time;
    none where forces are not smooth."""
    from jaxrb.scene.adams import solve_smooth  # a second to load, for a table that takes a minute

    points = []
    t1 = float(state.time) + duration
    for tolerance in SMOOTH_TOLERANCES[np.dtype(state.dtype).name]:
        start = time.process_time()
        try:
            found = solve_smooth(scene, state, t1=t1, tolerance=tolerance)
        except JaxrbError:  # a kink, or a tolerance below round-off: the other points tell
            continue

        def run(steps: int = found.steps, order: int = found.order) -> Any:
            return solve_smooth(scene, state, t1=t1, steps=steps, order=order).final

        off = errors(scene, jax.block_until_ready(run()), exact)
        first, seconds = time.process_time() - start, cpu_seconds(run, 3)
        name, kind = state.orientation.name, np.dtype(state.dtype).name
        points.append(
            Point("solve_smooth", name, found.steps, duration / found.steps, off.attitude, seconds,
                  max(first - seconds, 0.0), kind, off.position, off.energy)
        )  # fmt: skip
    return points


def step_counts(scene: Scene, state: State, method: Method, duration: float, levels: int) -> list[int]:
    """Numbers of steps, each four times the last, from the coarsest that resolves spin and effects."""
    spin = float(np.linalg.norm(np.asarray(state.angular_velocity, float), axis=-1).max())
    bodies = scene.stacked()
    fastest = max((float(np.max(effect.rate(bodies, state))) for effect in scene.effects), default=0.0)
    least = duration * max(spin / COARSEST_TURN, 1.25 * fastest / method.stability_limit)
    first = max(4, int(np.ceil(least)))
    return [first * 4**k for k in range(levels)]


def applicable(representation: type[Rotation]) -> list[Method]:
    """The methods that work in a representation."""
    methods = [kind() for kind in METHODS.values()]
    return [method for method in methods if not (method.needs_group and representation is EulerAngles)]


def work_precision(
    example: Example,
    representations: Sequence[str] = ("quaternion",),
    precisions: Sequence[str] = ("float64", "float32"),
    levels: int = 6,
    progress: Callable[[Sequence[Any]], Iterator[Any]] = iter,
) -> WorkPrecision:
    """Measure a scene with every method that applies, and the closed form where there is one.

    `solve_smooth` (Adams) and the closed form are among them where they apply. Errors are those of the end state
    against `reference`. Single precision is measured on the same scene, whatever JAX's default is. `progress` wraps the
    sequence of measurements, e.g. in a progress bar.
    """
    with jax.enable_x64(True):
        exact = reference_of(example.scene, example.state(), example.duration)
        cases: list[tuple[type[Rotation], str, Method | None]] = []
        for precision in precisions:
            for name in representations:
                kind = REPRESENTATIONS[name]
                cases += [(kind, precision, method) for method in (*applicable(kind), None)]
        points = []
        for kind, precision, method in progress(cases):
            state = example.state(kind, precision)
            if method is None:
                points += measure_closed_form(example.scene, state, exact.state, example.duration)
                if kind is not EulerAngles:
                    points += measure_smooth(example.scene, state, exact.state, example.duration)
            else:
                counts = step_counts(example.scene, state, method, example.duration, levels)
                points += measure(example.scene, state, exact.state, method, example.duration, counts)
    known = exact.uncertainty.attitude
    marked = [dataclasses.replace(p, beyond_reference=p.attitude_error_rad < known) for p in points]
    front = pareto(marked, known)
    final = tuple(dataclasses.replace(p, on_front=i in front) for i, p in enumerate(marked))
    return WorkPrecision(example.name, example.scene.count, example.duration, exact, final)


def pareto(points: Sequence[Point], known: float = 0.0) -> set[int]:
    """Numbers of the points that no cheaper point equals in attitude; errors below `known` [rad] count as that."""
    front, best = set(), np.inf
    for i in sorted(range(len(points)), key=lambda i: (points[i].run_seconds, points[i].attitude_error_rad)):
        error = max(points[i].attitude_error_rad, known)
        if error < best:
            front.add(i)
            best = error
    return front
