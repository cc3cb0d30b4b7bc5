"""The abstract shape."""

import jax.numpy as jnp

from jaxrb.body.mass_properties import MassProperties
from jaxrb.checks import Checked
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.safe import unit_or


class Shape(Checked):
    """A solid in a frame of its own.

    As a set of points a convex shape is its *core*, which `support` describes, grown on all sides by the `rounding`
    radius: a sphere is a point grown by its radius, a capsule a segment. Distances between cores are found first, since
    a core of few points has a closed form, and both radii are subtracted after.
    """

    def mass_properties(self, density: Scalar) -> MassProperties:
        """Mass, centre of mass and inertia when filled with `density` [kg/m³]."""
        raise NotImplementedError

    def support(self, direction: Vector) -> Vector:
        """The point (..., 3) [m] of the core farthest along `direction` (..., 3), of any length, both in the own frame.

        Where several points are equally far one of them is returned; all its derivatives are finite.

        Raises:
            WrongStructure: a shape that has no farthest point (a half-space) or no support map of its own.
        """
        raise WrongStructure(f"{type(self).__name__}: there is no farthest point along a direction")

    @property
    def rounding(self) -> Scalar:
        """Radius [m] by which the solid extends beyond its core on all sides."""
        return 0.0

    def farthest(self, direction: Vector) -> Vector:
        """The point (..., 3) [m] of the solid itself farthest along `direction` (..., 3): core and rounding."""
        direction = jnp.asarray(direction)
        up = jnp.zeros_like(direction).at[..., 2].set(1.0)
        return self.support(direction) + jnp.asarray(self.rounding)[..., None] * unit_or(direction, up)
