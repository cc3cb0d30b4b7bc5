"""Points of two boxes that lie opposite each other along one of their fifteen axes."""

from typing import Any

import jax.numpy as jnp

from jaxrb.math.vector import cross_of, dot_of


def opposite_face(code: Any, a: Any, b: Any, r: Any, t: Any, scale: Any) -> tuple[Any, Any, Any, Any]:
    """Points x of a and y of b in the frame of each, along a face's axis (code 0–2 of a, 3–5 of b).

    The face of the other box that looks most at this one is clipped by it, and the lowest point of what is left is
    taken. That is a corner of the other box, but where faces or edges are parallel to round-off: then the corner may
    lie beyond this face's rim, and the point of an edge above the rim is as low.

    Returns:
        x, y, the unit normal from a to b in the frame of a, and which of the six coordinates are free.
    """
    of_b = (code >= 3) & (code < 6)
    number = jnp.where(code < 6, code % 3, 0)
    q = [[jnp.where(of_b, r[j][k], r[k][j]) for j in range(3)] for k in range(3)]
    center = [jnp.where(of_b, -dot_of(t, [line[k] for line in r]), t[k]) for k in range(3)]
    own = [jnp.where(of_b, p, q) for p, q in zip(b, a)]
    half = [jnp.where(of_b, p, q) for p, q in zip(a, b)]
    up = [number == k for k in range(3)]
    sign = jnp.where(_chosen(up, center) < 0, -1.0, 1.0).astype(scale.dtype)
    facing = [sign * _chosen(up, column) for column in zip(*q)]
    size = [jnp.abs(c) for c in facing]
    # Axis v of the other box looks most at this face; the sides of its face are along u and w.
    v0 = (size[0] >= size[1]) & (size[0] >= size[2])
    v2 = ~v0 & (size[2] > size[1])
    lowest = [jnp.where(c > 0, -h, h) for c, h in zip(facing, half)]
    bottom = jnp.where(v0, lowest[0], jnp.where(v2, lowest[2], lowest[1]))
    along = [jnp.where(v0, line[0], jnp.where(v2, line[2], line[1])) for line in q]
    middle = [jnp.where(u, 0.0, c + bottom * v) for u, c, v in zip(up, center, along)]
    columns = [[half[j] * line[j] for line in q] for j in range(3)]
    slopes = [c * h for c, h in zip(facing, half)]
    sides = (
        [jnp.where(u, 0.0, jnp.where(v0, p, s)) for u, p, s in zip(up, columns[1], columns[0])],
        [jnp.where(u, 0.0, jnp.where(v2, p, s)) for u, p, s in zip(up, columns[1], columns[2])],
    )
    slope = (jnp.where(v0, slopes[1], slopes[0]), jnp.where(v2, slopes[1], slopes[2]))
    alpha, beta = _lowest_above(middle, sides, slope, own, up, scale)
    place = [m + alpha * p + beta * s for m, p, s in zip(middle, *sides)]
    point = [jnp.where(u, sign * h, jnp.clip(p, -h, h)) for u, p, h in zip(up, place, own)]
    corner = [
        jnp.where(v0, bottom, alpha * half[0]),
        jnp.where(v0, alpha * half[1], jnp.where(v2, beta * half[1], bottom)),
        jnp.where(v2, bottom, beta * half[2]),
    ]
    normal = [
        jnp.where(of_b, -sign * _chosen(up, line), sign * u.astype(scale.dtype)) for line, u in zip(r, up)
    ]
    x = [jnp.where(of_b, c, p) for c, p in zip(corner, point)]
    y = [jnp.where(of_b, p, c) for c, p in zip(corner, point)]
    return x, y, normal, [~u & ~of_b for u in up] + [~u & of_b for u in up]


def _chosen(which: Any, values: Any) -> Any:
    """The one of three values whose mark is set."""
    return jnp.where(which[0], values[0], jnp.where(which[1], values[1], values[2]))


def _lowest_above(middle: Any, sides: Any, slope: Any, own: Any, up: Any, scale: Any) -> tuple[Any, Any]:
    """Where within the rectangle middle + α side + β side, |α|, |β| ≤ 1, the lowest point above the box `own` lies.

    Tried are the lowest points of its four edges cut off at the rim, and the point above the middle of the box, which
    is needed where the whole of the box lies below and then as low as any.
    """
    small = 8 * jnp.finfo(scale.dtype).eps * scale
    one = jnp.ones_like(scale)
    tried = []
    for side, other, rise, first in (
        (sides[0], sides[1], slope[0], True),
        (sides[1], sides[0], slope[1], False),
    ):
        flat = [s == 0 for s in side]
        inverse = [1.0 / jnp.where(f, 1.0, s) for f, s in zip(flat, side)]
        for end in (-1.0, 1.0):
            low, high = -one, one
            for m, o, h, f, i in zip(middle, other, own, flat, inverse):
                p = -(m + end * o) * i
                width = jnp.where(f, jnp.inf, h * jnp.abs(i))
                p = jnp.where(f, 0.0, p)
                low, high = jnp.maximum(low, p - width), jnp.minimum(high, p + width)
            share = jnp.clip(jnp.where(rise > 0, low, high), -1.0, 1.0)
            tried.append((share, end * one) if first else (end * one, share))
    area = sum(cross_of(*sides))
    area = jnp.where(area == 0, 1.0, area)
    above = [sum(cross_of(s, middle)) / area for s in (sides[1], sides[0])]
    tried.append((jnp.clip(above[0], -1.0, 1.0), jnp.clip(-above[1], -1.0, 1.0)))
    least, alpha, beta = jnp.full_like(scale, jnp.inf), one, one
    for p, s in tried:
        place = [m + p * u + s * w for m, u, w in zip(middle, *sides)]
        beyond = [jnp.where(k, 0.0, jnp.abs(x) - h) for k, x, h in zip(up, place, own)]
        beyond = jnp.maximum(jnp.maximum(beyond[0], beyond[1]), beyond[2])
        value = jnp.where(beyond > small, 8 * scale + beyond, p * slope[0] + s * slope[1])
        better = value < least
        least = jnp.where(better, value, least)
        alpha, beta = jnp.where(better, p, alpha), jnp.where(better, s, beta)
    return alpha, beta


def opposite_crossing(code: Any, a: Any, b: Any, r: Any, t: Any) -> tuple[Any, Any, Any, Any]:
    """As `opposite_face` along the product of two edges (code 6 + 3i + j): where they cross."""
    pair = jnp.where(code < 6, 0, code - 6)
    mine, other = [pair // 3 == k for k in range(3)], [pair % 3 == k for k in range(3)]
    edge = [_chosen(other, line) for line in r]
    cosine = _chosen(mine, edge)
    across = [jnp.where(m, 0.0, e) for m, e in zip(mine, edge)]
    squared = dot_of(across, across)
    squared = jnp.where((code < 6) | (squared == 0), 1.0, squared)
    # e_i × edge, of which component i is zero.
    product = [
        jnp.where(mine[(k + 1) % 3], -edge[(k + 2) % 3], jnp.where(mine[(k + 2) % 3], edge[(k + 1) % 3], 0.0))
        for k in range(3)
    ]
    scale = jnp.where(dot_of(product, t) < 0, -1.0, 1.0) / jnp.sqrt(squared)
    normal = [scale * p for p in product]
    facing = [dot_of(normal, column) for column in zip(*r)]
    x = [jnp.where(m, 0.0, jnp.where(n < 0, -h, h)) for m, n, h in zip(mine, normal, a)]
    y = [jnp.where(m, 0.0, jnp.where(n < 0, h, -h)) for m, n, h in zip(other, facing, b)]
    way = [t[k] + dot_of(r[k], y) - x[k] for k in range(3)]
    p, s = 0.0, 0.0
    for _ in range(2):
        # Once more with what is left: of nearly parallel edges the first answer is known to round-off over their sine.
        left = [w + s * e - jnp.where(m, p, 0.0) for w, e, m in zip(way, edge, mine)]
        along, over = _chosen(mine, left), dot_of(left, edge)
        p = p + (along - cosine * over) / squared
        s = s + (cosine * along - over) / squared
    x = [jnp.where(m, jnp.clip(p, -h, h), v) for m, h, v in zip(mine, a, x)]
    y = [jnp.where(m, jnp.clip(s, -h, h), v) for m, h, v in zip(other, b, y)]
    return x, y, normal, mine + other
