"""Shapes as triangles with normals, for pictures: the viewer and files for other programs draw the same surfaces."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxrb.geometry.bounds import bounding_box
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.mesh import TriangleMesh
from jaxrb.geometry.primitives import Box, Capsule, Composite, Cone, Cylinder, Ellipsoid, Pose, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.quaternion import Quaternion

_AROUND, _RINGS = 40, 20  # pieces around an axis, and from pole to pole: a sphere's outline is off by 0.3 %
_CREASE = np.cos(np.deg2rad(35.0))  # faces that meet at a sharper turn show an edge


@dataclass(frozen=True, eq=False)
class Surface:
    """`vertices` and outward unit `normals` (v, 3) in float32, `triangles` (t, 3) anticlockwise from outside."""

    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True, eq=False)
class Part:
    """A surface, stretched by `scale` (3,), then placed at `position` (3,) [m], `orientation` wxyz (4,)."""

    surface: Surface
    scale: np.ndarray
    position: np.ndarray
    orientation: np.ndarray
    exact: bool = True  # False: the shape's bounding box stands for it

    def points(self) -> np.ndarray:
        """The vertices (v, 3) [m] where the part is."""
        return self.surface.vertices * self.scale @ matrix_of(self.orientation).T + self.position


def parts_of(shape: Shape) -> list[Part]:
    """A bounded shape's parts in its own frame; those of a composite one after another.

    A shape of a kind of one's own is drawn as its bounding box, and its part says so.
    """
    if isinstance(shape, Composite):
        return [placed(part, pose) for inner, pose in shape.parts for part in parts_of(inner)]
    surface, scale, exact = _drawn(shape)
    scale = np.broadcast_to(np.asarray(scale, float), (3,))
    return [Part(surface, scale, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), exact)]


def placed(part: Part, pose: Pose) -> Part:
    """The part in the frame in which `pose` places its own."""
    turn = quaternion_of(pose.orientation)
    position = np.asarray(pose.position, float) + matrix_of(turn) @ part.position
    return Part(part.surface, part.scale, position, product(turn, part.orientation), part.exact)


def quaternion_of(rotation: Any) -> np.ndarray:
    """Unit quaternions wxyz (..., 4) of any rotation, in float64 on the host."""
    array = np.asarray(_as_quaternion(rotation), float)
    return array / np.linalg.norm(array, axis=-1, keepdims=True)


def matrix_of(q: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of a unit quaternion wxyz (4,)."""
    w, x, y, z = q
    v = np.array([x, y, z])
    star = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * star


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a ⊗ b of quaternions wxyz (4,): first b, then a."""
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.append(a[0] * b[0] - a[1:] @ b[1:], vector)


def _as_quaternion(rotation: Any) -> Any:
    if isinstance(rotation, Quaternion):
        return rotation.as_quaternion_array()
    return jax.jit(Quaternion.from_rotation)(rotation).as_quaternion_array()


@functools.singledispatch
def _drawn(shape: Any) -> tuple[Surface, Any, bool]:
    """A surface, how to stretch it, and whether that is the shape itself."""
    box = bounding_box(shape)
    low, high = np.asarray(box.low, float), np.asarray(box.high, float)
    signs = 0.5 * (high - low) * _cube().vertices + 0.5 * (high + low)
    return Surface(signs.astype(np.float32), _cube().normals, _cube().triangles), 1.0, False


@_drawn.register
def _(shape: Sphere) -> tuple[Surface, Any, bool]:
    return _ball(), shape.radius, True


@_drawn.register
def _(shape: Ellipsoid) -> tuple[Surface, Any, bool]:
    return _ball(), shape.radii, True


@_drawn.register
def _(shape: Box) -> tuple[Surface, Any, bool]:
    return _cube(), shape.half_extents, True


@_drawn.register
def _(shape: Cylinder) -> tuple[Surface, Any, bool]:
    return _rod(), np.array([shape.radius, shape.radius, shape.half_height], float), True


@_drawn.register
def _(shape: Cone) -> tuple[Surface, Any, bool]:
    return _spike(), np.array([shape.radius, shape.radius, shape.height], float), True


@_drawn.register
def _(shape: Capsule) -> tuple[Surface, Any, bool]:
    return _capsule(float(shape.half_height) / float(shape.radius)), shape.radius, True


@_drawn.register
def _(shape: ConvexHull) -> tuple[Surface, Any, bool]:
    return creased(np.asarray(shape.vertices, float), np.asarray(shape.triangles)), 1.0, True


@_drawn.register
def _(shape: TriangleMesh) -> tuple[Surface, Any, bool]:
    return creased(np.asarray(shape.vertices, float), np.asarray(shape.triangles.triangles)), 1.0, True


@functools.cache
def _cube() -> Surface:
    """±1 along each axis."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return creased(signs, np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]))


@functools.cache
def _ball() -> Surface:
    arc = _arc(-0.5 * np.pi, 0.5 * np.pi, _RINGS)
    return _revolved([(arc, arc)])


@functools.cache
def _rod() -> Surface:
    """Radius 1, from z = −1 to 1."""
    strips = [
        ([(0, -1), (1, -1)], [(0, -1)] * 2), ([(1, -1), (1, 1)], [(1, 0)] * 2), ([(1, 1), (0, 1)], [(0, 1)] * 2)
    ]  # fmt: skip
    return _revolved(strips)


@functools.cache
def _spike() -> Surface:
    """Radius 1 in the plane z = 0, tip at z = 1."""
    slope = np.sqrt(0.5)
    return _revolved([([(0, 0), (1, 0)], [(0, -1)] * 2), ([(1, 0), (0, 1)], [(slope, slope)] * 2)])


@functools.cache
def _capsule(half_height: float) -> Surface:
    """Of radius 1."""
    lower, upper = _arc(-0.5 * np.pi, 0.0, _RINGS // 2), _arc(0.0, 0.5 * np.pi, _RINGS // 2)
    end = np.array([0.0, half_height])
    line = np.concatenate([lower - end, upper + end])
    return _revolved([(line, np.concatenate([lower, upper]))])


def _arc(start: float, end: float, pieces: int) -> np.ndarray:
    angle = np.linspace(start, end, pieces + 1)
    return np.stack([np.maximum(np.cos(angle), 0.0).round(15), np.sin(angle)], axis=-1)


def _revolved(strips: Sequence[tuple[Any, Any]]) -> Surface:
    """Lines (k, 2) of radius and height, from below outside to above, with normals (k, 2), turned about z."""
    vertices, normals, triangles, count = [], [], [], 0
    angle = 2.0 * np.pi * np.arange(_AROUND + 1) / _AROUND
    c, s, one = np.cos(angle), np.sin(angle), np.ones_like(angle)
    for line, across in strips:
        for rows, kept in ((line, vertices), (across, normals)):
            rows = np.asarray(rows, float)
            r, z = rows[:, :1], rows[:, 1:]
            kept.append(np.stack([r * c, r * s, z * one], axis=-1).reshape(-1, 3))
        i, j = np.meshgrid(np.arange(len(line) - 1), np.arange(_AROUND), indexing="ij")
        here = count + i * (_AROUND + 1) + j
        above = here + _AROUND + 1
        triangles += [np.stack([here, here + 1, above + 1], -1), np.stack([here, above + 1, above], -1)]
        count += len(line) * (_AROUND + 1)
    points, faces = np.concatenate(vertices), np.concatenate([t.reshape(-1, 3) for t in triangles])
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=-1) > 1e-12]  # at the poles a ring is a point
    return Surface(points.astype(np.float32), np.concatenate(normals).astype(np.float32), faces)


def creased(vertices: np.ndarray, triangles: np.ndarray) -> Surface:
    """Triangles (t, 3) of points (n, 3) with normals that are smooth over gentle turns and split at sharp ones."""
    corners = vertices[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(area, axis=-1, keepdims=True)
    unit = np.divide(area, length, out=np.zeros_like(area), where=length > 0)
    at = triangles.ravel()
    order, degree = np.argsort(at, kind="stable"), np.bincount(at, minlength=len(vertices))
    first = np.cumsum(degree) - degree
    # Every corner beside every other one at its vertex.
    times = degree[at]
    here = np.repeat(np.arange(len(at)), times)
    there = order[
        np.arange(len(here)) - np.repeat(np.cumsum(times) - times, times) + np.repeat(first[at], times)
    ]
    alike = np.einsum("ci,ci->c", unit[here // 3], unit[there // 3]) >= _CREASE
    joined = area[there // 3] * alike[:, None]
    normals = np.stack([np.bincount(here, joined[:, i], len(at)) for i in range(3)], axis=-1)
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.divide(normals, size, out=np.repeat(unit, 3, axis=0), where=size > 0)
    rows = np.concatenate([corners.reshape(-1, 3), normals.round(6)], axis=-1).astype(np.float32)
    rows, faces = np.unique(rows, axis=0, return_inverse=True)
    return Surface(rows[:, :3], rows[:, 3:], faces.reshape(-1, 3))
