"""Strang's splitting into kicks and free flight, and its compositions of higher order."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from jaxrb.body.euler_equation import InertiaSolver
from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.effects.effect import Wrench
from jaxrb.integrators.method import Method, advanced
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation

Pairs = tuple[tuple[float, float], ...]

# Symmetric compositions of a method of order 1 and its adjoint: the parts α₁, α₂ | α₃, α₄ | … of the step, each pair
# one substep. With an operator split in two they read a₁ = α₁, b₁ = α₁ + α₂, a₂ = α₂ + α₃, …
STRANG = ((0.5, 0.5),)


def _pairs(outer: tuple[float, ...], inner: tuple[float, ...]) -> Pairs:
    """The pairs of a symmetric composition from the first coefficients a and b of its published form."""
    outer = (*outer, 1.0 - 2.0 * sum(outer), *reversed(outer))
    inner = (*inner, 0.5 - sum(inner))
    inner = (*inner, *reversed(inner))
    parts, left = [], 0.0
    for a, b in zip(outer, inner, strict=False):
        parts.append((a - left, b - a + left))
        left = parts[-1][1]
    return tuple(parts)


# S6 of order 4, error per cost 15 to 30 times below that of Suzuki's five substeps and McLachlan's (measured on four
# exact answers); S10 of order 6. (Blanes and Moan 2002, J. Comput. Appl. Math. 142, 313.)
BLANES_MOAN_4 = _pairs(
    (0.0792036964311957, 0.353172906049774, -0.0420650803577195), (0.209515106613362, -0.143851773179818)
)

BLANES_MOAN_6 = _pairs(
    (0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780),
    (0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175),
)


class Splitting(Method):
    """Half a kick of force and torque, free flight, half a kick; a composition of such substeps gives higher orders.

    A subclass says how a body turns freely; it moves uniformly meanwhile. The first kick is explicit, the last one
    implicit in the velocities, so that the step is symmetric in time for drag as well: solved by `sweeps` rounds of
    repetition, as many as the order demands. Rounds cost nothing for forces that depend on the pose alone: all of them
    are then the same number, which the compiler forms once. Without effects and torque the step is a free flight and
    nothing else.
    (Strang 1968, SIAM J. Numer. Anal. 5, 506; McLachlan 1995, SIAM J. Sci. Comput. 16, 151.)
    """

    stability_limit: ClassVar[float] = 2.0
    needs_group: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True
    one_angle: ClassVar[bool] = False
    parts: eqx.AbstractClassVar[Pairs]

    sweeps: int | None = eqx.field(static=True, default=None)

    def turn(
        self, inertia: InertiaSolver, omega: Vector, first: Scalar, second: Scalar
    ) -> tuple[Quaternion, Vector]:
        """Free rotation for first + second [s], a step of order 1 and then its adjoint.

        Returns the turn from the later to the earlier body frame, and the later ω.
        """
        raise NotImplementedError

    def turn_freely(self, inertia: InertiaSolver, omega: Vector, dt: Scalar) -> tuple[Quaternion, Vector]:
        """Free rotation for a whole step, of the order of the method."""
        raise NotImplementedError

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        wrench = dynamics.wrench(state, torque)
        if wrench.force is None and wrench.torque is None:
            return _flown(
                state, dt, self.renormalise, *self.turn_freely(dynamics.inertia, state.angular_velocity, dt)
            )
        if len(self.parts) == 1:
            return self._substep(dynamics, state, dt * self.parts[0][0], dt * self.parts[0][1], torque)
        # A scan: unrolled, six substeps take six times as long to compile.
        spans = dt * jnp.asarray(self.parts, state.dtype)
        return lax.scan(
            lambda s, pair: (self._substep(dynamics, s, pair[0], pair[1], torque), None), state, spans
        )[0]

    def project(self, orientation: Rotation) -> Rotation:
        return orientation  # each flight has projected it already, in the same sum

    def _substep(
        self, dynamics: Dynamics, state: State, first: Scalar, second: Scalar, torque: Vector | None
    ) -> State:
        start = _kicked(dynamics, state, dynamics.wrench(state, torque), first)
        turned = self.turn(dynamics.inertia, start.angular_velocity, first, second)
        flown = dynamics.complete(_flown(start, first + second, self.renormalise, *turned))
        end = flown
        for _ in range(self.order if self.sweeps is None else self.sweeps):
            end = _kicked(dynamics, flown, dynamics.wrench(end, torque), second)
        return end


def _flown(state: State, span: Scalar, renormalise: bool, increment: Quaternion, omega: Vector) -> State:
    """The state after uniform motion for `span` while the body turned."""
    return State(
        advanced(state.position, span, state.velocity),
        state.orientation.turned(increment.wxyz, renormalise=renormalise),
        state.velocity,
        omega,
        state.time + span,
    )


def _kicked(dynamics: Dynamics, state: State, wrench: Wrench, span: Scalar) -> State:
    """The state with the velocities that a wrench gives it in `span`."""
    angular = None if wrench.torque is None else dynamics.inertia.response(wrench.torque)
    return State(
        state.position,
        state.orientation,
        advanced(state.velocity, span, dynamics.linear_acceleration(wrench)),
        advanced(state.angular_velocity, span, angular),
        state.time,
    )
