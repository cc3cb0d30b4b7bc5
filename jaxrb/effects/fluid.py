"""What a fluid does to a body beside slowing it: it carries it, deflects it, and pushes plates."""

import jax.numpy as jnp

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.checks import check_direction, quantity
from jaxrb.effects.effect import Force, Wrench
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.safe import norm
from jaxrb.math.vector import cross, dot


class Buoyancy(Force):
    """F = −ρ V g at the centre of buoyancy: Archimedes' law for a body that is wholly in the fluid.

    `volume` V [m³]; `density` ρ of the fluid [kg/m³], by default that of fresh water at 4 °C; `point` (3,) [m], the
    centre of the displaced fluid in the body frame; `acceleration` (3,) [m/s²], the gravity of the fluid.
    """

    volume: Scalar = quantity((), nonnegative=True, unit="m³")
    density: Scalar = quantity((), nonnegative=True, unit="kg/m³", default=999.97)
    point: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))
    acceleration: Vector = quantity((3,), unit="m/s²", default=(0.0, 0.0, -9.80665))

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        lift = (-self.density * self.volume) * jnp.asarray(self.acceleration)
        return Wrench.at_point(lift, self.point, state)

    def potential_energy(self, body: MassProperties, state: State) -> Scalar:
        return self.density * self.volume * dot(self.acceleration, state.point_position(self.point))


class MagnusForce(Force):
    """F = S ω × v: a spinning ball is deflected.

    `coefficient` S [kg]; a sphere of radius r that turns slowly in a medium of density ρ has S = π ρ r³ (Rubinow and
    Keller 1961, J. Fluid Mech. 11, 447). `wind` (3,) [m/s], the velocity of the medium; None is a medium at rest.
    """

    coefficient: Scalar = quantity((), unit="kg")
    wind: Vector | None = quantity((3,), unit="m/s", default=None)

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        spin = state.orientation.rotate(state.angular_velocity)
        return Wrench(force=self.coefficient * cross(spin, through_air(state.velocity, self.wind)))


class PlateAerodynamics(Force):
    """Lift and drag of a flat plate that is part of the body: a pressure along its normal, none along its surface.

    |F| = ½ ρ A |v|² C with C = 2π sin α/(4 + π sin α) at the angle of attack α, against the motion of its middle
    `point` (3,) [m] through the medium (Rayleigh 1876, Phil. Mag. 2, 430: the stalled plate). `normal` (3,) need not
    have length one, and its sign does not matter. `area` A [m²], `density` ρ [kg/m³] as of `QuadraticDrag`, `wind` (3,)
    [m/s]. Several plates, each an effect, make a fin or a propeller: their points feel the body's rotation.
    """

    normal: Vector = quantity((3,))
    area: Scalar = quantity((), nonnegative=True, unit="m²")
    point: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))
    density: Scalar = quantity((), nonnegative=True, unit="kg/m³", default=1.225)
    wind: Vector | None = quantity((3,), unit="m/s", default=None)

    def __post_init__(self):
        super().__post_init__()
        check_direction("PlateAerodynamics.normal", self.normal)

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        motion = through_air(state.point_velocity(self.point), self.wind)
        seen = state.orientation.unrotate(motion)
        normal = jnp.asarray(self.normal) / norm(jnp.asarray(self.normal))
        across, speed = dot(seen, normal), norm(seen)
        below = 4.0 * speed + jnp.pi * jnp.abs(across)
        moving = below > 0
        # |v|² sin α C sign: of second order in v, so zero with its derivative at rest.
        factor = jnp.where(moving, 2.0 * jnp.pi * across * speed**2 / jnp.where(moving, below, 1.0), 0.0)
        force = (-0.5 * self.density * self.area * factor) * normal
        return Wrench(state.orientation.rotate(force), cross(self.point, force))


def through_air(velocity: Vector, wind: Vector | None) -> Vector:
    """The velocity relative to the medium; a wind of None costs nothing."""
    return velocity if wind is None else velocity - jnp.asarray(wind)
