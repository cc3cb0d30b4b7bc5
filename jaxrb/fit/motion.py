"""The motion that is fitted: a body in free flight, perhaps with drag and a spinning wheel inside, sampled.

It is the engine's own, `jaxrb.step` with Runge–Kutta 4, so what is fitted is exactly what will be simulated.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body import Body
from jaxrb.body.inertia import FullInertia
from jaxrb.body.state import State
from jaxrb.effects.custom import CustomForce
from jaxrb.effects.effect import Wrench
from jaxrb.integrators import RungeKutta4
from jaxrb.math import Quaternion
from jaxrb.math.arrays import Array, Matrix, Scalar, Vector
from jaxrb.math.safe import norm
from jaxrb.math.vector import cross
from jaxrb.scene import Scene, step


class Medium(NamedTuple):
    """What slows a spin: the torque −tr(I) (linear + quadratic |ω|) ω; [1/s] and [1]. None costs nothing."""

    linear: Scalar | None = None
    quadratic: Scalar | None = None


Wheel = tuple[Array, Array]  # momentum (..., 3) [kg m²/s] relative to the body that carries it, and its rate


def torque(inertia: FullInertia, spin: Array, medium: Medium, wheel: Wheel | None) -> Array:
    """Torque (..., 3) of drag, and of a wheel of momentum h on the body that carries it, −ω × h − ḣ."""
    rate = jnp.zeros_like(spin[..., :1])
    if medium.linear is not None:
        rate = rate + medium.linear
    if medium.quadratic is not None:
        rate = rate + medium.quadratic * norm(spin)[..., None]
    push = -inertia.trace() * rate * spin
    return push if wheel is None else push - cross(spin, wheel[0]) - wheel[1]


def _push(body, state: State, parameters: tuple[Medium, Wheel | None]) -> Wrench:
    medium, wheel = parameters
    if wheel is not None:
        wheel = (wheel[0] + state.time * wheel[1], wheel[1])
    spin = state.angular_velocity
    return Wrench(jnp.zeros_like(spin), torque(body.inertia, spin, medium, wheel))


def tumble(
    inertia: Matrix,
    orientation: Quaternion,
    angular_velocity: Vector,
    interval: Array,
    substeps: int,
    medium: Medium = Medium(),  # noqa: B008 - an immutable value
    momentum: Array | None = None,
) -> tuple[Quaternion, Vector]:
    """Free flight of one body, sampled.

    Args:
        inertia: (3, 3), any scale if there is no `momentum`. orientation, angular_velocity: at the start, body frame
            [rad/s].
        interval: (K,) [s] to each sample from the one before (from the start, for the first). May be uneven or 0.
        substeps: Runge–Kutta steps in each interval.
        medium: drag.
        momentum: (K + 1, 3) [kg m²/s] of a wheel in the body, relative to the body, body frame: at the start and at
            every sample; in between it changes evenly. In units of the inertia's.

    Returns:
        Attitudes (K,) and angular velocities (K, 3) [rad/s], body frame.
    """
    body = Body(mass=jnp.ones_like(interval[0]), inertia=FullInertia.from_matrix(inertia))
    free = momentum is None and medium.linear is None and medium.quadratic is None
    none, zero = jnp.zeros((1, 3), interval.dtype), jnp.zeros((), interval.dtype)
    start = State(
        position=none,
        orientation=Quaternion(orientation.wxyz[None]),
        velocity=none,
        angular_velocity=angular_velocity[None],
        time=zero,
    )

    def sample(state, given):
        span, wheel = given
        scene = Scene(bodies=(body,), effects=() if free else (CustomForce(_push, (medium, wheel)),))
        state = eqx.tree_at(lambda s: s.time, state, zero)  # the wheel's clock starts with the interval
        for _ in range(substeps) if substeps <= 2 else ():
            state = step(scene, state, None, span / substeps, method=RungeKutta4())
        if substeps > 2:
            state, _ = jax.lax.scan(
                lambda s, _: (step(scene, s, None, span / substeps, method=RungeKutta4()), None),
                state,
                length=substeps,
            )
        return state, (state.orientation.as_quaternion_array()[0], state.angular_velocity[0])

    wheel = None
    if momentum is not None:
        # Padding has intervals of no length, in which nothing changes.
        span = jnp.where(interval > 0, interval, 1.0)[:, None]
        wheel = (momentum[:-1], jnp.diff(momentum, axis=0) / span)
    _, (wxyz, spin) = jax.lax.scan(sample, start, (interval, wheel))
    return Quaternion(wxyz), spin


def angular_acceleration(inertia: Matrix, spin: Array, medium: Medium, wheel: Wheel | None) -> Array:
    """Euler's equation at samples: (K, 3) [rad/s²] of angular velocities (K, 3)."""
    body = FullInertia.from_matrix(inertia)
    push = torque(body, spin, medium, wheel) - cross(spin, body.apply(spin))
    return push @ jnp.linalg.inv(inertia)
