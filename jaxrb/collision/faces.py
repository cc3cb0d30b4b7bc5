"""The faces of shapes: the one that looks most along a direction, as edges round it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxrb.checks import is_concrete
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.primitives import Box, Capsule, Pose
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.vector import cross, dot

_MOST_EDGES = 8  # round a face of a hull, unless it is known to have a face of more


class Face(NamedTuple):
    """Edges start → end (k, 3) round a face, anticlockwise along `normal`, of which `there` (k,) are real.

    `alignment`: cosine between normal and the direction asked for. `number` of the face, `corner` (k,) of each start.
    """

    start: Array
    end: Array
    there: Array
    normal: Vector
    alignment: Scalar
    number: Array
    corner: Array
    overflow: Array


def face_along(shape: Shape, direction: Vector) -> Face | None:
    """The face of a shape that looks most along a unit direction, both in its own frame; None for curved shapes."""
    if isinstance(shape, Box):
        return _box_face(jnp.asarray(shape.half_extents), direction)
    if isinstance(shape, ConvexHull):
        return _hull_face(shape, direction)
    if isinstance(shape, Capsule):
        up = jnp.asarray(shape.half_height) * jnp.asarray([0.0, 0.0, 1.0], direction.dtype)
        both = jnp.stack([up, -up])
        # A segment is a face of two edges, back and forth; never the reference.
        none = jnp.asarray(-1.0, direction.dtype)
        corners, no = jnp.arange(2, dtype=jnp.int32), jnp.zeros((), bool)
        return Face(both, both[::-1], jnp.ones(2, bool), direction, none, corners[0], corners, no)
    return None


def _box_face(half: Vector, direction: Vector) -> Face:
    axis = jnp.argmax(jnp.abs(direction))
    sign = jnp.where(direction[axis] < 0, -1.0, 1.0).astype(half.dtype)
    normal = sign * jnp.eye(3, dtype=half.dtype)[axis]
    first = jnp.eye(3, dtype=half.dtype)[(axis + 1) % 3]
    second = sign * jnp.eye(3, dtype=half.dtype)[(axis + 2) % 3]
    signs = jnp.asarray([[1, 1], [-1, 1], [-1, -1], [1, -1]], half.dtype)
    start = half * (normal + signs[:, :1] * first + signs[:, 1:] * second)
    number = (2 * axis + (sign > 0)).astype(jnp.int32)
    corner = jnp.sum(jnp.where(start > 0, jnp.asarray([1, 2, 4], jnp.int32), 0), axis=1, dtype=jnp.int32)
    there, no = jnp.ones(4, bool), jnp.zeros((), bool)
    return Face(start, jnp.roll(start, -1, axis=0), there, normal, dot(normal, direction), number, corner, no)


def _hull_face(hull: ConvexHull, direction: Vector) -> Face:
    normals = hull.face_normals()
    number = jnp.argmax(normals @ direction)
    vertices, edges = jnp.asarray(hull.vertices), jnp.asarray(hull.edges)
    most = _MOST_EDGES
    if is_concrete(hull.edges):
        most = max(most, int(np.bincount(np.asarray(hull.edges)[:, 2:].ravel()).max()))
    # Round-off leaves one plane in several faces: their outline is what has just one of them beside it.
    flat = normals @ normals[number] > 1.0 - 64 * jnp.finfo(normals.dtype).eps
    own = flat[edges[:, 2]] != flat[edges[:, 3]]
    chosen = jnp.argsort(~own, stable=True)[:most]
    there = own[chosen]
    start, end = vertices[edges[chosen, 0]], vertices[edges[chosen, 1]]
    normal = normals[number]
    center = jnp.sum(jnp.where(there[:, None], start + end, 0.0), axis=0) / (2 * jnp.sum(there))
    backward = (
        jnp.einsum("ej,ej->e", cross(jnp.broadcast_to(normal, start.shape), end - start), center - start) < 0
    )
    start, end = (jnp.where(backward[:, None], x, y) for x, y in ((end, start), (start, end)))
    corner = jnp.where(backward, edges[chosen, 1], edges[chosen, 0])
    overflow = jnp.sum(own) > most
    # The plane has the name of its first face, whichever of them looks best by a hair.
    number = jnp.argmax(flat).astype(jnp.int32)
    return Face(start, end, there, normal, dot(normal, direction), number, corner, overflow)


def placed(face: Face, pose: Pose, origin: Vector) -> Face:
    """In W, but about `origin` (3,): far from the origin of W its coordinates have no digits to spare."""
    matrix = pose.orientation.as_matrix()
    offset = pose.position - origin
    return face._replace(
        start=face.start @ matrix.T + offset, end=face.end @ matrix.T + offset, normal=matrix @ face.normal
    )


def padded(face: Face, count: int) -> Face:
    """With as many edges as another, so that either can be chosen."""
    more = count - len(face.there)
    start, end = (jnp.pad(x, ((0, more), (0, 0)), mode="edge") for x in (face.start, face.end))
    there, corner = jnp.pad(face.there, (0, more)), jnp.pad(face.corner, (0, more))
    return face._replace(start=start, end=end, there=there, corner=corner)
