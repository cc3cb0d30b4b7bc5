"""Explicit Euler: the lecture's first method."""

from typing import ClassVar

import equinox as eqx

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.method import Method, moved, rates
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.rotation import Rotation


class ExplicitEuler(Method):
    """x += v dt, v += a dt, q += q̇ dt, all from the old state. Order 1; gains energy in every oscillation.

    With `finite_rotation` the attitude turns by the exact finite rotation exp(ω dt) instead of along the tangent: no
    drift of the representation, still order 1. (Euler 1768, Institutionum calculi integralis I, §650.)
    """

    order: ClassVar[int] = 1
    stability_limit: ClassVar[float] = 2.0
    takes_joints: ClassVar[bool] = True
    finite_rotation: bool = eqx.field(static=True, default=False)

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        new = moved(state, dt, rates(state, dynamics.acceleration(state, torque)), dt)
        if not self.finite_rotation:
            return new
        return eqx.tree_at(
            lambda s: s.orientation, new, turned(state.orientation, dt * state.angular_velocity)
        )


def turned(orientation: Rotation, rotation_vector: Vector) -> Rotation:
    """The orientation after a further rotation by a vector in the body frame (..., 3) [rad]."""
    return orientation @ type(orientation).exp(rotation_vector)
