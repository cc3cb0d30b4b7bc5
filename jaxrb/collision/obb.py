"""Two oriented boxes by their fifteen axes (Gottschalk, Lin, Manocha 1996, "OBBTree").

Boxes overlap exactly if no axis of a face of either and no product of an edge of one with an edge of the other
separates them, and the axis of least overlap is the shortest way out. Everything by components of pairs in the last
axis.
"""

from typing import Any

import jax.numpy as jnp

from jaxrb.geometry.bounds import OrientedBox
from jaxrb.math.arrays import Array, Scalar, Vector, components, entries, stack
from jaxrb.math.vector import matmul, matvec


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
    a, b = components(half_a), components(half_b)
    size = [[jnp.abs(x) for x in line] for line in r]
    in_b = [t[0] * r[0][j] + t[1] * r[1][j] + t[2] * r[2][j] for j in range(3)]
    zero = jnp.zeros_like(t[0])
    # Products of edges this nearly parallel say nothing that the faces do not.
    least = 64 * jnp.finfo(zero.dtype).eps
    best: Any = jnp.full_like(zero, -jnp.inf)
    axis = (zero, zero, zero)

    def offer(gap: Any, side: Any, proposed: Any) -> None:
        nonlocal best, axis
        better = gap > best
        best = jnp.where(better, gap, best)
        sign = jnp.where(side < 0, -1.0, 1.0)
        axis = tuple(jnp.where(better, sign * p, x) for p, x in zip(proposed, axis))

    for i in range(3):
        reach = a[i] + b[0] * size[i][0] + b[1] * size[i][1] + b[2] * size[i][2]
        offer(jnp.abs(t[i]) - reach, t[i], [zero + float(i == k) for k in range(3)])
    for j in range(3):
        reach = b[j] + a[0] * size[0][j] + a[1] * size[1][j] + a[2] * size[2][j]
        offer(jnp.abs(in_b[j]) - reach, in_b[j], [r[k][j] for k in range(3)])
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            squared = r[i1][j] * r[i1][j] + r[i2][j] * r[i2][j]
            usable = squared > least
            scale = 1.0 / jnp.sqrt(jnp.where(usable, squared, 1.0))
            gap = t[i2] * r[i1][j] - t[i1] * r[i2][j]
            reach = a[i1] * size[i2][j] + a[i2] * size[i1][j] + b[j1] * size[i][j2] + b[j2] * size[i][j1]
            proposed = [zero, zero, zero]
            proposed[i1], proposed[i2] = -r[i2][j] * scale, r[i1][j] * scale
            offer(jnp.where(usable, (jnp.abs(gap) - reach) * scale, -jnp.inf), gap, proposed)
    return best, stack(*axis)


def oriented_boxes_gap(a: OrientedBox, b: OrientedBox) -> Scalar:
    """The largest gap [m] of two boxes along a direction: positive where some plane parts them, and then ≤ distance.

    Negative: minus the depth of overlap, exactly. `separation_of_boxes` gives the direction too.
    """
    turn_a, turn_b = a.pose.orientation.as_matrix(), b.pose.orientation.as_matrix()
    across = turn_a.swapaxes(-1, -2)
    apart = matvec(across, b.pose.position - a.pose.position)
    return separation_of_boxes(a.half_extents, b.half_extents, matmul(across, turn_b), apart)[0]
