"""Two oriented boxes: the fifteen directions that can part them."""

import jax.numpy as jnp

from jaxrb.geometry.bounds import OrientedBox
from jaxrb.math.arrays import Scalar, components, entries
from jaxrb.math.vector import matmul, matvec


def oriented_boxes_gap(a: OrientedBox, b: OrientedBox) -> Scalar:
    """The largest gap [m] of two boxes along a direction: positive where some plane parts them, and then ≤ distance.

    Negative: minus the depth of overlap, exactly. Gottschalk, Lin, Manocha 1996, "OBBTree: a hierarchical structure for
    rapid interference detection", section 5: three face normals each and nine products of edges.
    """
    turn_a = jnp.swapaxes(a.pose.orientation.as_matrix(), -1, -2)
    rotation = entries(matmul(turn_a, b.pose.orientation.as_matrix()))
    t = components(matvec(turn_a, b.pose.position - a.pose.position))
    half_a, half_b = components(a.half_extents), components(b.half_extents)
    size = [[jnp.abs(x) for x in row] for row in rotation]
    gaps = []
    for i in range(3):
        gaps.append(jnp.abs(t[i]) - half_a[i] - sum(half_b[j] * size[i][j] for j in range(3)))
        along = sum(t[j] * rotation[j][i] for j in range(3))
        gaps.append(jnp.abs(along) - half_b[i] - sum(half_a[j] * size[j][i] for j in range(3)))
    for i in range(3):
        for j in range(3):
            i1, i2, j1, j2 = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            squared = rotation[i1][j] ** 2 + rotation[i2][j] ** 2
            across = t[i2] * rotation[i1][j] - t[i1] * rotation[i2][j]
            reach = half_a[i1] * size[i2][j] + half_a[i2] * size[i1][j]
            reach = reach + half_b[j1] * size[i][j2] + half_b[j2] * size[i][j1]
            # Of parallel edges the product is noise, and a face normal parts whatever it could part.
            skew = squared > 64 * jnp.finfo(squared.dtype).eps
            length = jnp.sqrt(jnp.where(skew, squared, 1.0))
            gaps.append(jnp.where(skew, (jnp.abs(across) - reach) / length, gaps[0]))
    best = gaps[0]
    for gap in gaps[1:]:
        best = jnp.maximum(best, gap)
    return best
