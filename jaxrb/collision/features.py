"""Derivatives of a contact: what the answer does when the features that touch stay the same.

The search finds which vertices are nearest and with which weights; no derivative passes through it. The answer as a
function of these few vertices alone is a closed form, and its derivatives of every order are those of the contact, up
to the places where the nearest features change. The distance then obeys the envelope rule d(distance) = n·(db − da)
with the witnesses held by their bodies; its second derivative has the curvature of the features.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide, unit_or
from jaxrb.math.vector import cross, dot


@jax.custom_jvp
def with_derivatives_of(value: Array, model: Array) -> Array:
    """`value` with the derivatives of `model`, which is the same number in a form that can be differentiated.

    Where no derivative is asked for the model is never computed.
    """
    del model
    return value


@with_derivatives_of.defjvp
def _tangent(primals: Any, tangents: Any) -> Any:
    value, model = primals
    return with_derivatives_of(value, model), tangents[1]


def of_polytopes(
    distance: Scalar, normal: Vector, weights: Vector, corners_a: Array, corners_b: Array
) -> Any:
    """Distance, normal (3,) and witnesses (3,) of the hulls of three corners (3, 3) each, all in one frame.

    The found numbers are kept; the derivatives are those of the plane, line or point that the differences of the
    corners with positive weight span. Where the shapes just touch at an edge or corner the normal has none, and gets
    zero.
    """
    order = jnp.argsort(-weights)
    differences = (corners_a - corners_b)[order]
    count = jnp.sum(weights > 0)
    model = _normal(differences, distance, normal, count)
    normal = with_derivatives_of(normal, model)
    # All corners in use lie at the same height along the normal, so fixed weights give the exact height.
    distance = with_derivatives_of(distance, -dot(normal, weights @ (corners_a - corners_b)))
    shares = _shares(differences, count)
    weights = with_derivatives_of(weights, jnp.zeros_like(weights).at[order].set(shares))
    return distance, normal, weights @ corners_a, weights @ corners_b


def _normal(differences: Array, distance: Scalar, normal: Vector, count: Any) -> Vector:
    """The unit normal from a to b of the plane, or of the line or point nearest to the origin."""
    y = differences[0]
    side = jnp.where(count > 1, differences[1] - y, 0.0)
    plane = cross(side, jnp.where(count > 2, differences[2] - y, 0.0))
    away = y - side * divide(dot(y, side), dot(side, side))
    size = jnp.max(jnp.abs(differences))
    # Of a difference that is all round-off the direction means nothing.
    known = jnp.abs(distance) > 64 * jnp.finfo(y.dtype).eps * size
    vector = jnp.where(count > 2, plane, jnp.where(known, away, 0.0))
    vector = vector * jnp.where(dot(jax.lax.stop_gradient(vector), normal) < 0, -1.0, 1.0)
    return unit_or(vector, normal)


def _shares(differences: Array, count: Any) -> Vector:
    """Weights (3,) of the point nearest to the origin on the plane or line through the first `count` points."""
    y = differences[0]
    first = jnp.where(count > 1, differences[1] - y, 0.0)
    second = jnp.where(count > 2, differences[2] - y, 0.0)
    a, b, c = dot(first, first), dot(first, second), dot(second, second)
    f, g = -dot(first, y), -dot(second, y)
    determinant = a * c - b * b
    s = jnp.where(count > 2, divide(f * c - g * b, determinant), divide(f, a))
    t = jnp.where(count > 2, divide(a * g - b * f, determinant), 0.0)
    return jnp.stack([1.0 - s - t, s, t])


class Side(NamedTuple):
    """What one shape contributes: three points (3, 3) of its material, and its support map if it is smooth."""

    points: Array
    support: Callable[[Vector], Vector] | None


def of_smooth(distance: Scalar, normal: Vector, weights: Vector, a: Side, b: Side) -> Any:
    """As `of_polytopes`, where at least one shape is smooth.

    The normal follows from its own equation, that the difference w = a − b of the nearest points is along it: across
    it (J + distance) dn = −dw, with J the curvature of the support functions, and dn·e = −n·de for an edge e that
    touches. First derivatives of everything and second ones of the distance are exact; second ones of the normal are
    not. Where a flat of a cylinder or cone touches, its points are held by the material.
    """
    values = jax.lax.stop_gradient(normal)
    points, bends, edges = [], jnp.zeros((3, 3), normal.dtype), []
    for side, sign in ((a, 1.0), (b, -1.0)):
        fixed = weights @ side.points
        if side.support is None:
            points.append((fixed, None))
            edges.append(side.points - side.points[jnp.argmax(weights)])
            continue
        support = side.support
        at = support(sign * values)
        size = jnp.max(jnp.abs(at - fixed)) <= 1e-4 * jnp.max(jnp.abs(side.points))
        smooth = jax.lax.stop_gradient(size)
        points.append((jnp.where(smooth, at, fixed), (support, smooth, fixed)))
        bend = jax.jacfwd(support)(sign * values)
        bends = bends + jnp.where(smooth, jax.lax.stop_gradient(bend), 0.0)
        edges.append(jnp.where(smooth, 0.0, side.points - side.points[jnp.argmax(weights)]))
    edge = jnp.where((weights > 0)[:, None], edges[0] - edges[1], 0.0)
    normal = with_derivatives_of(
        normal, _bent_normal(points[0][0] - points[1][0], values, distance, bends, edge)
    )
    nearest = []
    for (fixed, moving), sign in zip(points, (1.0, -1.0)):
        if moving is None:
            nearest.append(fixed)
        else:
            support, smooth, material = moving
            nearest.append(jnp.where(smooth, support(sign * normal), material))
    found = [weights @ side.points for side in (a, b)]
    distance = with_derivatives_of(distance, -dot(normal, nearest[0] - nearest[1]))
    witnesses = [with_derivatives_of(jax.lax.stop_gradient(x), y) for x, y in zip(found, nearest)]
    return distance, normal, *witnesses


def _bent_normal(w: Vector, normal: Vector, distance: Scalar, bends: Array, edges: Array) -> Vector:
    """The unit vector solving the normal's equation to first order about its value."""
    lengths = jnp.sum(edges * edges, axis=-1)
    edge = edges[jnp.argmax(lengths)]
    plane = cross(edges[0], edges[1]) + cross(edges[1], edges[2]) + cross(edges[2], edges[0])
    longest = jnp.max(lengths)
    has_edge = longest > 0
    has_plane = dot(plane, plane) > 1e-6 * longest * longest
    frozen = jax.lax.stop_gradient(edge)
    axis = jnp.zeros_like(normal).at[jnp.argmin(jnp.abs(normal))].set(1.0)
    first = unit_or(jnp.where(has_edge, frozen - dot(frozen, normal) * normal, cross(normal, axis)), axis)
    second = cross(normal, first)
    d = jax.lax.stop_gradient(distance)
    a, b, c = first @ bends @ first + d, first @ bends @ second, second @ bends @ second + d
    r, s = -dot(first, w), -dot(second, w)
    r, s = r - jax.lax.stop_gradient(r), s - jax.lax.stop_gradient(s)
    along = jnp.where(
        has_edge, -divide(dot(edge, normal), dot(frozen, first)), divide(r * c - s * b, a * c - b * b)
    )
    along = along - jax.lax.stop_gradient(along)
    across = jnp.where(has_edge, divide(s - b * along, c), divide(a * s - b * r, a * c - b * b))
    bent = normal + along * first + across * second
    upright = plane * jnp.where(dot(jax.lax.stop_gradient(plane), normal) < 0, -1.0, 1.0)
    return unit_or(jnp.where(has_plane, upright, bent), normal)
