"""Where two boxes touch, by components: fifteen axes, then one face clipped by the other.

The axis of least overlap (Gottschalk, Lin, Manocha 1996, "OBBTree") names either two edges that cross or the reference
face, whose rectangle clips the face of the other box that looks most at it, the incident face. Everything is arithmetic
of scalars: under `vmap` each becomes one loop over the pairs.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxrb.collision.manifold import Manifold
from jaxrb.collision.obb import fifteen_axes
from jaxrb.collision.touch_clip import PLACES, Quad, four_corners
from jaxrb.geometry.primitives import Box, Pose
from jaxrb.math.arrays import Array, Scalar, components, entries, stack
from jaxrb.math.settled import settled
from jaxrb.math.vector import cross_of, dot_of

# An axis replaces those before it only where it is better by this share of the boxes' half edges added up: of two boxes
# at rest the same face stays the reference, and no crossing of edges takes the place of a face by round-off.
_PREFERENCE = 2e-5
_FACE_NAMES = 6 * 2 * 6 * PLACES  # axis and side of the reference face, incident face, place in the outline


class _Faces(NamedTuple):
    """The reference face: `axes` of its box in W, the last one out of the face, with the `half` edges along them.

    The incident face: its `middle` from the centre of the reference box, and `across` it two half edges, all in W.
    `name`: a number for the two.
    """

    axes: Any
    half: Any
    across: Any
    middle: Any
    name: Array


def touch_boxes(box_a: Box, pose_a: Pose, box_b: Box, pose_b: Pose) -> Manifold:
    """Four points where faces meet, one where edges cross. One pair, all numbers of one floating type.

    The deepest distance is the exact depth where the boxes overlap. Where they are apart it is the gap along the best
    of the fifteen axes: the distance itself where a corner faces a side or two edges cross, and less than it where a
    corner faces corner or edge; then nothing lies over the face, and the incident corner nearest to it is the point.
    """
    half_a, half_b = components(box_a.half_extents), components(box_b.half_extents)
    # Axes of each box as vectors in W: the columns of its matrix.
    axes_a, axes_b = (list(zip(*entries(p.orientation.as_matrix()))) for p in (pose_a, pose_b))
    apart = components(pose_b.position - pose_a.position)
    code, gap = settled(_best_axis(half_a, axes_a, half_b, axes_b, apart))
    of_b, crossed = (code >= 3) & (code < 6), code >= 6
    faces = settled(_faces(code, of_b, half_a, axes_a, half_b, axes_b, apart))
    u, w = faces.across
    local = [tuple(dot_of(v, e) for e in faces.axes) for v in (faces.middle, u, w)]
    local[0] = (*local[0][:2], local[0][2] - faces.half[2])
    corners = four_corners(Quad(local[0], local[1], local[2], faces.half[:2]), gap)
    crossing = _crossing(code, half_a, axes_a, half_b, axes_b, apart)
    corners, crossing = settled((corners, crossing))
    edge_normal, edge_point = crossing
    out, middle = faces.axes[2], faces.middle
    side = jnp.where(of_b, -1.0, 1.0).astype(gap.dtype)
    normal = [jnp.where(crossed, n, side * e) for n, e in zip(edge_normal, out)]
    origins = zip(components(pose_a.position), components(pose_b.position))
    origin = [jnp.where(of_b, q, p) for p, q in origins]
    position, distance, feature, valid = [], [], [], []
    for k, corner in enumerate(corners):
        there = jnp.where(crossed, k == 0, corner.valid)
        place = [
            m + corner.s * p + corner.t * q - 0.5 * corner.height * e for m, p, q, e in zip(middle, u, w, out)
        ]
        place = [o + jnp.where(crossed, p, q) for o, p, q in zip(origin, edge_point, place)]
        name = jnp.where(crossed, _FACE_NAMES + code, faces.name * PLACES + corner.place)
        position.append([jnp.where(there, p, 0.0) for p in place])
        distance.append(jnp.where(there, jnp.where(crossed, gap, corner.height), 0.0))
        feature.append(jnp.where(there, name, -1))
        valid.append(there)
    rows = stack(*(stack(*x) for x in zip(*position)))
    return Manifold(
        rows, stack(*normal), stack(*distance), stack(*feature), stack(*valid), jnp.zeros((), bool)
    )


def _third(number: Array, choices: Any) -> Any:
    """One of three scalars, or of three equal tuples of them, by a whole number."""
    if isinstance(choices[0], tuple):
        return tuple(_third(number, parts) for parts in zip(*choices))
    return jnp.where(number == 0, choices[0], jnp.where(number == 1, choices[1], choices[2]))


def _turned_to(number: Array, choices: Any) -> Any:
    """Three of three in cyclic order, the one of that number last."""
    a, b, c = choices
    return [_third(number, three) for three in ((b, c, a), (c, a, b), (a, b, c))]


def _best_axis(half_a: Any, axes_a: Any, half_b: Any, axes_b: Any, apart: Any) -> tuple[Array, Scalar]:
    """Number of the axis of the largest gap, and the gap [m]: 0–2 faces of a, 3–5 of b, 6–14 edges 6 + 3i + j."""
    r = [[dot_of(p, q) for q in axes_b] for p in axes_a]
    t, in_b = [dot_of(apart, p) for p in axes_a], [dot_of(apart, q) for q in axes_b]
    preference = _PREFERENCE * (sum(half_a) + sum(half_b))
    # Products of edges more parallel than this are round-off, and say nothing that the faces do not.
    least = 1024 * jnp.finfo(t[0].dtype).eps
    gaps = [axis.gap for axis in fifteen_axes(half_a, half_b, r, t, in_b, least)]
    best, code = gaps[0], jnp.zeros((), jnp.int32)
    for number, gap in enumerate(gaps[1:], 1):
        better = gap > best + preference
        best, code = jnp.where(better, gap, best), jnp.where(better, number, code)
    return code.astype(jnp.int32), best


def _faces(
    code: Array, of_b: Array, half_a: Any, axes_a: Any, half_b: Any, axes_b: Any, apart: Any
) -> _Faces:
    number = jnp.where(code < 6, code % 3, 0)

    def either(p: Any, q: Any) -> Any:
        return jnp.where(of_b, p, q)

    own = [tuple(either(q, p) for p, q in zip(u, v)) for u, v in zip(axes_a, axes_b)]
    other = [tuple(either(p, q) for p, q in zip(u, v)) for u, v in zip(axes_a, axes_b)]
    half = [either(q, p) for p, q in zip(half_a, half_b)]
    half_other = [either(p, q) for p, q in zip(half_a, half_b)]
    shift = [either(-s, s) for s in apart]
    first, second, third = _turned_to(number, own)
    toward = dot_of(third, shift) >= 0
    third = tuple(jnp.where(toward, x, -x) for x in third)
    half = _turned_to(number, half)
    facing = [dot_of(third, v) for v in other]
    f = [jnp.abs(x) for x in facing]
    lying = jnp.where((f[0] >= f[1]) & (f[0] >= f[2]), 0, jnp.where(f[1] >= f[2], 1, 2)).astype(jnp.int32)
    below = _third(lying, facing) > 0
    u, w, v = _turned_to(lying, other)
    du, dw, dv = _turned_to(lying, half_other)
    middle = tuple(s + jnp.where(below, -dv, dv) * x for s, x in zip(shift, v))
    name = (jnp.where(code < 6, code, 0) * 2 + toward) * 6 + lying * 2 + below
    across = (tuple(du * x for x in u), tuple(dw * x for x in w))
    return _Faces((first, second, third), half, across, middle, name.astype(jnp.int32))


def _crossing(code: Array, half_a: Any, axes_a: Any, half_b: Any, axes_b: Any, apart: Any) -> Any:
    """Where edge i of a crosses edge j of b: the unit normal, and the point midway from the centre of a, both in W."""
    pair = jnp.where(code < 6, 0, code - 6)
    i, j = pair // 3, pair % 3
    along_a, along_b = _third(i, axes_a), _third(j, axes_b)
    product = cross_of(along_a, along_b)
    squared = dot_of(product, product)
    # Parallel only where faces meet, and the answer is not used.
    squared = jnp.where(code < 6, 1.0, squared)
    scale = jnp.where(dot_of(product, apart) < 0, -1.0, 1.0) / jnp.sqrt(squared)
    normal = tuple(scale * x for x in product)

    def edge(number: Array, half: Any, axes: Any, sign: float) -> Any:
        """The middle of the edge farthest along ±normal."""
        reach = [
            jnp.where(number == k, 0.0, jnp.where(dot_of(normal, axes[k]) < 0, -sign, sign) * half[k])
            for k in range(3)
        ]
        return [sum(reach[k] * axes[k][m] for k in range(3)) for m in range(3)]

    on_a = edge(i, half_a, axes_a, 1.0)
    on_b = [x + y for x, y in zip(apart, edge(j, half_b, axes_b, -1.0))]
    between = [y - x for x, y in zip(on_a, on_b)]
    cosine, p, q = dot_of(along_a, along_b), dot_of(between, along_a), dot_of(between, along_b)
    s, t = (p - cosine * q) / squared, (cosine * p - q) / squared
    return normal, [0.5 * (on_a[m] + s * along_a[m] + on_b[m] + t * along_b[m]) for m in range(3)]
