"""Drag of a medium, at rest or in a wind."""

import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.body.validity import inertia_matrix
from jaxrb.checks import quantity
from jaxrb.effects.effect import Force, Wrench
from jaxrb.effects.fluid import through_air
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.safe import norm


class LinearDrag(Force):
    """F = −c v and τ = −c_r ω: Stokes' law, or a first model of any small damping.

    `coefficient` [N s/m] slows the motion of the centre of mass; `angular_coefficient` [N m s/rad], if given, the spin.
    `wind` (3,) [m/s] is the velocity of the medium in the world frame; None is a medium at rest, and costs nothing.
    A sphere of radius r in a medium of viscosity η has c = 6πηr and c_r = 8πηr³ (Stokes 1851).
    """

    coefficient: Scalar = quantity((), nonnegative=True, unit="N s/m")
    angular_coefficient: Scalar | None = quantity((), nonnegative=True, unit="N m s/rad", default=None)
    wind: Vector | None = quantity((3,), unit="m/s", default=None)

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        force = -self.coefficient * through_air(state.velocity, self.wind)
        if self.angular_coefficient is None:
            return Wrench(force)
        return Wrench(force, -self.angular_coefficient * state.angular_velocity)

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        linear = np.max(np.asarray(self.coefficient) / np.asarray(_masses(self, bodies)))
        if self.angular_coefficient is None:
            return linear
        moments = np.linalg.eigvalsh(inertia_matrix(bodies.inertia))[..., 0]
        moments = moments if self.bodies is None else moments[np.asarray(self.bodies)]
        smallest = moments.min(initial=np.inf, where=moments > 0)  # a point mass has none
        return np.maximum(linear, np.max(np.asarray(self.angular_coefficient)) / smallest)


class QuadraticDrag(Force):
    """F = −½ ρ C A |v| v: the drag of a blunt body at high Reynolds number.

    `coefficient` C [1], `area` A [m²], `density` ρ of the medium [kg/m³], by default that of air at sea level and 15 °C
    (ISO 2533); `wind` (3,) [m/s] as of `LinearDrag`. It acts at the centre of mass and does not depend on the attitude.
    """

    coefficient: Scalar = quantity((), nonnegative=True)
    area: Scalar = quantity((), nonnegative=True, unit="m²")
    density: Scalar = quantity((), nonnegative=True, unit="kg/m³", default=1.225)
    wind: Vector | None = quantity((3,), unit="m/s", default=None)

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        motion = through_air(state.velocity, self.wind)
        # norm has zero gradient at rest, where |v| v has a zero derivative too.
        return Wrench((-0.5 * self.density * self.coefficient * self.area) * norm(motion) * motion)

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        motion = np.asarray(state.velocity) - (0.0 if self.wind is None else np.asarray(self.wind))
        speed = np.linalg.norm(motion, axis=-1).max()
        factor = np.asarray(self.density) * np.asarray(self.coefficient) * np.asarray(self.area)
        return np.max(factor) * speed / np.min(np.asarray(bodies.mass))


def _masses(force: Force, bodies: MassProperties) -> np.ndarray:
    masses = np.asarray(bodies.mass)
    return masses if force.bodies is None else masses[np.asarray(force.bodies)]
