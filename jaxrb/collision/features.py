"""Derivatives of a contact: what the answer does when the features that touch stay the same.

The search finds which vertices are nearest and with which weights; no derivative passes through it. The answer as a
function of these few vertices alone is a closed form, and its derivatives of every order are those of the contact, up to
the places where the nearest features change. The distance then obeys the envelope rule d(distance) = n·(db − da) with
the witnesses held by their bodies; its second derivative has the curvature of the features.
"""

from typing import Any

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

    The found numbers are kept; the derivatives are those of the plane, line or point that the differences of the corners
    with positive weight span. Where the shapes just touch at an edge or corner the normal has none, and gets zero.
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
