"""What the search for the distance sees of a shape: its core, as corners or as a support map, for many pairs at once.

Sphere, capsule, box and hull are polytopes of corners (with a rounding radius). Ellipsoid, cylinder and cone are
smooth: linear images of one unit solid each. A polytope inscribed in that unit solid stands for them where the search
needs faces.
"""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.collision.arcs import NormalFan
from jaxrb.collision.gjk import Support
from jaxrb.collision.lanes import cross, first_of, gathered, heights, row, unit
from jaxrb.errors import WrongStructure
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.primitives import Box, Capsule, Cone, Cylinder, Ellipsoid, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.settled import settled
from jaxrb.math.vector import dot_of as dot

POLYTOPES = (Sphere, Capsule, Box, ConvexHull)
SMOOTH = (Ellipsoid, Cylinder, Cone)
_BOX_SIGNS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def is_polytope(shape: Shape) -> bool:
    """Whether the core is the hull of `corners`."""
    return isinstance(shape, POLYTOPES)


def corners(shape: Shape) -> Array:
    """The corners (..., n, 3) [m] of a polytope's core, or of the polytope inscribed in a smooth shape."""
    if isinstance(shape, ConvexHull):
        return jnp.asarray(shape.vertices)
    if isinstance(shape, Sphere):
        return jnp.zeros((*jnp.shape(shape.radius), 1, 3), jnp.result_type(shape.radius))
    if isinstance(shape, Capsule):
        half = jnp.asarray(shape.half_height)[..., None, None]
        return half * np.array([[0, 0, -1], [0, 0, 1]], half.dtype)
    if isinstance(shape, Box):
        half = jnp.asarray(shape.half_extents)[..., None, :]
        return half * _BOX_SIGNS.astype(half.dtype)
    stretch = stretches(shape)[..., None, :]
    return stretch * _inscribed(type(shape).__name__)[0].astype(stretch.dtype)


def stretches(shape: Shape) -> Array:
    """The factors (..., 3) that make a smooth shape of its unit solid."""
    if isinstance(shape, Ellipsoid):
        return jnp.asarray(shape.radii)
    if isinstance(shape, Cylinder):
        return _along_axes(shape.radius, shape.half_height)
    if isinstance(shape, Cone):
        return _along_axes(shape.radius, shape.height)
    raise WrongStructure(f"{type(shape).__name__}: no distance between such shapes is known; {_KNOWN}")


_KNOWN = "use Sphere, Capsule, Box, ConvexHull, Ellipsoid, Cylinder, Cone, HalfSpace, or a Composite of these"


def _along_axes(radius: Scalar, height: Scalar) -> Array:
    radius, height = jnp.asarray(radius), jnp.asarray(height)
    return jnp.stack([radius, radius, height], axis=-1)


def placed(vectors: Array, rotation: Array | None, translation: Array | None) -> Array:
    """Vectors (..., n, 3) turned and shifted into a's frame, pairs last: (n, 3, L)."""
    lanes = jnp.moveaxis(vectors, 0, -1)
    if rotation is not None:
        r = jnp.moveaxis(rotation, 0, -1)
        lanes = jnp.stack(
            [r[i, 0] * lanes[:, 0] + r[i, 1] * lanes[:, 1] + r[i, 2] * lanes[:, 2] for i in range(3)], 1
        )
    if translation is not None:
        lanes = lanes + jnp.moveaxis(translation, 0, -1)[None]
    return lanes


def polytope_support(points: Any) -> Support:
    """The support map of points (n, 3, L)."""

    def support(direction: Any) -> tuple[Any, Any]:
        reach = heights(points, direction)
        number = first_of(reach >= reach.max(axis=0))
        return row(points, number), number

    return support


def smooth_support(shape: Shape, rotation: Array | None, translation: Array | None) -> Support:
    """The support map of a smooth shape whose numbers carry a leading axis of pairs."""
    r = None if rotation is None else jnp.moveaxis(rotation, 0, -1)
    t = None if translation is None else jnp.moveaxis(translation, 0, -1)

    def support(direction: Any) -> tuple[Any, Any]:
        own = direction if r is None else jnp.stack([dot(r[:, i], direction) for i in range(3)])
        point = jnp.moveaxis(shape.support(jnp.moveaxis(own, 0, -1)), -1, 0)
        if r is not None:
            point = jnp.stack([dot(r[i], point) for i in range(3)])
        point = point if t is None else point + t
        return point, jnp.zeros(point.shape[-1:], jnp.int32)

    return support


def cosine_of_ruling(shape: Shape) -> Array | None:
    """Between the axis and the normals along whose lines a smooth shape touches; None for one that has no lines."""
    if isinstance(shape, Cylinder):
        return jnp.zeros_like(jnp.asarray(shape.radius))
    if isinstance(shape, Cone):
        radius, height = jnp.asarray(shape.radius), jnp.asarray(shape.height)
        return radius / jnp.sqrt(radius * radius + height * height)
    return None


def normal_fan(shape: Shape, points: Any, rotation: Array | None) -> NormalFan:
    """Faces and edges of a core or of its inscribed polytope whose points (n, 3, L) are placed already."""
    lanes = points.shape[-1]
    if isinstance(shape, (Box, Capsule, Sphere)):
        own, edges = _own_normals(type(shape).__name__)
        edges = jnp.asarray(edges)
        normals = placed(jnp.broadcast_to(own.astype(points.dtype), (1, *own.shape)), rotation, None)
        normals = jnp.broadcast_to(normals, (*normals.shape[:2], lanes))
        return NormalFan(points, normals, edges[:, :1], (edges[:, 2:3], edges[:, 3:4]))
    if isinstance(shape, ConvexHull):
        faces, edges = (jnp.moveaxis(numbers, 0, -1) for numbers in (shape.faces, shape.edges))
    else:
        _, faces, edges = (jnp.asarray(numbers)[..., None] for numbers in _inscribed(type(shape).__name__))
    a, b, c = (
        settled(tuple(gathered(points[:, k], faces[:, corner]) for k in range(3))) for corner in range(3)
    )
    sides = [[end[k] - a[k] for k in range(3)] for end in (b, c)]
    normals = settled(jnp.moveaxis(unit(cross(*sides)), 0, 1))
    own = [sum(normals[:, k] * corner[k] for k in range(3)) for corner in (a, b, c)]
    offsets = settled(jnp.maximum(jnp.maximum(own[0], own[1]), own[2]))
    return NormalFan(points, normals, edges[:, 0], (edges[:, 2], edges[:, 3]), offsets)


@functools.cache
def _own_normals(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Normals (f, 3) that do not depend on sizes, and edges (e, 4) as in a hull."""
    if kind == "Sphere":
        return np.zeros((0, 3)), np.zeros((0, 4), np.int32)
    if kind == "Capsule":
        # A segment as a prism of no width: its normals fill the circle across it, here in four arcs.
        around = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
        return around, np.array([[0, 1, k, (k + 1) % 4] for k in range(4)], np.int32)
    hull = ConvexHull(_BOX_SIGNS)
    a, b, c = (_BOX_SIGNS[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True), hull.edges


@functools.cache
def _inscribed(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners (n, 3), faces (f, 3) and edges (e, 4) of a polytope inside the unit solid, touching it at its corners."""
    angle = np.arange(16) * (np.pi / 8)
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(16)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    if kind == "Cylinder":
        points = np.concatenate([rim - up, rim + up])
    elif kind == "Cone":
        points = np.concatenate([rim, up[None]])
    else:
        golden = (1 + 5**0.5) / 2
        axes = [np.roll([0.0, y, golden * z], k) for k in range(3) for y in (-1, 1) for z in (-1, 1)]
        icosahedron = ConvexHull(np.array(axes))
        ends = np.asarray(icosahedron.vertices)[icosahedron.edges[:, :2]]
        points = np.concatenate([np.asarray(icosahedron.vertices), ends.mean(axis=1)])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points)
    return np.asarray(hull.vertices), np.asarray(hull.faces), np.asarray(hull.edges)


def directions() -> np.ndarray:
    """Unit vectors (42, 3) spread evenly."""
    return _inscribed("Ellipsoid")[0]
