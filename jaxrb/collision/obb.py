"""Two oriented boxes by their fifteen axes (Gottschalk, Lin, Manocha 1996, "OBBTree").

Boxes overlap exactly if no axis of a face of either and no product of an edge of one with an edge of the other
separates them, and the axis of least overlap is the shortest way out. Everything by components of pairs in the last
axis.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxrb.geometry.bounds import OrientedBox
from jaxrb.math.arrays import Array, Scalar, Vector, components, entries, stack
from jaxrb.math.vector import dot_of, matmul, matvec


def separation_of_boxes(
    half_a: Vector, half_b: Vector, rotation: Array, translation: Vector
) -> tuple[Scalar, Vector]:
    """The largest of the fifteen gaps (...) [m] and its axis (..., 3), a unit vector from a to b in the frame of a.

    Where boxes overlap that is minus their exact depth and its normal. Where they are apart it is positive and bounds
    the distance from below; it is the distance itself where a face is nearest, or two edges are.

    Args:
        half_a, half_b: half edges (..., 3) [m].
        rotation, translation: (..., 3, 3) and (..., 3) [m], they place box b in the frame of box a.
    """
    r, t = entries(rotation), components(translation)
    in_b = [dot_of(t, column) for column in zip(*r)]
    zero = jnp.zeros_like(t[0])
    # Products of edges this nearly parallel say nothing that the faces do not.
    least = 64 * jnp.finfo(zero.dtype).eps
    best: Any = jnp.full_like(zero, -jnp.inf)
    axis = (zero, zero, zero)
    found = fifteen_axes(components(half_a), components(half_b), r, t, in_b, least)
    for number, (gap, side, scale) in enumerate(found):
        better = gap > best
        best = jnp.where(better, gap, best)
        sign = jnp.where(side < 0, -1.0, 1.0)
        axis = tuple(jnp.where(better, sign * p, x) for p, x in zip(_direction(number, r, scale), axis))
    return best, stack(*axis)


class Axis(NamedTuple):
    """One of the fifteen: the `gap` [m] along it, a number with the sign of the `side` on which b lies, and by what the
    product of two edges is to be multiplied to be a unit vector."""

    gap: Scalar
    side: Scalar
    scale: Any


def fifteen_axes(
    half_a: Any, half_b: Any, r: Any, t: Any, in_b: Any, least: Any, reach_along: bool = False
) -> list[Axis]:
    """The axes of all faces of a (0–2) and b (3–5) and of the products of their edges (6 + 3i + j), by components.

    `r[i][j]` is edge i of a · edge j of b; `t` and `in_b` the way from a to b along the edges of each. Products not
    longer than √`least` have a gap of −∞. How far b reaches along a product follows from the third edges, to round-off
    over the sine between the two; with `reach_along` it is formed along the product itself, to round-off for edges
    however parallel.
    """
    a, b = half_a, half_b
    size = [[jnp.abs(x) for x in line] for line in r]
    found = [Axis(jnp.abs(t[i]) - (a[i] + dot_of(b, size[i])), t[i], 1.0) for i in range(3)]
    for j, column in enumerate(zip(*size)):
        found.append(Axis(jnp.abs(in_b[j]) - (b[j] + dot_of(a, column)), in_b[j], 1.0))
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            squared = r[i1][j] * r[i1][j] + r[i2][j] * r[i2][j]
            usable = squared > least
            scale = 1.0 / jnp.sqrt(jnp.where(usable, squared, 1.0))
            side = t[i2] * r[i1][j] - t[i1] * r[i2][j]
            reach = a[i1] * size[i2][j] + a[i2] * size[i1][j]
            if reach_along:
                along = [jnp.abs(r[i2][k] * r[i1][j] - r[i1][k] * r[i2][j]) for k in (j1, j2)]
                reach = reach + b[j1] * along[0] + b[j2] * along[1]
            else:
                reach = reach + b[j1] * size[i][j2] + b[j2] * size[i][j1]
            found.append(Axis(jnp.where(usable, (jnp.abs(side) - reach) * scale, -jnp.inf), side, scale))
    return found


def _direction(number: int, r: Any, scale: Any) -> list[Any]:
    """Components of an axis in the frame of a."""
    if number < 3:
        return [float(number == k) for k in range(3)]
    if number < 6:
        return [r[k][number - 3] for k in range(3)]
    i, j = divmod(number - 6, 3)
    i1, i2 = (i + 1) % 3, (i + 2) % 3
    proposed: list[Any] = [0.0, 0.0, 0.0]
    proposed[i1], proposed[i2] = -r[i2][j] * scale, r[i1][j] * scale
    return proposed


def oriented_boxes_gap(a: OrientedBox, b: OrientedBox) -> Scalar:
    """The largest gap [m] of two boxes along a direction: positive where some plane parts them, and then ≤ distance.

    Negative: minus the depth of overlap, exactly. `separation_of_boxes` gives the direction too.
    """
    turn_a, turn_b = a.pose.orientation.as_matrix(), b.pose.orientation.as_matrix()
    across = turn_a.swapaxes(-1, -2)
    apart = matvec(across, b.pose.position - a.pose.position)
    return separation_of_boxes(a.half_extents, b.half_extents, matmul(across, turn_b), apart)[0]
