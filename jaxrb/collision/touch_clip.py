"""A parallelogram clipped by a rectangle, and four of the corners that remain.

The corners of the common outline always stand in the same twelve places, so a point keeps its number while it slides.
Each is known by its two coordinates in the parallelogram, and a place without a point by ones far outside: few numbers
that have to be stored between the stages.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.settled import settled

PLACES = 12
# A corner this share of a side beyond the rectangle still counts as within it: boxes of one size in line, the commonest
# stack, tremble by less, and would otherwise exchange their corners for crossings beside them and back.
_SLACK = 1e-4
_NOWHERE = 4.0  # coordinates of points that are there lie between −1 and 1


class Quad(NamedTuple):
    """The parallelogram middle ± u ± w: three coordinates each, along x and y of the rectangle and above it [m].

    `half`: half edges of the rectangle |x| ≤ half[0], |y| ≤ half[1]. The parallelogram must not stand upright on it.
    """

    middle: Any
    u: Any
    w: Any
    half: Any


class Corner(NamedTuple):
    """A corner of the common outline at middle + s u + t w: `height` [m], number of its `place`, if it is there."""

    s: Scalar
    t: Scalar
    height: Scalar
    place: Array
    valid: Array


def four_corners(quad: Quad, gap: Scalar) -> list[Corner]:
    """Of the common outline the deepest corner, the farthest from it, and on either side of their line the farthest.

    Where the outlines have nothing in common, the parallelogram's corner nearest to the rectangle, at height `gap`.
    """
    places, lone = settled((_places(quad), _nearest(quad)))
    there = [(jnp.abs(s) < 2.0) & (jnp.abs(t) < 2.0) for s, t in places]
    middle, u, w = quad.middle, quad.u, quad.w
    height = [middle[2] + s * u[2] + t * w[2] for s, t in places]
    x, y = ([s * u[k] + t * w[k] for s, t in places] for k in range(2))
    size = quad.half[0] + quad.half[1]
    noise = 64 * jnp.finfo(size.dtype).eps * size
    some = there[0]
    for one in there[1:]:
        some |= one
    deepest = settled(jnp.where(some, _first_most([-h for h in height], there, noise), lone))
    (s0, t0), (x0, y0) = _chosen(deepest, places), _chosen(deepest, list(zip(x, y)))
    away = [(p - x0) ** 2 + (q - y0) ** 2 for p, q in zip(x, y)]
    farthest = settled(_first_most(away, there, noise * size))
    s1, t1 = _chosen(farthest, places)
    x1, y1 = ((s1 - s0) * u[k] + (t1 - t0) * w[k] for k in range(2))
    side = [x1 * (q - y0) - y1 * (p - x0) for p, q in zip(x, y)]
    left = _first_most(side, there, noise * size)
    right = _first_most([-one for one in side], there, noise * size)
    left, right = settled((left, right))
    # The lone corner of outlines that are apart.
    s0 = jnp.where(some, s0, jnp.where(lone % 2 == 0, -1.0, 1.0))
    t0 = jnp.where(some, t0, jnp.where(lone < 2, 1.0, -1.0))
    least = _SLACK * size
    long = x1 * x1 + y1 * y1
    found = [
        Corner(s0, t0, jnp.where(some, middle[2] + s0 * u[2] + t0 * w[2], gap), deepest, jnp.ones_like(some))
    ]
    found.append(Corner(s1, t1, middle[2] + s1 * u[2] + t1 * w[2], farthest, some & (long > least * least)))
    for number, sign in ((left, 1.0), (right, -1.0)):
        s, t = _chosen(number, places)
        x2, y2 = ((s - s0) * u[k] + (t - t0) * w[k] for k in range(2))
        area = sign * (x1 * y2 - y1 * x2)
        wide = (area > 0) & (area * area > least * least * long)
        found.append(Corner(s, t, middle[2] + s * u[2] + t * w[2], number, some & wide))
    return found


def _places(quad: Quad) -> list[tuple[Scalar, Scalar]]:
    """Coordinates s, t of the twelve.

    0–3: ends of the sides along u, corners of the parallelogram or where these sides leave the rectangle. 4–7: where
    the sides along w cross the rectangle. 8–11: corners of the rectangle under or over the parallelogram.
    """
    middle, u, w, half = quad
    points = []
    for t in (1.0, -1.0):
        points += [(s, jnp.full_like(s, t)) for s in _ends(middle, w, u, t, half, True)]
    for s in (1.0, -1.0):
        points += [(jnp.full_like(t, s), t) for t in _ends(middle, u, w, s, half, False)]
    scale = 1.0 / (u[0] * w[1] - u[1] * w[0])
    for sign_x, sign_y in ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)):
        x, y = sign_x * half[0] - middle[0], sign_y * half[1] - middle[1]
        s, t = (x * w[1] - y * w[0]) * scale, (u[0] * y - u[1] * x) * scale
        under = (jnp.abs(s) < 1.0 - _SLACK) & (jnp.abs(t) < 1.0 - _SLACK)
        points.append((jnp.where(under, s, _NOWHERE), jnp.where(under, t, _NOWHERE)))
    return points


def _ends(middle: Any, other: Any, along: Any, sign: float, half: Any, own: bool) -> list[Scalar]:
    """Where a side of the parallelogram enters and leaves the rectangle; its own ends only where they are its `own`."""
    start = [middle[k] + sign * other[k] for k in range(2)]
    low, high, near_low, near_high = [], [], [], []
    for k in range(2):
        tiny = jnp.finfo(start[0].dtype).eps * half[k]
        # A side parallel to the rectangle's meets it far away, on either hand if it lies within.
        rate = 1.0 / jnp.where(jnp.abs(along[k]) > tiny, along[k], tiny)
        one, two = (-half[k] - start[k]) * rate, (half[k] - start[k]) * rate
        slack = _SLACK * half[k] * jnp.abs(rate)
        low.append(jnp.minimum(one, two))
        high.append(jnp.maximum(one, two))
        near_low.append(low[k] - slack)
        near_high.append(high[k] + slack)
    first, last = jnp.maximum(*near_low), jnp.minimum(*near_high)
    there = (first <= last) & (first <= 1.0) & (last >= -1.0)
    ends = []
    for corner, s, at in (
        (first <= -1.0, jnp.maximum(*low), -1.0),
        (last >= 1.0, jnp.minimum(*high), 1.0),
    ):
        kept = there if own else there & ~corner
        ends.append(jnp.where(kept, jnp.where(corner, at, jnp.clip(s, -1.0, 1.0)), _NOWHERE))
    return ends


def _nearest(quad: Quad) -> Array:
    """Which of the places 0–3, as corners of the parallelogram, is nearest to the rectangle."""
    best: Any = jnp.inf
    place: Any = jnp.zeros((), jnp.int32)
    for k, (s, t) in enumerate(((-1.0, 1.0), (1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))):
        x, y, h = (quad.middle[i] + s * quad.u[i] + t * quad.w[i] for i in range(3))
        a, b = (jnp.maximum(jnp.abs(v) - edge, 0.0) for v, edge in zip((x, y), quad.half))
        squared = a * a + b * b + h * h
        closer = squared < best
        best, place = jnp.where(closer, squared, best), jnp.where(closer, k, place)
    return place


def _first_most(scores: Any, there: Any, noise: Any) -> Array:
    """Number of the largest score of those there, the first of those that differ by no more than noise."""
    best: Any = jnp.where(there[0], scores[0], -jnp.inf)
    number: Any = jnp.zeros((), jnp.int32)
    for k, (score, one) in enumerate(zip(scores[1:], there[1:]), 1):
        better = one & (score > best + noise)
        best, number = jnp.where(better, score, best), jnp.where(better, k, number)
    return number


def _chosen(number: Array, points: Any) -> Any:
    found = points[0]
    for k, point in enumerate(points[1:], 1):
        found = tuple(jnp.where(number == k, p, f) for p, f in zip(point, found))
    return found
