"""Every method in figures: what a step costs, how accurate it is for equal time, what it keeps over long runs.

    python -m jaxrb.bench.methods [--steps 10000000] [--float32]

prints the tables of docs/methods.md for this machine; on a shared machine compare figures of one run only.
"""

import argparse
import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.reference import end_state, errors, reference
from jaxrb.accuracy.timing import cpu_of_first
from jaxrb.bench.timing import both_clocks
from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import METHODS
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.library import Example, dzhanibekov, heavy_top
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.tables import table

BODIES, STEPS, SAVES = 1000, 1000, 200
FULL = np.array([[1.0, 0.1, 0.05], [0.1, 2.0, 0.1], [0.05, 0.1, 2.5]])
FREE_BODIES = 16  # of a long run


@dataclasses.dataclass(frozen=True)
class LongRun:
    """Largest errors over the bodies and saved times of a long run, relative.

    `energy_growth` is the largest energy error of the second half over that of the first: 2 for a steady loss, 1 for an
    oscillation. `energy_trend` is the slope of a straight line through the energy, times the duration. `momentum` is of
    the vector of angular momentum in the world.
    """

    energy: float
    energy_growth: float
    energy_trend: float
    momentum: float


def long_run(
    method: Method,
    steps: int,
    rotation: type[Rotation] = Quaternion,
    inertia: Any = (1.0, 2.0, 3.0),
    dt: float = 0.02,
) -> LongRun:
    """Free bodies that turn at 1 rad/s, one of them next to its unstable axis, over `steps` steps of `dt` [s]."""
    spin = drawn(0).normal(size=(FREE_BODIES, 3))
    spin[0] = (1e-3, 1.0, 1e-3)
    spin /= np.linalg.norm(spin, axis=1, keepdims=True)
    scene = Scene(replicate(Body(1.0, inertia), FREE_BODIES))
    state = scene.state(angular_velocity=spin.tolist(), rotation=rotation)
    every = max(steps // SAVES, 1)
    path = rollout(scene, state, dt=dt, steps=steps, save_every=every, method=method, on_error="flag")
    tensor = np.asarray(inertia, float)
    tensor = np.diag(tensor) if tensor.ndim == 1 else tensor
    omega = np.asarray(path.states.angular_velocity, float)
    in_body = omega @ tensor
    energy = np.sum(omega * in_body, axis=-1)
    energy = energy / energy[0] - 1.0
    turn = np.asarray(path.states.orientation.normalise().as_matrix(), float)
    in_world = np.einsum("knij,knj->kni", turn, in_body)
    off = np.linalg.norm(in_world - in_world[0], axis=-1) / np.linalg.norm(in_world[0], axis=-1)
    if not np.isfinite(off).all():
        return LongRun(np.inf, np.inf, np.inf, np.inf)
    slope = np.polyfit(np.linspace(0.0, 1.0, len(energy)), energy, 1)[0]
    half = len(energy) // 2
    growth = np.abs(energy[half:]).max() / max(np.abs(energy[:half]).max(), 1e-300)
    return LongRun(float(np.abs(energy).max()), float(growth), float(np.abs(slope).max()), float(off.max()))


def cost(method: Method, scene: Scene, rotation: type[Rotation] = Quaternion) -> tuple[float, float]:
    """ns a body-step of 1000 copies of a scene's body under its effects, and CPU seconds to trace and compile."""
    random = drawn(0)
    crowd = Scene(replicate(scene.bodies[0], BODIES), scene.effects)
    state = crowd.state(angular_velocity=random.normal(size=(BODIES, 3)).tolist(), rotation=rotation)

    def run() -> Any:
        path = rollout(crowd, state, dt=1e-3, steps=STEPS, save_every=STEPS, method=method, on_error="flag")
        return path.final

    first = cpu_of_first(run)
    seconds, _ = both_clocks(run)
    return 1e9 * seconds / (BODIES * STEPS), max(first - seconds, 0.0)


def equal_time_error(
    example: Example, exact: State, method: Method, nanoseconds: float, budget: float
) -> float:
    """Attitude error [rad] with as many steps as `budget` [µs a body] pays for at a known cost of a step."""
    count = max(int(1e3 * budget / nanoseconds), 1)
    state = example.state()
    final = end_state(example.scene, state, method, jnp.asarray(example.duration, state.dtype), count)
    return errors(example.scene, final, exact).attitude


def rows(budget: float = 100.0) -> Iterator[dict[str, Any]]:
    """Cost and accuracy, a row a method: order, ns a step, error for `budget` µs of CPU a body."""
    free, forced = dzhanibekov(), heavy_top()
    exact = [reference(e.scene, e.state(), e.duration).state for e in (free, forced)]
    full = Scene(Body(1.0, FULL))
    for name, kind in METHODS.items():
        method = kind()
        quaternion, compile_seconds = cost(method, free.scene)
        with_torque, _ = cost(method, forced.scene)
        yield {
            "method": name,
            "order": method.order,
            "quaternion ns": quaternion,
            "matrix ns": cost(method, free.scene, RotationMatrix)[0],
            "full inertia ns": cost(method, full)[0],
            "with torque ns": with_torque,
            "compile CPU s": compile_seconds,
            "dzhanibekov rad": equal_time_error(free, exact[0], method, quaternion, budget),
            "heavy top rad": equal_time_error(forced, exact[1], method, with_torque, budget),
        }


def long_rows(steps: int) -> Iterator[dict[str, Any]]:
    """What is kept over `steps` steps, a row a method."""
    for name, kind in METHODS.items():
        found = long_run(kind(), steps)
        yield {
            "method": name,
            "steps": steps,
            "energy": found.energy,
            "energy growth": found.energy_growth,
            "energy trend": found.energy_trend,
            "angular momentum": found.momentum,
        }


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=100_000, help="of the long runs")
    parser.add_argument("--budget", type=float, default=100.0, help="CPU time a body in microseconds")
    parser.add_argument("--float32", action="store_true")
    chosen = parser.parse_args()
    with jax.enable_x64(not chosen.float32):
        print(table(list(rows(chosen.budget))))
        print()
        print(table(list(long_rows(chosen.steps))))


if __name__ == "__main__":
    main()
