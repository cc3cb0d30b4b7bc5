"""Solids with closed forms. Lengths in metres; each describes itself in a frame of its own."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrb.body import mass_properties as closed_form
from jaxrb.body.mass_properties import MassProperties
from jaxrb.checks import as_array, check_direction, quantity
from jaxrb.errors import WrongStructure
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.math.safe import norm, unit_or


class Sphere(Shape):
    """Sphere about the origin."""

    radius: Scalar = quantity((), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_sphere(density, self.radius)

    def support(self, direction: Vector) -> Vector:
        return jnp.zeros_like(jnp.asarray(direction))

    @property
    def rounding(self) -> Scalar:
        return self.radius


class Ellipsoid(Shape):
    """Ellipsoid about the origin with semi-axes `radii` (3,) along x, y, z."""

    radii: Vector = quantity((3,), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_ellipsoid(density, self.radii)

    def support(self, direction: Vector) -> Vector:
        radii = jnp.asarray(self.radii)
        scaled = radii * jnp.asarray(direction)
        # Along no direction at all the x axis is as good as any.
        return radii * unit_or(scaled, jnp.zeros_like(scaled).at[..., 0].set(1.0))


class Box(Shape):
    """Box about the origin with half edges `half_extents` (3,) along x, y, z."""

    half_extents: Vector = quantity((3,), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_box(density, self.half_extents)

    def support(self, direction: Vector) -> Vector:
        return jnp.asarray(self.half_extents) * _sign(jnp.asarray(direction))


class Cylinder(Shape):
    """Cylinder about the origin along z."""

    radius: Scalar = quantity((), positive=True, unit="m")
    half_height: Scalar = quantity((), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_cylinder(density, self.radius, self.half_height)

    def support(self, direction: Vector) -> Vector:
        x, y, z = components(jnp.asarray(direction))
        across = jnp.asarray(self.radius)[..., None] * _unit_across(x, y)
        return stack(*components(across), self.half_height * _sign(z))


class Capsule(Shape):
    """Cylinder along z of `half_height` with half spheres of `radius` beyond its ends."""

    radius: Scalar = quantity((), positive=True, unit="m")
    half_height: Scalar = quantity((), nonnegative=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_capsule(density, self.radius, self.half_height)

    def support(self, direction: Vector) -> Vector:
        z = components(jnp.asarray(direction))[2]
        return stack(jnp.zeros_like(z), jnp.zeros_like(z), self.half_height * _sign(z))

    @property
    def rounding(self) -> Scalar:
        return self.radius


class Cone(Shape):
    """Cone along z with its base in the plane z = 0 and its tip at z = `height`."""

    radius: Scalar = quantity((), positive=True, unit="m")
    height: Scalar = quantity((), positive=True, unit="m")

    def mass_properties(self, density: Scalar) -> MassProperties:
        return closed_form.of_cone(density, self.radius, self.height)

    def support(self, direction: Vector) -> Vector:
        x, y, z = components(jnp.asarray(direction))
        across = jnp.asarray(self.radius)[..., None] * _unit_across(x, y)
        tip = self.height * z >= self.radius * norm(stack(x, y))
        rim_x, rim_y = components(across)
        zero = jnp.zeros_like(z)
        return stack(
            jnp.where(tip, zero, rim_x), jnp.where(tip, zero, rim_y), jnp.where(tip, self.height, zero)
        )


class HalfSpace(Shape):
    """All points x with `normal` · x ≤ `offset`: ground, walls. It has no end, so no mass, and never moves by itself.

    `normal` (3,) points out of the solid and is made a unit vector at construction; `offset` [m] is the distance of
    the plane from the origin along it.

    Raises:
        InvalidInput: a normal of length zero.
    """

    normal: Vector = quantity((3,), default=(0.0, 0.0, 1.0))
    offset: Scalar = quantity((), unit="m", default=0.0)

    def __post_init__(self):
        super().__post_init__()
        check_direction("HalfSpace.normal", self.normal)
        if isinstance(self.normal, np.ndarray):
            normal = self.normal / np.abs(self.normal).max(axis=-1, keepdims=True)
            object.__setattr__(self, "normal", normal / np.linalg.norm(normal, axis=-1, keepdims=True))
            return
        object.__setattr__(self, "normal", unit_or(self.normal, jnp.zeros_like(self.normal)))

    def mass_properties(self, density: Scalar) -> MassProperties:
        raise WrongStructure(
            "HalfSpace: it has no end and so no mass; make it something that bodies touch, not a body"
        )


class Pose(eqx.Module):
    """Position (3,) [m] and orientation of one frame in another."""

    position: Vector
    orientation: Rotation

    def __post_init__(self):
        if isinstance(self.position, (list, tuple)):
            self.position = as_array("Pose.position", self.position)

    @classmethod
    def identity(cls, dtype=None) -> "Pose":
        """The frame itself."""
        return cls(jnp.zeros(3, dtype), Quaternion.identity(dtype))

    def compose(self, inner: "Pose") -> "Pose":
        """Where a frame stands that has the pose `inner` in this one."""
        turned = type(self.orientation).from_rotation(inner.orientation)
        position = jnp.asarray(self.position) + self.orientation.rotate(jnp.asarray(inner.position))
        return Pose(position, self.orientation @ turned)


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

    def support(self, direction: Vector) -> Vector:
        """The farthest point of all parts with their roundings: the support map of the composite's convex hull.

        A composite need not be convex, so distances are taken part by part and never from this.
        """
        direction = jnp.asarray(direction)
        best: Any = None
        for shape, pose in self.parts:
            point = pose.position + pose.orientation.rotate(
                shape.farthest(pose.orientation.unrotate(direction))
            )
            reach = jnp.sum(point * direction, axis=-1, keepdims=True)
            best = (point, reach) if best is None else _farther(best, (point, reach))
        return best[0]

    def __check_init__(self):
        if not self.parts or not all(isinstance(s, Shape) and isinstance(p, Pose) for s, p in self.parts):
            raise WrongStructure("Composite.parts: give at least one pair (shape, Pose)")


def _sign(x: Scalar) -> Scalar:
    """±1, and 1 at zero: a corner is chosen where a whole face is equally far."""
    return jnp.where(x >= 0, 1.0, -1.0).astype(jnp.result_type(x))


def _unit_across(x: Scalar, y: Scalar) -> Any:
    """The direction (..., 2) across the z axis; zero along the axis, where the middle of the end face will do."""
    across = stack(x, y)
    return unit_or(across, jnp.zeros_like(across))


def _farther(one: tuple[Any, Any], other: tuple[Any, Any]) -> tuple[Any, Any]:
    first = one[1] >= other[1]
    return jnp.where(first, one[0], other[0]), jnp.where(first, one[1], other[1])
