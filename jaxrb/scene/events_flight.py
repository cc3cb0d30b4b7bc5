"""Flight between impacts: where bodies are a time τ later, and what their points cannot exceed on the way.

Where nothing acts but uniform gravity the flight is a parabola and the closed form of free rotation, exact for any τ.
Under other effects it is one step of a `Method` of length τ: the step is its own dense output, so that an impact inside
it is found to round-off of that step.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body.inertia import SphericalInertia
from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.effects.gravity import UniformGravity
from jaxrb.integrators.free_flight import free_rotation
from jaxrb.integrators.method import Method
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import norm
from jaxrb.math.vector import dot

# What a stepped flight's own estimates of its bounds are multiplied by: they come from the two ends of a short step.
_ROOM = 1.5


class Bounds(eqx.Module):
    """What a flight keeps to: `acceleration` (n, 3) [m/s²] of the centres up to `excess` (n,) [m/s²]; the rate of
    turning
    at most `spin` (n,) [rad/s], and its own rate of change at most `turning` (n,) [rad/s²]."""

    acceleration: Vector
    excess: Scalar
    spin: Scalar
    turning: Scalar


class Flight(eqx.Module):
    """How bodies that do not touch move."""

    dynamics: Dynamics

    def after(self, state: State, tau: Scalar) -> State:
        """The state `tau` [s] later."""
        raise NotImplementedError

    def bounds(self, state: State, horizon: Scalar) -> Bounds:
        """Bounds that hold for `horizon` [s]."""
        raise NotImplementedError

    def _most_spin(self, state: State) -> tuple[Scalar, Scalar]:
        """The largest rate of turning (n,) that the energy of rotation allows, and the largest |ω̇| without torque."""
        bodies = self.dynamics.bodies
        omega = state.angular_velocity
        if isinstance(bodies.inertia, SphericalInertia):
            return norm(omega), jnp.zeros_like(bodies.mass)
        moments = jnp.linalg.eigvalsh(bodies.inertia.as_matrix())
        least, most = moments[:, 0], moments[:, -1]
        spin = jnp.sqrt(jnp.maximum(dot(omega, bodies.inertia.apply(omega)), 0.0) / least)
        return spin, spin * spin * (most - least) / least


class ExactFlight(Flight):
    """Uniform gravity or nothing: `acceleration` (n, 3) [m/s²] of each body is constant."""

    acceleration: Vector

    def after(self, state: State, tau: Scalar) -> State:
        fall = tau * self.acceleration
        inertia = self.dynamics.bodies.inertia
        turn, omega = jax.vmap(free_rotation, in_axes=(0, 0, None))(inertia, state.angular_velocity, tau)
        turned = state.orientation @ type(state.orientation).from_rotation(turn)
        return State(
            state.position + tau * (state.velocity + 0.5 * fall),
            turned.renormalise(),
            state.velocity + fall,
            omega,
            state.time + tau,
        )

    def bounds(self, state: State, horizon: Scalar) -> Bounds:
        spin, turning = self._most_spin(state)
        return Bounds(self.acceleration, jnp.zeros_like(spin), spin, turning)


class SteppedFlight(Flight):
    """Any effects, by one step of `method`: horizons must be as short as its steps."""

    method: Method

    def after(self, state: State, tau: Scalar) -> State:
        return self.method.free_step(self.dynamics, state, None, tau, None)[0]

    def bounds(self, state: State, horizon: Scalar) -> Bounds:
        end = self.after(state, horizon)
        rate = jnp.where(horizon > 0, 1.0 / jnp.where(horizon > 0, horizon, 1.0), 0.0)
        mean = rate * (end.velocity - state.velocity)
        start = self.dynamics.acceleration(state).linear
        start = jnp.zeros_like(mean) if start is None else start
        fastest = jnp.maximum(self._most_spin(state)[0], self._most_spin(end)[0])
        change = rate * norm(end.angular_velocity - state.angular_velocity)
        free = jnp.maximum(self._most_spin(state)[1], self._most_spin(end)[1])
        return Bounds(mean, _ROOM * norm(start - mean), _ROOM * fastest, _ROOM * (change + free))


def is_exact(effects: tuple[Any, ...]) -> bool:
    """Whether flight under these effects (contact left out) is in closed form."""
    return all(isinstance(effect, UniformGravity) for effect in effects)


def flight_of(dynamics: Dynamics, state: State, method: Method) -> Flight:
    """The flight of a scene."""
    if not is_exact(dynamics.effects):
        return SteppedFlight(dynamics, method)
    linear = dynamics.acceleration(state).linear
    acceleration: Array = jnp.zeros_like(state.velocity) if linear is None else linear
    return ExactFlight(dynamics, acceleration)
