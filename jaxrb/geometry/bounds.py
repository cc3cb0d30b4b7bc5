"""Bounding volumes: sphere, axis-aligned box, oriented box; each holds its solid and is as tight as stated.

An AABB follows from the support map in six directions and has derivatives in shape and pose. Spheres and oriented boxes
of points are found on the host, once a shape, and move with its pose; those of closed forms have derivatives.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.checks import is_concrete
from jaxrb.errors import WrongStructure
from jaxrb.geometry.bounds_points import smallest_ball, tight_box
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.mesh import TriangleMesh
from jaxrb.geometry.primitives import Box, Capsule, Composite, Cone, Cylinder, Ellipsoid, Pose, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.safe import norm, normalise


class BoundingSphere(eqx.Module):
    """All points within `radius` [m] of `center` (3,) [m]."""

    center: Vector
    radius: Scalar

    def moved(self, pose: Pose) -> "BoundingSphere":
        """Of the shape at a pose."""
        return BoundingSphere(pose.position + pose.orientation.rotate(jnp.asarray(self.center)), self.radius)

    @property
    def volume(self) -> Scalar:
        """[m³]."""
        return 4.0 / 3.0 * np.pi * self.radius**3


class AxisAlignedBox(eqx.Module):
    """From `low` (3,) to `high` (3,) [m] along the axes of its frame."""

    low: Vector
    high: Vector

    @property
    def volume(self) -> Scalar:
        """[m³]."""
        return jnp.prod(self.high - self.low, axis=-1)


class OrientedBox(eqx.Module):
    """A box of `half_extents` (3,) [m] whose centre and axes are those of `pose`."""

    pose: Pose
    half_extents: Vector

    def moved(self, pose: Pose) -> "OrientedBox":
        """Of the shape at a pose."""
        position = pose.position + pose.orientation.rotate(jnp.asarray(self.pose.position))
        own = type(pose.orientation).from_rotation(self.pose.orientation)
        return OrientedBox(Pose(position, pose.orientation @ own), self.half_extents)

    @property
    def volume(self) -> Scalar:
        """[m³]."""
        return 8.0 * jnp.prod(self.half_extents, axis=-1)


def bounding_box(shape: Shape, pose: Pose | None = None) -> AxisAlignedBox:
    """The smallest axis-aligned box of a shape, in the frame in which `pose` places it (by default its own).

    Exact, and differentiable in shape and pose. Unbounded shapes reach to infinity.
    """
    if isinstance(shape, Composite):
        boxes = [bounding_box(part, own if pose is None else pose.compose(own)) for part, own in shape.parts]
        low = functools.reduce(jnp.minimum, [box.low for box in boxes])
        return AxisAlignedBox(low, functools.reduce(jnp.maximum, [box.high for box in boxes]))
    if isinstance(shape, TriangleMesh):
        vertices = jnp.asarray(shape.vertices)
        if pose is not None:
            vertices = pose.position + jax.vmap(pose.orientation.rotate)(vertices)
        return AxisAlignedBox(vertices.min(axis=0), vertices.max(axis=0))
    axes = jnp.concatenate([jnp.eye(3), -jnp.eye(3)])
    axes = axes.astype(jnp.result_type(*jax.tree.leaves((shape, pose)), jnp.float32))
    if pose is None:
        reach = jax.vmap(lambda axis: shape.farthest(axis))(axes)
    else:
        # The farthest point along a world axis is the farthest along that axis as the shape sees it.
        reach = jax.vmap(
            lambda axis: pose.orientation.rotate(shape.farthest(pose.orientation.unrotate(axis)))
        )(axes)
        reach = pose.position + reach
    return AxisAlignedBox(jnp.diagonal(reach[3:]), jnp.diagonal(reach[:3]))


def bounding_sphere(shape: Shape) -> BoundingSphere:
    """The smallest sphere of a shape in its own frame; of a composite one that is close to it."""
    return _sphere(shape)


def oriented_box(shape: Shape) -> OrientedBox:
    """A tight oriented box of a shape in its own frame.

    Primitives lie along their own axes. Of points (hull, mesh, composite): the smallest of the boxes that are flush
    with a face or with two edges of the hull, turned about each of its axes in turn until none helps; O'Rourke 1985,
    "Finding minimal enclosing boxes": the smallest box has two faces flush with edges.
    """
    if isinstance(shape, (ConvexHull, TriangleMesh, Composite)):
        points = _outline(shape)
        axes, low, high = tight_box(points)
        middle = axes @ (0.5 * (low + high))
        dtype = jax.dtypes.canonicalize_dtype(float)
        pose = Pose(jnp.asarray(middle, dtype), RotationMatrix(jnp.asarray(axes, dtype)))
        return OrientedBox(pose, jnp.asarray(0.5 * (high - low), dtype))
    box = bounding_box(shape)
    identity = RotationMatrix.identity(box.low.dtype)
    return OrientedBox(Pose(0.5 * (box.low + box.high), identity), 0.5 * (box.high - box.low))


def spheres_gap(a: BoundingSphere, b: BoundingSphere) -> Scalar:
    """Distance [m] of two spheres' surfaces, negative where they overlap."""
    return norm(b.center - a.center) - a.radius - b.radius


def boxes_gap(a: AxisAlignedBox, b: AxisAlignedBox) -> Scalar:
    """The largest gap [m] of two axis-aligned boxes along an axis: negative where they overlap, ≤ the distance."""
    return jnp.max(jnp.maximum(b.low - a.high, a.low - b.high), axis=-1)


@functools.singledispatch
def _sphere(shape: Any) -> BoundingSphere:
    raise WrongStructure(f"bounding_sphere: {type(shape).__name__} has no bounding sphere")


@_sphere.register
def _(shape: Sphere) -> BoundingSphere:
    return _about_origin(jnp.asarray(shape.radius))


@_sphere.register
def _(shape: Ellipsoid) -> BoundingSphere:
    return _about_origin(jnp.max(jnp.asarray(shape.radii)))


@_sphere.register
def _(shape: Box) -> BoundingSphere:
    return _about_origin(norm(jnp.asarray(shape.half_extents)))


@_sphere.register
def _(shape: Cylinder) -> BoundingSphere:
    return _about_origin(jnp.hypot(jnp.asarray(shape.radius), jnp.asarray(shape.half_height)))


@_sphere.register
def _(shape: Capsule) -> BoundingSphere:
    return _about_origin(jnp.asarray(shape.radius) + jnp.asarray(shape.half_height))


@_sphere.register
def _(shape: Cone) -> BoundingSphere:
    """A flat cone is bounded by its base; of a steep one tip and rim lie on the sphere."""
    radius, height = jnp.asarray(shape.radius), jnp.asarray(shape.height)
    steep = height > radius
    center = jnp.where(steep, 0.5 * (height - radius**2 / jnp.where(steep, height, 1.0)), 0.0)
    bound = jnp.where(steep, height - center, radius)
    return BoundingSphere(center * jnp.asarray([0.0, 0.0, 1.0], center.dtype), bound)


@_sphere.register
def _(shape: ConvexHull) -> BoundingSphere:
    return _of_points(shape)


@_sphere.register
def _(shape: TriangleMesh) -> BoundingSphere:
    return _of_points(shape)


@_sphere.register
def _(shape: Composite) -> BoundingSphere:
    """Spheres joined one after another, largest first: each join is the smallest sphere of two."""
    found = None
    for part, pose in shape.parts:
        sphere = _sphere(part).moved(pose)
        found = sphere if found is None else _joined(found, sphere)
    assert found is not None
    return found


def _about_origin(radius: Any) -> BoundingSphere:
    return BoundingSphere(jnp.zeros(3, radius.dtype), radius)


def _joined(a: BoundingSphere, b: BoundingSphere) -> BoundingSphere:
    between = b.center - a.center
    apart = norm(between)
    radius = jnp.maximum(jnp.maximum(a.radius, b.radius), 0.5 * (a.radius + b.radius + apart))
    inside = radius <= jnp.maximum(a.radius, b.radius)
    larger = jnp.where(a.radius >= b.radius, a.center, b.center)
    return BoundingSphere(
        jnp.where(inside, larger, a.center + (radius - a.radius) * normalise(between)), radius
    )


def _of_points(shape: Any) -> BoundingSphere:
    center, radius = smallest_ball(_host_points(shape))
    dtype = jax.dtypes.canonicalize_dtype(float)
    return BoundingSphere(jnp.asarray(center, dtype), jnp.asarray(radius, dtype))


def _host_points(shape: Any) -> np.ndarray:
    if not is_concrete(shape.vertices):
        raise WrongStructure(
            f"{type(shape).__name__}: sphere and oriented box of points are found on the host and cannot be traced; "
            "find them before, or take bounding_box"
        )
    return np.asarray(shape.vertices, float)


def _outline(shape: Shape) -> np.ndarray:
    """Points (n, 3) whose hull holds the shape: its own corners, or those of the boxes of its parts."""
    if isinstance(shape, (ConvexHull, TriangleMesh)):
        return _host_points(shape)
    if isinstance(shape, Composite):
        return np.concatenate([_placed(_outline(part), pose) for part, pose in shape.parts])
    box = bounding_box(shape)
    low, high = np.asarray(box.low, float), np.asarray(box.high, float)
    return np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (high - low) + low


def _placed(points: np.ndarray, pose: Pose) -> np.ndarray:
    return points @ np.asarray(pose.orientation.as_matrix(), float).T + np.asarray(pose.position, float)
