"""Where a shape stands on a half-space: its lowest points, well apart, as vectors in W from the shape's centre."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxrb.collision.manifold import Manifold
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.primitives import Box, Capsule, Cone, Cylinder, Ellipsoid, HalfSpace, Pose, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.safe import unit_or
from jaxrb.math.vector import cross, dot

# Vertices of a hull that lie off the plane of its lowest face by less than this share of its size belong to the face.
_FLAT = 1e-4
# Points as near to each other, or to the line through two others, are one (as share of the face's size).
_SAME = 1e-3


class Lowest(NamedTuple):
    """Points of a core: from its centre in W (k, 3) [m], what they are called (k,), which there are (k,)."""

    points: Array
    feature: Array
    valid: Array


def touch_plane(plane: HalfSpace, pose_plane: Pose, shape: Shape, pose: Pose) -> Manifold:
    """The points of a shape that can carry it on a half-space, each with its own exact distance.

    The deepest is among them. Box: the face that looks most at the plane. Cylinder: on the lower end disc the lowest
    point of the rim and two more at 120°, and the lowest of the other end, so that it can stand, lean and lie; cone
    likewise, with its tip. Hull: the lowest vertex and then vertices of the lowest face, far apart.
    """
    normal = pose_plane.orientation.rotate(plane.normal)
    above = dot(normal, pose.position - pose_plane.position) - plane.offset
    lowest = _LOWEST[type(shape)](shape, pose.orientation, normal)
    normals = jnp.broadcast_to(normal, lowest.points.shape)
    rounding = jnp.asarray(shape.rounding)
    distance = above + dot(normals, lowest.points) - rounding
    shift = rounding + 0.5 * distance
    parts = zip(components(pose.position), components(lowest.points), components(normals))
    middle = stack(*(jnp.where(lowest.valid, origin + (p - shift * n), 0.0) for origin, p, n in parts))
    return Manifold(
        middle,
        normal,
        jnp.where(lowest.valid, distance, 0.0),
        jnp.where(lowest.valid, lowest.feature, -1),
        lowest.valid,
        jnp.zeros((), bool),
    )


def _rows(points: list[Vector]) -> Array:
    """Points (3,) one below the other, (k, 3)."""
    return stack(*(stack(*parts) for parts in zip(*(components(p) for p in points))))


def _names(*names: Any) -> Array:
    return stack(*(jnp.asarray(name, jnp.int32) for name in names))


def _sphere(shape: Sphere, turn: Any, normal: Vector) -> Lowest:
    return Lowest(jnp.zeros_like(normal)[None], jnp.zeros(1, jnp.int32), jnp.ones(1, bool))


def _ellipsoid(shape: Ellipsoid, turn: Any, normal: Vector) -> Lowest:
    return Lowest(
        turn.rotate(shape.support(-turn.unrotate(normal)))[None], jnp.zeros(1, jnp.int32), jnp.ones(1, bool)
    )


def _capsule(shape: Capsule, turn: Any, normal: Vector) -> Lowest:
    up = turn.as_matrix()[:, 2] * shape.half_height
    return Lowest(_rows([up, -up]), jnp.arange(2, dtype=jnp.int32), jnp.ones(2, bool))


def _box(shape: Box, turn: Any, normal: Vector) -> Lowest:
    half, columns = components(shape.half_extents), turn.as_matrix()
    axes = [components(columns[:, k]) for k in range(3)]
    lean = [sum(p * n for p, n in zip(axis, components(normal))) for axis in axes]
    sides = [[h * x for x in axis] for h, axis in zip(half, axes)]
    size = [jnp.abs(x) for x in lean]
    first = (size[0] >= size[1]) & (size[0] >= size[2])
    second = ~first & (size[1] >= size[2])
    # The axis across the face, pointing down, and the two along it; numbers 1, 2, 4 are what a corner's signs add.
    down = _of_three(first, second, [-_sign(x) for x in lean])
    orders = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    across, u, w = (
        [_of_three(first, second, [sides[order[k]][i] for order in orders]) for i in range(3)]
        for k in range(3)
    )
    bits = [_of_three(first, second, [jnp.int32(1 << order[k]) for order in orders]) for k in range(3)]
    fixed = jnp.where(down > 0, bits[0], 0)
    points, names = [], []
    for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        points.append(stack(*(down * p + (a * q + b * r) for p, q, r in zip(across, u, w))))
        names.append(fixed + (bits[1] if a > 0 else 0) + (bits[2] if b > 0 else 0))
    return Lowest(_rows(points), _names(*names), jnp.ones(4, bool))


def _of_three(first: Array, second: Array, values: list[Any]) -> Any:
    return jnp.where(first, values[0], jnp.where(second, values[1], values[2]))


def _sign(x: Scalar) -> Scalar:
    return jnp.where(x < 0, -1.0, 1.0).astype(x.dtype)


def _cylinder(shape: Cylinder, turn: Any, normal: Vector) -> Lowest:
    columns = turn.as_matrix()
    up = columns[:, 2] * shape.half_height
    rise = dot(columns[:, 2], normal)
    end = -_sign(rise)
    rim = [shape.radius * v for v in _rim(columns, normal)]
    own = jnp.where(end > 0, 0, 3)
    points = [end * up + v for v in rim] + [rim[0] - end * up]
    return Lowest(_rows(points), _names(own, own + 1, own + 2, 3 - own), jnp.ones(4, bool))


def _cone(shape: Cone, turn: Any, normal: Vector) -> Lowest:
    columns = turn.as_matrix()
    rim = [shape.radius * v for v in _rim(columns, normal)]
    return Lowest(
        _rows([*rim, columns[:, 2] * shape.height]), jnp.arange(4, dtype=jnp.int32), jnp.ones(4, bool)
    )


def _rim(columns: Array, normal: Vector) -> list[Vector]:
    """Unit vectors in W across the third column: the lowest, and at 120° on both sides of it."""
    axis = columns[:, 2]
    down = axis * dot(axis, normal) - normal
    # Of an upright cylinder's tilt only round-off is left; then the points stay with the body.
    noise = 64 * jnp.finfo(normal.dtype).eps
    steady = dot(down, down) > noise * noise
    first = unit_or(jnp.where(steady, down, columns[:, 0]), columns[:, 0])
    aside = (0.75**0.5) * cross(axis, first)
    return [first, aside - 0.5 * first, -aside - 0.5 * first]


def _hull(shape: ConvexHull, turn: Any, normal: Vector) -> Lowest:
    vertices, down = jnp.asarray(shape.vertices), -turn.unrotate(normal)
    normals = shape.face_normals()
    # Products of rows with one vector as sums over components: never in the low precision of a matrix product.
    number = jnp.argmax(dot(normals, jnp.broadcast_to(down, normals.shape)))
    face = normals[number]
    reach = dot(vertices, jnp.broadcast_to(face, vertices.shape))
    size = jnp.max(jnp.abs(vertices))
    flat = reach[jnp.asarray(shape.faces)[number, 0]] - reach < _FLAT * size
    lowest = jnp.argmax(dot(vertices, jnp.broadcast_to(down, vertices.shape)))
    aside = vertices - vertices[lowest]
    far = jnp.where(flat, dot(aside, aside), -1.0)
    farthest = jnp.argmax(far)
    line = aside[farthest]
    side = dot(jnp.broadcast_to(cross(face, line), aside.shape), aside)
    left, right = jnp.argmax(jnp.where(flat, side, -jnp.inf)), jnp.argmin(jnp.where(flat, side, jnp.inf))
    least = _SAME * dot(line, line)
    valid = [
        jnp.ones((), bool),
        far[farthest] > (_SAME * size) ** 2,
        side[left] > least,
        side[right] < -least,
    ]
    kept = jnp.stack([lowest, farthest, left, right])
    points = turn.rotate(vertices[kept])
    return Lowest(points, kept.astype(jnp.int32), jnp.stack(valid))


_LOWEST: dict[type, Callable[[Any, Any, Vector], Lowest]] = {
    Sphere: _sphere,
    Ellipsoid: _ellipsoid,
    Capsule: _capsule,
    Box: _box,
    Cylinder: _cylinder,
    Cone: _cone,
    ConvexHull: _hull,
}
STANDING = {Sphere: 1, Ellipsoid: 1, Capsule: 2, Box: 4, Cylinder: 4, Cone: 4, ConvexHull: 4}
