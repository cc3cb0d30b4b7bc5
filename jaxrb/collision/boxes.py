"""Signed distance of two boxes without a search: fifteen axes, and where none of them is the answer sixteen corners.

Overlapping boxes part soonest along the best of fifteen axes (`obb.py`). Boxes apart are nearest at a corner of one, or
where two edges cross and their common perpendicular is the distance. So the best axis is the answer wherever points of
both boxes lie opposite each other along it, and else the corner nearest to the other box is (a point is clamped to a
box). Each of these is arithmetic of scalars, one loop over all pairs under `vmap`; no pair waits for another.

What a stage hands on is one whole number, and what follows from it is formed again: XLA would form the stage once for
each of several values handed on.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.collision import features
from jaxrb.collision.boxes_opposite import opposite_crossing, opposite_face
from jaxrb.collision.contact import Contact
from jaxrb.collision.obb import fifteen_axes
from jaxrb.geometry.primitives import Box
from jaxrb.math.arrays import Array, Vector, components, entries, stack
from jaxrb.math.kept import kept
from jaxrb.math.safe import divide
from jaxrb.math.settled import settled
from jaxrb.math.vector import dot_of


class _Nearest(NamedTuple):
    """Points of both boxes by components, in each one's own frame; unit `normal` from a to b in the frame of a, and
    which coordinates of the points (three of a, three of b, at most two of the six) lie within faces or edges."""

    x: Any
    y: Any
    normal: Any
    free: Any


def contact_of_boxes(box_a: Box, box_b: Box, rotation: Array, translation: Vector) -> Contact:
    """The contact of two boxes, b placed in the frame of a by `rotation` (3, 3) and `translation` (3,) [m]."""
    half_a, half_b = jnp.asarray(box_a.half_extents), jnp.asarray(box_b.half_extents)
    inputs = lax.stop_gradient((half_a, half_b, rotation, translation))
    distance, normal, x, y, free, lower, upper = kept(_searched(*inputs))
    point_b = translation + rotation @ y
    weights, corners_a, corners_b = _spanned(x, y, free, inputs[:2], (half_a, half_b))
    corners_b = corners_b @ rotation.T + translation
    model = features.of_polytopes(distance, normal, weights, corners_a, corners_b)
    found = (distance, normal, x, lax.stop_gradient(point_b))
    distance, normal, x, point_b = (features.with_derivatives_of(v, m) for v, m in zip(found, model))
    return Contact(distance, normal, x, point_b, lower, upper)


def _spanned(x: Vector, y: Vector, free: Array, sizes: Any, half: Any) -> tuple[Array, Array, Array]:
    """The nearest points as corners with weights that `features.of_polytopes` takes: the pair of points itself, and the
    same with one of the free coordinates changed, which has no weight worth the name but says where the points may go.
    """
    seen = jnp.cumsum(free)
    first, second = free & (seen == 1), free & (seen == 2)
    moves = jnp.stack([jnp.zeros_like(first), first, second]).astype(x.dtype)
    # In units of the half edges, so that the points stay where they are in the material.
    corners_a = (divide(x, sizes[0])[None] + moves[:, :3]) * half[0]
    corners_b = (divide(y, sizes[1])[None] + moves[:, 3:]) * half[1]
    tiny = jnp.finfo(x.dtype).tiny
    weights = jnp.stack([jnp.ones_like(x[0]), *(jnp.where(seen[-1] > k, tiny, 0.0) for k in range(2))])
    return weights.astype(x.dtype), corners_a, corners_b


def _searched(half_a: Vector, half_b: Vector, rotation: Array, translation: Vector) -> Any:
    """Distance, normal (3,), the nearest points x (3,) of a and y (3,) of b in the frame of each, which of their six
    coordinates are free, and both bounds."""
    a, b = components(half_a), components(half_b)
    a, b, r, t = settled((a, b, entries(rotation), components(translation)))
    eps = jnp.finfo(rotation.dtype).eps
    reach = [jnp.abs(t[k]) + dot_of(b, [jnp.abs(v) for v in r[k]]) for k in range(3)]
    scale = _largest(*reach, *a)
    code = settled(_best_axis(a, b, r, t, scale))
    by_face, by_edge = opposite_face(code, a, b, r, t, scale), opposite_crossing(code, a, b, r, t)
    opposite = _Nearest(*jax.tree.map(lambda p, q: jnp.where(code < 6, p, q), by_face, by_edge))
    opposite = settled(opposite)
    gap = _gap_along(opposite.normal, a, b, r, t)
    way = _between(opposite, r, t)
    aside = _largest(*(jnp.abs(w - gap * n) for w, n in zip(way, opposite.normal)))
    corner = settled(_nearest_corner(a, b, r, t))
    at_corner = _at_corner(corner, a, b, r, t)
    other = _between(at_corner, r, t)
    # The corner is often the end of the edge that the axis names: then both are the same points, the axis still wrong.
    squared = dot_of(other, other)
    shorter = (jnp.sqrt(squared) <= jnp.sqrt(dot_of(way, way)) + 16 * eps * scale) & (squared > 0)
    use = settled((gap > 0) & (aside > 16 * eps * scale) & shorter)
    nearest = settled(jax.tree.map(lambda p, q: jnp.where(use, p, q), at_corner, opposite))
    way = _between(nearest, r, t)
    length = jnp.sqrt(dot_of(way, way))
    parted = _gap_along(nearest.normal, a, b, r, t)
    distance = jnp.where(use, length, gap)
    margin = 32 * eps * scale
    lower = jnp.maximum(parted, gap) - margin
    upper = jnp.where(gap > 0, jnp.maximum(length, distance), gap) + margin
    numbers = (stack(*nearest.normal), stack(*nearest.x), stack(*nearest.y), stack(*nearest.free))
    return distance, *numbers, lower, upper


def _largest(*values: Any) -> Any:
    most = values[0]
    for value in values[1:]:
        most = jnp.maximum(most, value)
    return most


def _best_axis(a: Any, b: Any, r: Any, t: Any, scale: Any) -> Any:
    """Number of the axis with the largest gap: 0–2 faces of a, 3–5 of b, 6–14 edges 6 + 3i + j."""
    in_b = [dot_of(t, column) for column in zip(*r)]
    best, code = jnp.full_like(scale, -jnp.inf), jnp.zeros(scale.shape, jnp.int32)
    tie = 4 * jnp.finfo(scale.dtype).eps * scale
    for number, axis in enumerate(fifteen_axes(a, b, r, t, in_b, 0.0, reach_along=True)):
        # Where edges lie in a face they part the boxes as far as the face does, and only the face knows where.
        better = axis.gap > (best if number < 6 else best + tie)
        best, code = jnp.where(better, axis.gap, best), jnp.where(better, number, code)
    return code


def _gap_along(n: Any, a: Any, b: Any, r: Any, t: Any) -> Any:
    """How far apart the boxes are along a unit vector from a to b."""
    across = [jnp.abs(dot_of(n, column)) for column in zip(*r)]
    return dot_of(n, t) - dot_of(a, [jnp.abs(x) for x in n]) - dot_of(b, across)


def _between(nearest: _Nearest, r: Any, t: Any) -> list[Any]:
    """The way from the point of a to the point of b, in the frame of a."""
    return [t[k] + dot_of(r[k], nearest.y) - nearest.x[k] for k in range(3)]


def _turned(of_b: Any, r: Any, t: Any) -> tuple[Any, Any]:
    """Axes and centre of a in the frame of b where `of_b`, else of b in the frame of a."""
    q = [[jnp.where(of_b, r[j][k], r[k][j]) for j in range(3)] for k in range(3)]
    return q, [jnp.where(of_b, -dot_of(t, [r[j][k] for j in range(3)]), t[k]) for k in range(3)]


def _nearest_corner(a: Any, b: Any, r: Any, t: Any) -> Any:
    """Number of the corner nearest to the other box: 0–7 of b, 8–15 of a; bit k for the upper end of axis k.

    Of corners as near to round-off the first: the distance is that of all of them, the normal to a root of round-off.
    """
    least, code = jnp.full_like(t[0], jnp.inf), jnp.zeros(t[0].shape, jnp.int32)
    for first, (own, half, q, center) in enumerate(
        ((a, b, *_turned(False, r, t)), (b, a, *_turned(True, r, t)))
    ):
        steps = [[q[k][j] * half[j] for k in range(3)] for j in range(3)]
        places = [(center, 0)]
        for j in range(3):
            places = [
                ([p + s if up else p - s for p, s in zip(place, steps[j])], number + (up << j))
                for place, number in places
                for up in (0, 1)
            ]
        for place, number in places:
            away = [jnp.maximum(jnp.abs(p) - h, 0.0) for p, h in zip(place, own)]
            squared = dot_of(away, away)
            better = squared < least
            least = jnp.where(better, squared, least)
            code = jnp.where(better, 8 * first + number, code)
    return code


def _at_corner(code: Any, a: Any, b: Any, r: Any, t: Any) -> _Nearest:
    """The corner of that number and the point of the other box nearest to it."""
    of_b = code >= 8  # in the frame of b, a corner of a
    q, center = _turned(of_b, r, t)
    own = [jnp.where(of_b, p, q) for p, q in zip(b, a)]
    half = [jnp.where(of_b, p, q) for p, q in zip(a, b)]
    corner = [jnp.where(code & (1 << k) != 0, h, -h) for k, h in enumerate(half)]
    place = [center[k] + dot_of(q[k], corner) for k in range(3)]
    point = [jnp.clip(p, -h, h) for p, h in zip(place, own)]
    # Along an edge or a face that holds the point the difference is zero to the last bit.
    away = [p - s for p, s in zip(place, point)]
    squared = dot_of(away, away)
    scale = 1.0 / jnp.sqrt(jnp.where(squared > 0, squared, 1.0))
    n = [v * scale for v in away]
    normal = [jnp.where(of_b, -dot_of(r[k], n), n[k]) for k in range(3)]
    within = [jnp.abs(p) < h for p, h in zip(place, own)]
    within[2] = within[2] & ~(within[0] & within[1])
    x = [jnp.where(of_b, c, p) for c, p in zip(corner, point)]
    y = [jnp.where(of_b, p, c) for c, p in zip(corner, point)]
    return _Nearest(x, y, normal, [w & ~of_b for w in within] + [w & of_b for w in within])
