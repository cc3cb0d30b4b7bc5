"""A parallelogram clipped by a rectangle, and four of the corners that remain.

The corners of the common outline always stand in the same twelve places, so a point keeps its number while it slides.
While they are compared each is known by its two coordinates in the parallelogram, and a place without a point by ones
far outside: few numbers that have to be stored between the stages. What is found is a whole number for each corner, the
place and the two lines that cross in it; where these lines cross is a formula of its own, which alone has a derivative.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxrb.math.arrays import Array, Scalar, stack
from jaxrb.math.settled import settled

PLACES = 12
# A corner this share of a side beyond the rectangle still counts as within it: boxes of one size in line, the commonest
# stack, tremble by less, and would otherwise exchange their corners for crossings beside them and back.
_SLACK = 1e-4
_NOWHERE = 4.0  # coordinates of points that are there lie between −1 and 1
# Lines by number, twice its kind and one more on its negative side: s = ±1, t = ±1, x = ±half[0], y = ±half[1].
_S, _T, _X, _Y = 0, 2, 4, 6
_LINES = 8


class Quad(NamedTuple):
    """The parallelogram middle ± u ± w: three coordinates each, along x and y of the rectangle and above it [m].

    `half`: half edges of the rectangle |x| ≤ half[0], |y| ≤ half[1]. The parallelogram must not stand upright on it.
    """

    middle: Any
    u: Any
    w: Any
    half: Any


class Corners(NamedTuple):
    """Four corners of the common outline by their numbers: `place` (4,), −1 where there is none, and `lines` (4,).

    `alone`: the outlines have nothing in common, and the first is the parallelogram's corner nearest to the rectangle.
    """

    place: Array
    lines: Array
    alone: Array


def four_corners(quad: Quad) -> Corners:
    """Of the common outline the deepest corner, the farthest from it, and on either side of their line the farthest."""
    places, lone = settled((_places(quad), _nearest(quad)))
    there = [(jnp.abs(s) < 2.0) & (jnp.abs(t) < 2.0) for s, t, _ in places]
    middle, u, w = quad.middle, quad.u, quad.w
    height = [middle[2] + s * u[2] + t * w[2] for s, t, _ in places]
    x, y = ([s * u[k] + t * w[k] for s, t, _ in places] for k in range(2))
    points = [(p, q, lines) for p, q, (_, _, lines) in zip(x, y, places)]
    size = quad.half[0] + quad.half[1]
    noise = 64 * jnp.finfo(size.dtype).eps * size
    some = there[0]
    for one in there[1:]:
        some |= one
    first = settled(jnp.where(some, _first_most([-h for h in height], there, noise), lone))
    x0, y0, lines0 = _chosen(first, points)
    away = [(p - x0) ** 2 + (q - y0) ** 2 for p, q in zip(x, y)]
    second = settled(_first_most(away, there, noise * size))
    x1, y1, lines1 = _chosen(second, points)
    x1, y1 = x1 - x0, y1 - y0
    side = [x1 * (q - y0) - y1 * (p - x0) for p, q in zip(x, y)]
    left = _first_most(side, there, noise * size)
    right = _first_most([-one for one in side], there, noise * size)
    left, right = settled((left, right))
    least = _SLACK * size
    long = x1 * x1 + y1 * y1
    numbers, lines, valid = [first, second], [lines0, lines1], [True, some & (long > least * least)]
    for number, sign in ((left, 1.0), (right, -1.0)):
        x2, y2, crossed = _chosen(number, points)
        area = sign * (x1 * (y2 - y0) - y1 * (x2 - x0))
        numbers.append(number)
        lines.append(crossed)
        valid.append(some & (area > 0) & (area * area > least * least * long))
    lines[0] = jnp.where(some, lines0, _both(_S + (lone % 2 == 0), _T + (lone >= 2)))
    place = [jnp.where(v, number, -1) for number, v in zip(numbers, valid)]
    return Corners(stack(*place), stack(*lines), ~some)


def coordinates(corners: Corners, quad: Quad) -> tuple[Array, Array]:
    """s and t (4,) of the corners middle + s u + t w: where their two lines cross; 0 where there is none."""
    (a, b, c), (d, e, f) = (_line(n, quad) for n in (corners.lines // _LINES, corners.lines % _LINES))
    there = corners.place >= 0
    scale = 1.0 / jnp.where(there, a * e - d * b, 1.0)
    return jnp.where(there, (c * e - f * b) * scale, 0.0), jnp.where(there, (a * f - d * c) * scale, 0.0)


def _line(number: Array, quad: Quad) -> tuple[Array, Array, Array]:
    """a, b, c of the line a s + b t = c."""
    kind, sign = number // 2, 1.0 - 2.0 * (number % 2).astype(quad.half[0].dtype)
    (m, n, _), (p, q, _), (v, w, _) = quad.middle, quad.u, quad.w

    def one_of(*values: Any) -> Array:
        s, t, x, y = values
        return jnp.where(kind == 0, s, jnp.where(kind == 1, t, jnp.where(kind == 2, x, y)))

    bound = sign * one_of(1.0, 1.0, quad.half[0], quad.half[1])
    return one_of(1.0, 0.0, p, q), one_of(0.0, 1.0, v, w), bound - one_of(0.0, 0.0, m, n)


def _both(one: Any, other: Any) -> Any:
    return jnp.asarray(one * _LINES + other, jnp.int32)


def _places(quad: Quad) -> list[tuple[Scalar, Scalar, Array]]:
    """Coordinates s, t of the twelve, and the lines that cross there.

    0–3: ends of the sides along u, corners of the parallelogram or where these sides leave the rectangle. 4–7: where
    the sides along w cross the rectangle. 8–11: corners of the rectangle under or over the parallelogram.
    """
    middle, u, w, half = quad
    points = []
    for negative, t in enumerate((1.0, -1.0)):
        for s, line in _ends(middle, w, u, t, half, _S, True):
            points.append((s, jnp.full_like(s, t), _both(line, _T + negative)))
    for negative, s in enumerate((1.0, -1.0)):
        for t, line in _ends(middle, u, w, s, half, _T, False):
            points.append((jnp.full_like(t, s), t, _both(_S + negative, line)))
    scale = 1.0 / (u[0] * w[1] - u[1] * w[0])
    for below, left in ((0, 0), (0, 1), (1, 0), (1, 1)):
        x, y = (1 - 2 * left) * half[0] - middle[0], (1 - 2 * below) * half[1] - middle[1]
        s, t = (x * w[1] - y * w[0]) * scale, (u[0] * y - u[1] * x) * scale
        under = (jnp.abs(s) < 1.0 - _SLACK) & (jnp.abs(t) < 1.0 - _SLACK)
        place = (jnp.where(under, s, _NOWHERE), jnp.where(under, t, _NOWHERE))
        points.append((*place, _both(_X + left, _Y + below)))
    return points


def _ends(
    middle: Any, other: Any, along: Any, sign: float, half: Any, kind: int, own: bool
) -> list[tuple[Scalar, Array]]:
    """Where a side of the parallelogram enters and leaves the rectangle, and by which line.

    The side's own ends, on the lines of that `kind`, only where they are its `own`.
    """
    start = [middle[k] + sign * other[k] for k in range(2)]
    low, high, near_low, near_high, enters = [], [], [], [], []
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
        enters.append((rate > 0).astype(jnp.int32))  # by the negative line
    first, last = jnp.maximum(*near_low), jnp.minimum(*near_high)
    there = (first <= last) & (first <= 1.0) & (last >= -1.0)
    # Which line it is, the slack decides as well: a side that lies in the rectangle's own side never leaves by that.
    by_x, out_by_x = near_low[0] >= near_low[1], near_high[0] <= near_high[1]
    entry = jnp.where(by_x, _X + enters[0], _Y + enters[1])
    leaving = jnp.where(out_by_x, _X + 1 - enters[0], _Y + 1 - enters[1])
    ends = []
    for corner, s, at, line in (
        (first <= -1.0, jnp.where(by_x, *low), -1.0, entry),
        (last >= 1.0, jnp.where(out_by_x, *high), 1.0, leaving),
    ):
        kept = there if own else there & ~corner
        s = jnp.where(corner, at, jnp.clip(s, -1.0, 1.0))
        line = jnp.where(s >= 1.0, kind, jnp.where(s <= -1.0, kind + 1, line))
        ends.append((jnp.where(kept, s, _NOWHERE), line))
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
