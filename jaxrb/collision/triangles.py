"""Two triangles: whether they meet, and how far apart they are. Many pairs at once, along the last axis.

A triangle is an array (3, 3, ...) of corners and components.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxrb.collision.lanes import cross
from jaxrb.math.arrays import Array
from jaxrb.math.vector import dot_of as dot


def triangles_meet(a: Array, b: Array) -> Array:
    """Whether triangles (3, 3, ...) have a point in common, by the axes that could separate them; touching counts.

    Ericson 2005, "Real-Time Collision Detection", section 5.2.1: two normals and nine products of edges, and for
    triangles in one plane the normals of the edges in it. An axis of length zero separates nothing.
    """
    a, b = _by_component(a - a[0]), _by_component(b - a[0])
    edges_a, edges_b = (jnp.roll(t, -1, axis=1) - t for t in (a, b))
    normal_a, normal_b = (cross(edges[:, :1], edges[:, 1:2]) for edges in (edges_a, edges_b))
    products = cross(edges_a[:, :, None], edges_b[:, None]).reshape(3, 9, *a.shape[2:])
    in_plane = [cross(normal_a, edges_a), cross(normal_b, edges_b)]
    axes = jnp.concatenate([normal_a, normal_b, products, *in_plane], axis=1)
    one, other = (dot(axes[:, None], t[:, :, None]) for t in (a, b))
    return jnp.all((one.min(axis=0) <= other.max(axis=0)) & (other.min(axis=0) <= one.max(axis=0)), axis=0)


class Closest(NamedTuple):
    """Squared distance (...) of two triangles that do not meet, and the nearest point (3, ...) of each."""

    squared: Array
    point_a: Array
    point_b: Array


def closest_points(a: Array, b: Array) -> Closest:
    """The nearest points of triangles (3, 3, ...) that do not meet: of an edge and an edge, or a corner and a face.

    Differentiable to second order within one pair of features.
    """
    lanes = a.shape[2:]
    origin = a[0]
    a, b = _by_component(a - origin), _by_component(b - origin)
    next_a, next_b = jnp.roll(a, -1, axis=1), jnp.roll(b, -1, axis=1)
    edge_a, edge_b = _segments(a[:, :, None], next_a[:, :, None], b[:, None], next_b[:, None])
    foot_on_b, inside_b = _onto_face(a, b)
    foot_on_a, inside_a = _onto_face(b, a)
    points_a = jnp.concatenate([edge_a.reshape(3, 9, *lanes), a, foot_on_a], axis=1)
    points_b = jnp.concatenate([edge_b.reshape(3, 9, *lanes), foot_on_b, b], axis=1)
    between = points_a - points_b
    squared = dot(between, between)
    here = jnp.concatenate([jnp.ones((9, *lanes), bool), inside_b, inside_a])
    best = jnp.argmin(jnp.where(here, squared, jnp.inf), axis=0)

    def chosen(table: Array) -> Array:
        return jnp.take_along_axis(table, best[None], axis=0)[0]

    point_a, point_b = (jnp.stack([chosen(row) for row in points]) for points in (points_a, points_b))
    return Closest(chosen(squared), point_a + origin, point_b + origin)


def _by_component(triangle: Array) -> Array:
    """Components first, then corners."""
    return jnp.swapaxes(triangle, 0, 1)


def _segments(p: Array, p_end: Array, q: Array, q_end: Array) -> tuple[Array, Array]:
    """The nearest points of two segments of some length (Ericson 2005, section 5.1.9)."""
    along_p, along_q, between = p_end - p, q_end - q, p - q
    pp, qq, pq = dot(along_p, along_p), dot(along_q, along_q), dot(along_p, along_q)
    to_p, to_q = dot(along_p, between), dot(along_q, between)
    determinant = pp * qq - pq * pq
    # Of parallel segments any common point will do: the far ends are clamped below.
    skew = determinant > 1e3 * jnp.finfo(pp.dtype).eps * pp * qq
    s = jnp.where(skew, (pq * to_q - to_p * qq) / jnp.where(skew, determinant, 1.0), 0.0)
    s = jnp.clip(s, 0.0, 1.0)
    t = jnp.clip((pq * s + to_q) / qq, 0.0, 1.0)
    s = jnp.clip((pq * t - to_p) / pp, 0.0, 1.0)
    return p + s * along_p, q + t * along_q


def _onto_face(points: Array, triangle: Array) -> tuple[Array, Array]:
    """The feet (3, k, ...) of points (3, k, ...) in the plane of a triangle, and which of them lie inside (k, ...).

    None lies inside a triangle without area.
    """
    edges = jnp.roll(triangle, -1, axis=1) - triangle
    normal = cross(edges[:, :1], edges[:, 1:2])
    squared = dot(normal, normal)
    flat = squared <= 0
    foot = points - normal * (dot(normal, points - triangle[:, :1]) / jnp.where(flat, 1.0, squared))
    inward = cross(jnp.broadcast_to(normal, edges.shape), edges)
    sides = dot(inward[:, :, None], points[:, None] - triangle[:, :, None])
    return foot, jnp.all(sides >= 0, axis=0) & ~flat
