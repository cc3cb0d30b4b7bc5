"""Pairs whose distance is a formula. Everything in the frame of the first shape, differentiable as it stands."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxrb.collision.contact import Contact
from jaxrb.geometry.primitives import Box, Capsule, HalfSpace
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide, norm, unit_or
from jaxrb.math.vector import cross, dot


def certified(distance: Scalar, normal: Vector, point_a: Vector, point_b: Vector) -> Contact:
    """A contact of which only round-off is uncertain: a few units in the last place of the coordinates."""
    size = jnp.maximum(jnp.max(jnp.abs(point_a)), jnp.max(jnp.abs(point_b)))
    margin = jax.lax.stop_gradient(16 * jnp.finfo(jnp.result_type(distance)).eps * size)
    return Contact(distance, normal, point_a, point_b, distance - margin, distance + margin)


def segment_of(shape: Shape) -> Scalar:
    """Half length [m] of the core of a sphere or capsule, along z."""
    return shape.half_height if isinstance(shape, Capsule) else jnp.zeros_like(jnp.asarray(shape.rounding))


def plane_and_core(plane: HalfSpace, shape: Shape, rotation: Array, translation: Vector) -> Contact:
    """A half-space and the core of any shape with a support map, placed in the frame of the half-space."""
    normal = jnp.asarray(plane.normal)
    point = translation + rotation @ shape.support(-(normal @ rotation))
    distance = dot(normal, point) - plane.offset
    return certified(distance, normal, point - distance * normal, point)


def sphere_and_box(box: Box, center: Vector) -> Contact:
    """A box and a point, the core of a sphere; the box is first."""
    half = jnp.asarray(box.half_extents)
    nearest = jnp.clip(center, -half, half)
    away = center - nearest
    inside = jnp.all(jnp.abs(center) <= half)
    room = half - jnp.abs(center)
    axis = jax.nn.one_hot(jnp.argmin(room), 3, dtype=half.dtype)
    out = axis * jnp.where(center < 0, -1.0, 1.0)
    depth = dot(axis, room)
    normal = jnp.where(inside, out, unit_or(away, out))
    distance = jnp.where(inside, -depth, norm(away))
    point = jnp.where(inside, center + depth * out, nearest)
    return certified(distance, normal, point, center)


def segments(half_a: Scalar, half_b: Scalar, direction: Vector, center: Vector) -> Contact:
    """Two segments, the cores of capsules and spheres: along z about the origin, along `direction` about `center`.

    Nearest points of two segments (Ericson 2004, "Real-time collision detection", 5.1.9). Where they cross, the way
    out is across both.
    """
    z = jnp.zeros_like(center).at[2].set(1.0)
    b = dot(z, direction)
    c, f = dot(z, center), dot(direction, center)
    # Sine of the angle between them as a length, not as 1 − cos²: nearly parallel capsules are the common case.
    across = cross(z, direction)
    squared_sine = dot(across, across)
    s = jnp.clip(divide(c - b * f, squared_sine), -half_a, half_a)
    t = jnp.clip(s * b - f, -half_b, half_b)
    s = jnp.clip(c + t * b, -half_a, half_a)
    point_a, point_b = s * z, center + t * direction
    away = point_b - point_a
    x = jnp.zeros_like(center).at[0].set(1.0)
    sideways = unit_or(across, unit_or(center - c * z, x))
    # Crossing segments overlap by their radii alone, and the way out is across both: towards b's centre, if that
    # tells.
    sideways = sideways * jnp.where(dot(sideways, center) < 0, -1.0, 1.0)
    normal = unit_or(away, sideways)
    return certified(norm(away), normal, point_a, point_b)


def composite(contacts: list[Contact]) -> Contact:
    """The nearest of several contacts."""
    nearest: Any = contacts[0]
    for other in contacts[1:]:
        first = nearest.distance <= other.distance
        lower = jnp.minimum(nearest.lower, other.lower)
        upper = jnp.minimum(nearest.upper, other.upper)
        nearest = jax.tree.map(lambda x, y, first=first: jnp.where(first, x, y), nearest, other)
        nearest = Contact(nearest.distance, nearest.normal, nearest.point_a, nearest.point_b, lower, upper)
    return nearest
