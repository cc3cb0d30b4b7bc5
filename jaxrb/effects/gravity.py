"""Uniform gravity."""

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.checks import quantity
from jaxrb.effects.effect import Force, Wrench
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.vector import dot


class UniformGravity(Force):
    """F = m g. `acceleration` (3,) [m/s²] in the world frame; the default is the standard value, downwards.

    The potential energy is −m g·p: zero in the plane through the origin.
    """

    acceleration: Vector = quantity((3,), unit="m/s²", default=(0.0, 0.0, -9.80665))

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        return Wrench(force=body.mass * self.acceleration)

    def potential_energy(self, body: MassProperties, state: State) -> Scalar:
        return -body.mass * dot(self.acceleration, state.position)
