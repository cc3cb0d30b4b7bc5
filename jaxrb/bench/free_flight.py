"""The closed form of free flight: its error after 1000 revolutions, and what it costs, forward and gradient."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.bench.workloads import cpu_median, row
from jaxrb.body.body import Body, replicate
from jaxrb.draws import drawn
from jaxrb.math.quaternion import attitude_error
from jaxrb.math.vector import dot
from jaxrb.scene.flight import free_flight
from jaxrb.scene.scene import Scene

BODIES = 1000
SPANS = (1.0, 1e2, 1e4)  # [s], at about 1 rad/s
_FULL = np.array([[1.0, 0.1, 0.05], [0.1, 2.0, 0.1], [0.05, 0.1, 2.5]])

# A body that keeps turning over: moments (1, 2, 3); ω at the start, t [s], wxyz then, from the identity.
# By Taylor series of order 36 in 78-digit arithmetic (tests/exact_rotation.py with more digits).
DZHANIBEKOV = (1.0, 2.0, 3.0)
LONG = [
    (
        (0.001, 1.0, 0.001),
        6284.0,
        (0.9168653833983543, -0.00938054029878412, 0.3990848546432911, -0.001073770848347158),
    ),
    (
        (0.001, 1.0, 0.001),
        6283.185307179586,
        (0.9999775014749659, -0.004809455735304094, 0.003194648026926109, -0.00341466007075716),
    ),
    (
        (0.001, 1.0, -0.002),
        6284.0,
        (-0.1052842688742924, 0.02505023097709539, -0.992423874250145, 0.05815980118546096),
    ),
    (
        (0.3, 0.9, 0.2),
        6284.0,
        (0.9172685613449694, -0.2318264463224835, 0.006770101121632808, -0.3237731472565655),
    ),
    (
        (0.1, 1.0, 0.0),
        5000.0,
        (0.6034731378318209, 0.03761057820634876, 0.7964898739558076, 0.003081721639259684),
    ),
]


def long_errors() -> list[float]:
    """Attitude errors [rad] after 800 to 1000 revolutions, against 16-digit answers; in float64 only."""
    scene = Scene(Body(1.0, DZHANIBEKOV))
    errors = []
    for omega, duration, wxyz in LONG:
        later = free_flight(scene, scene.state(angular_velocity=omega), duration)
        errors.append(float(attitude_error(later.orientation.as_quaternion_array()[0], jnp.asarray(wxyz))))
    return errors


def _crowd(inertia: Any, dtype: Any) -> tuple[Scene, Any]:
    random = drawn(0)
    scene = Scene(replicate(Body(1.0, inertia), BODIES))
    state = scene.state(angular_velocity=random.normal(size=(BODIES, 3)).astype(dtype))
    # Moments of every body its own, within a few per cent.
    vary = lambda leaf: leaf * (1.0 + 0.03 * random.random(np.shape(leaf)))  # noqa: E731
    bodies = jax.tree.map(lambda leaf: jnp.asarray(vary(leaf), dtype), scene.stacked().inertia)
    body = scene.bodies[0]
    return Scene(Body(body.mass, bodies)), state


def _compiled(function: Callable[..., Any], *given: Any) -> tuple[Callable[..., Any], float]:
    """The function compiled for these arguments, and the CPU seconds of tracing and compiling it."""
    start = time.process_time()
    program = jax.jit(function).lower(*given).compile()
    return program, time.process_time() - start


def cost(inertia: Any, dtype: Any, gradient: bool) -> tuple[float, float]:
    """µs a body over the dearest of the spans, and compile seconds.

    The gradient is of a scalar of the final state with respect to every number of the scene and the state, and to time.
    """
    scene, state = _crowd(inertia, dtype)

    def loss(scene: Scene, state: Any, t: Any) -> Any:
        later = free_flight(scene, state, t)
        return jnp.sum(later.orientation.as_quaternion_array()[:, 1]) + jnp.sum(
            dot(later.angular_velocity, later.angular_velocity)
        )

    function = jax.grad(loss, argnums=(0, 1, 2)) if gradient else free_flight
    program, seconds = _compiled(function, scene, state, jnp.asarray(1.0, dtype))
    spans = [jnp.asarray(t, dtype) for t in SPANS]
    worst = max(cpu_median(lambda t=t: [program(scene, state, t) for _ in range(10)])[0] for t in spans)
    return 1e6 * worst / (10 * BODIES), seconds


def rows() -> Iterator[dict[str, Any]]:
    """The benchmark, a row at a time: what, figure, unit, goal."""
    kinds = [np.float32]
    if jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        yield row("closed form, error after 1000 revolutions, worst of 5", max(long_errors()), "rad", 1e-12)
        kinds = [np.float64, np.float32]
    for dtype in kinds:
        for name, inertia in (("principal", (1.0, 2.0, 2.5)), ("full", _FULL)):
            for what, gradient, goal in (("forward", False, 2.0), ("gradient", True, 5.0)):
                figure, seconds = cost(inertia, dtype, gradient)
                kind = np.dtype(dtype).name
                yield row(
                    f"closed form, 1000 bodies, {kind}, {name}, {what}", figure, "µs/body", goal, seconds
                )
