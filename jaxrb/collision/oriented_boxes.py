"""Two oriented boxes: the fifteen directions that can part them."""

from jaxrb.collision.obb import separation_of_boxes
from jaxrb.geometry.bounds import OrientedBox
from jaxrb.math.arrays import Scalar
from jaxrb.math.vector import matmul, matvec


def oriented_boxes_gap(a: OrientedBox, b: OrientedBox) -> Scalar:
    """The largest gap [m] of two boxes along a direction: positive where some plane parts them, and then ≤ distance.

    Negative: minus the depth of overlap, exactly. It is the first result of `collision.obb`, which has the direction.
    """
    turn_a, turn_b = a.pose.orientation.as_matrix(), b.pose.orientation.as_matrix()
    across = turn_a.swapaxes(-1, -2)
    apart = matvec(across, b.pose.position - a.pose.position)
    return separation_of_boxes(a.half_extents, b.half_extents, matmul(across, turn_b), apart)[0]
