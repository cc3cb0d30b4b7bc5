"""Solids with closed forms. Lengths in metres; each describes itself in a frame of its own."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxrb.body import mass_properties as closed_form
from jaxrb.body.mass_properties import MassProperties
from jaxrb.checks import quantity
from jaxrb.errors import WrongStructure
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation


class Sphere(Shape):
    """Sphere about the origin."""

    radius: Scalar = quantity((), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_sphere(density, self.radius)


class Ellipsoid(Shape):
    """Ellipsoid about the origin with semi-axes `radii` (3,) along x, y, z."""

    radii: Vector = quantity((3,), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_ellipsoid(density, self.radii)


class Box(Shape):
    """Box about the origin with half edges `half_extents` (3,) along x, y, z."""

    half_extents: Vector = quantity((3,), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_box(density, self.half_extents)


class Cylinder(Shape):
    """Cylinder about the origin along z."""

    radius: Scalar = quantity((), positive=True, unit="m")
    half_height: Scalar = quantity((), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_cylinder(density, self.radius, self.half_height)


class Capsule(Shape):
    """Cylinder along z of `half_height` with half spheres of `radius` beyond its ends."""

    radius: Scalar = quantity((), positive=True, unit="m")
    half_height: Scalar = quantity((), nonnegative=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_capsule(density, self.radius, self.half_height)


class Cone(Shape):
    """Cone along z with its base in the plane z = 0 and its tip at z = `height`."""

    radius: Scalar = quantity((), positive=True, unit="m")
    height: Scalar = quantity((), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_cone(density, self.radius, self.height)


class Pose(eqx.Module):
    """Position (3,) [m] and orientation of one frame in another."""

    position: Vector
    orientation: Rotation

    @classmethod
    def identity(cls, dtype=None) -> "Pose":
        """The frame itself."""
        return cls(jnp.zeros(3, dtype), Quaternion.identity(dtype))


class Composite(Shape):
    """Several shapes joined rigidly: pairs of a shape and its `Pose` in the composite's frame.

    `relative_densities` weigh the parts against each other; overlaps count twice.
    """

    parts: Sequence[tuple[Shape, Pose]]
    relative_densities: Any = quantity((), positive=True, default=1.0)

    def mass_properties(self, density: Scalar) -> MassProperties:
        weights = jnp.broadcast_to(jnp.asarray(self.relative_densities), (len(self.parts),))
        return closed_form.of_parts(
            [
                shape.mass_properties(density * weight).moved(pose.position, pose.orientation)
                for (shape, pose), weight in zip(self.parts, weights, strict=True)
            ]
        )

    def __check_init__(self):
        if not self.parts or not all(isinstance(s, Shape) and isinstance(p, Pose) for s, p in self.parts):
            raise WrongStructure("Composite.parts: give at least one pair (shape, Pose)")
