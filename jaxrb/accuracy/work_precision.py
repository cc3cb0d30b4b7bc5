"""Error against time for methods and step sizes on one scene."""

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.integrators.method import Method
from jaxrb.math.arrays import Scalar
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.scene import Scene


@dataclasses.dataclass(frozen=True)
class Point:
    """One method at one step: what it costs and what it yields."""

    method: str
    representation: str
    steps: int
    dt: float
    attitude_error_rad: float
    run_seconds: float
    compile_seconds: float

    def row(self) -> dict[str, object]:
        """The point as plain numbers."""
        return dataclasses.asdict(self)


@jax.jit
def end_state(scene: Scene, state: State, method: Method, duration: Scalar, count: Any) -> State:
    """The state after `count` steps over `duration` [s]. The count is a number of the run: one program serves all."""
    dynamics = scene.prepared(state.dtype)
    dt = duration / count
    return jax.lax.fori_loop(0, count, lambda _, s: method.step(dynamics, s, dt), state)


def measure(
    scene: Scene,
    state: State,
    exact: State,
    method: Method,
    duration: float,
    counts: Sequence[int],
    repeats: int = 3,
) -> list[Point]:
    """Error and CPU time of a method for each number of steps; median of `repeats` runs, compilation apart."""

    def run(count: int) -> State:
        final = end_state(scene, state, method, jnp.asarray(duration, state.dtype), jnp.asarray(count))
        return jax.block_until_ready(final)

    start = time.process_time()
    run(1)
    compile_seconds = time.process_time() - start
    points = []
    for count in counts:
        seconds = []
        for _ in range(repeats):
            start = time.process_time()
            final = run(count)
            seconds.append(time.process_time() - start)
        points.append(
            Point(
                type(method).__name__,
                state.orientation.name,
                count,
                duration / count,
                float(np.max(_attitude_errors(final, exact))),
                float(np.median(seconds)),
                compile_seconds,
            )
        )
    return points


@jax.jit
def _attitude_errors(state: State, exact: State) -> Any:
    return Quaternion.from_rotation(exact.orientation.normalise()).angle_to(state.orientation.normalise())
