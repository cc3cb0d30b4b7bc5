"""Strang's splitting into kicks and free flight, and its compositions of higher order."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from jaxrb.body.inertia import InertiaSolver
from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.effects.effect import Wrench
from jaxrb.integrators.method import Method, advanced
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.quaternion import Quaternion

# Symmetric compositions of a symmetric method of order 2: the substeps as parts of the step.
_SUZUKI = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
STRANG = (1.0,)
SUZUKI = (_SUZUKI, _SUZUKI, 1.0 - 4.0 * _SUZUKI, _SUZUKI, _SUZUKI)


class Splitting(Method):
    """Half a kick of force and torque, free flight, half a kick; substeps of `weights` · dt make the higher orders.

    A subclass says how a body turns freely; it moves uniformly meanwhile. The first half kick is explicit, the last one
    implicit in the velocities, solved by `sweeps` rounds of repetition, so that the step is symmetric in time for drag
    as well. Rounds cost nothing for forces that depend on the pose alone: all of them are then the same number, which
    the compiler forms once. Without effects and torque the step is a free flight and nothing else.
    (Strang 1968, SIAM J. Numer. Anal. 5, 506; Suzuki 1990, Phys. Lett. A 146, 319.)
    """

    stability_limit: ClassVar[float] = 2.0
    needs_group: ClassVar[bool] = True
    weights: eqx.AbstractClassVar[tuple[float, ...]]
    # The substeps of a step of free flight, where `turn` is of higher order than the splitting.
    free_weights: eqx.AbstractClassVar[tuple[float, ...]]

    sweeps: int = eqx.field(static=True, default=3)

    def turn(self, inertia: InertiaSolver, omega: Vector, span: Scalar) -> tuple[Quaternion, Vector]:
        """Free rotation for `span` [s]: the turn from the later to the earlier body frame, and the later ω."""
        raise NotImplementedError

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        wrench = dynamics.wrench(state, torque)
        if wrench.force is None and wrench.torque is None:
            return self._repeated(self.free_weights, lambda s, span: self._flight(dynamics, s, span), state, dt)
        return self._repeated(self.weights, lambda s, span: self._kicked(dynamics, s, span, torque), state, dt)

    def _repeated(self, weights: tuple[float, ...], substep, state: State, dt: Scalar) -> State:
        if len(weights) == 1:
            return substep(state, dt)
        # A scan: unrolled, five substeps take five times as long to compile.
        spans = jnp.asarray(weights, state.dtype) * dt
        return lax.scan(lambda s, span: (substep(s, span), None), state, spans)[0]

    def _flight(self, dynamics: Dynamics, state: State, span: Scalar) -> State:
        increment, omega = self.turn(dynamics.inertia, state.angular_velocity, span)
        return State(
            advanced(state.position, span, state.velocity),
            state.orientation @ type(state.orientation).from_rotation(increment),
            state.velocity,
            omega,
            state.time + span,
        )

    def _kicked(self, dynamics: Dynamics, state: State, span: Scalar, torque: Vector | None) -> State:
        half = 0.5 * span
        start = _kick(dynamics, state, dynamics.wrench(state, torque), half)
        flown = dynamics.complete(self._flight(dynamics, start, span))
        end = flown
        for _ in range(self.sweeps):
            end = _kick(dynamics, flown, dynamics.wrench(end, torque), half)
        return end


def _kick(dynamics: Dynamics, state: State, wrench: Wrench, span: Scalar) -> State:
    """The state with the velocities that a wrench gives it in `span`."""
    angular = None if wrench.torque is None else dynamics.inertia.response(wrench.torque)
    return State(
        state.position,
        state.orientation,
        advanced(state.velocity, span, dynamics.linear_acceleration(wrench)),
        advanced(state.angular_velocity, span, angular),
        state.time,
    )
