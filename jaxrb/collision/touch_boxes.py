"""Where two boxes touch, by components: fifteen axes, then one face clipped by the other.

The axis of least overlap (Gottschalk, Lin, Manocha 1996, "OBBTree") names either two edges that cross or the reference
face, whose rectangle clips the face of the other box that looks most at it, the incident face. Everything is arithmetic
of scalars: under `vmap` each becomes one loop over the pairs.

A search says in whole numbers which axis, faces, edges and lines meet; formulas say where, and only they have a
derivative. A reverse pass keeps the whole numbers: nine tenths of the program are the search.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxrb.collision.manifold import Manifold
from jaxrb.collision.obb import fifteen_axes
from jaxrb.collision.touch_clip import PLACES, Corners, Quad, coordinates, four_corners
from jaxrb.geometry.primitives import Box, Pose
from jaxrb.math.arrays import Array, Scalar, components, entries, stack
from jaxrb.math.kept import kept
from jaxrb.math.settled import settled
from jaxrb.math.vector import cross_of, dot_of

# An axis replaces those before it only where it is better by this share of the boxes' half edges added up: of two boxes
# at rest the same face stays the reference, and no crossing of edges takes the place of a face by round-off.
_PREFERENCE = 2e-5
_FACE_NAMES = 6 * 2 * 6 * PLACES  # axis and side of the reference face, incident face, place in the outline


class _Boxes(NamedTuple):
    """Half edges, axes in W (three vectors each) and the way from a to b, all by components."""

    half_a: Any
    axes_a: Any
    half_b: Any
    axes_b: Any
    apart: Any


class _Choice(NamedTuple):
    """What meets: the best `axis` (0–14); the reference face on the positive side of its axis if `toward`; the incident
    face across edge `lying` of the other box, on its negative side if `below`; the corners of what they share."""

    axis: Array
    toward: Array
    lying: Array
    below: Array
    corners: Corners


class _Faces(NamedTuple):
    """The reference face: `axes` of its box in W, the last one out of the face, with the `half` edges along them.

    The incident face: its `middle` from the centre of the reference box, and `across` it two half edges, all in W.
    `gap` [m] of the boxes along the last axis.
    """

    axes: Any
    half: Any
    across: Any
    middle: Any
    gap: Scalar


def touch_boxes(box_a: Box, pose_a: Pose, box_b: Box, pose_b: Pose) -> Manifold:
    """Four points where faces meet, one where edges cross. One pair, all numbers of one floating type.

    The deepest distance is the exact depth where the boxes overlap. Where they are apart it is the gap along the best
    of the fifteen axes: the distance itself where a corner faces a side or two edges cross, and less than it where a
    corner faces corner or edge; then nothing lies over the face, and the incident corner nearest to it is the point.
    """
    half_a, half_b = components(box_a.half_extents), components(box_b.half_extents)
    # Axes of each box as vectors in W: the columns of its matrix.
    axes_a, axes_b = (list(zip(*entries(p.orientation.as_matrix()))) for p in (pose_a, pose_b))
    boxes = _Boxes(half_a, axes_a, half_b, axes_b, components(pose_b.position - pose_a.position))
    choice = kept(_search(_Boxes(*(_fixed(part) for part in boxes))))
    of_b, crossed = (choice.axis >= 3) & (choice.axis < 6), choice.axis >= 6
    faces = _laid(choice, boxes)
    quad = _quad(faces)
    s, t = coordinates(choice.corners, quad)
    alone = choice.corners.alone & (jnp.arange(4) == 0)
    height = jnp.where(alone, faces.gap, quad.middle[2] + s * quad.u[2] + t * quad.w[2])
    edge_normal, edge_point, edge_gap = _crossing(choice.axis, boxes)
    out = faces.axes[2]
    side = jnp.where(of_b, -1.0, 1.0).astype(height.dtype)
    normal = [jnp.where(crossed, n, side * e) for n, e in zip(edge_normal, out)]
    origins = zip(components(pose_a.position), components(pose_b.position))
    origin = [jnp.where(of_b, q, p) for p, q in origins]
    there = jnp.where(crossed, jnp.arange(4) == 0, choice.corners.place >= 0)
    place = [m + s * p + t * q - 0.5 * height * e for m, p, q, e in zip(faces.middle, *faces.across, out)]
    place = [o + jnp.where(crossed, p, q) for o, p, q in zip(origin, edge_point, place)]
    position = stack(*(jnp.where(there, x, 0.0) for x in place))
    distance = jnp.where(there, jnp.where(crossed, edge_gap, height), 0.0)
    name = jnp.where(crossed, _FACE_NAMES + choice.axis, _face_name(choice) * PLACES + choice.corners.place)
    feature = jnp.where(there, name, -1)
    return Manifold(position, stack(*normal), distance, feature, there, jnp.zeros((), bool))


def _fixed(part: Any) -> Any:
    return tuple(_fixed(x) for x in part) if isinstance(part, (tuple, list)) else lax.stop_gradient(part)


def _search(boxes: _Boxes) -> _Choice:
    axis = settled(_best_axis(boxes))[0]
    toward, lying, below = _facing(axis, boxes)
    choice = _Choice(axis, *settled((toward, lying, below)), None)  # type: ignore[arg-type]
    corners = four_corners(_quad(settled(_laid(choice, boxes))))
    return choice._replace(corners=corners)


def _quad(faces: _Faces) -> Quad:
    """The incident face in the frame of the reference face."""
    middle, u, w = (tuple(dot_of(v, e) for e in faces.axes) for v in (faces.middle, *faces.across))
    return Quad((*middle[:2], middle[2] - faces.half[2]), u, w, faces.half[:2])


def _face_name(choice: _Choice) -> Array:
    axis = jnp.where(choice.axis < 6, choice.axis, 0)
    return (axis * 2 + choice.toward) * 6 + choice.lying * 2 + choice.below


def _third(number: Array, choices: Any) -> Any:
    """One of three scalars, or of three equal tuples of them, by a whole number."""
    if isinstance(choices[0], tuple):
        return tuple(_third(number, parts) for parts in zip(*choices))
    return jnp.where(number == 0, choices[0], jnp.where(number == 1, choices[1], choices[2]))


def _turned_to(number: Array, choices: Any) -> Any:
    """Three of three in cyclic order, the one of that number last."""
    a, b, c = choices
    return [_third(number, three) for three in ((b, c, a), (c, a, b), (a, b, c))]


def _best_axis(boxes: _Boxes) -> tuple[Array, Scalar]:
    """Number of the axis of the largest gap, and the gap [m]: 0–2 faces of a, 3–5 of b, 6–14 edges 6 + 3i + j."""
    half_a, axes_a, half_b, axes_b, apart = boxes
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


def _reference(axis: Array, boxes: _Boxes) -> Any:
    """Axes and half edges of the box with the reference face, its own last; of the other; the way there."""
    of_b = (axis >= 3) & (axis < 6)

    def either(p: Any, q: Any) -> Any:
        return jnp.where(of_b, p, q)

    own = [tuple(either(q, p) for p, q in zip(u, v)) for u, v in zip(boxes.axes_a, boxes.axes_b)]
    other = [tuple(either(p, q) for p, q in zip(u, v)) for u, v in zip(boxes.axes_a, boxes.axes_b)]
    half = [either(q, p) for p, q in zip(boxes.half_a, boxes.half_b)]
    half_other = [either(p, q) for p, q in zip(boxes.half_a, boxes.half_b)]
    shift = [either(-s, s) for s in boxes.apart]
    number = jnp.where(axis < 6, axis % 3, 0)
    return _turned_to(number, own), _turned_to(number, half), other, half_other, shift


def _facing(axis: Array, boxes: _Boxes) -> tuple[Array, Array, Array]:
    """`toward`, `lying` and `below` of the choice."""
    (_, _, out), _, other, _, shift = _reference(axis, boxes)
    toward = dot_of(out, shift) >= 0
    facing = [dot_of(out, v) for v in other]
    f = [jnp.abs(x) for x in facing]
    lying = jnp.where((f[0] >= f[1]) & (f[0] >= f[2]), 0, jnp.where(f[1] >= f[2], 1, 2)).astype(jnp.int32)
    return toward, lying, (_third(lying, facing) > 0) == toward


def _laid(choice: _Choice, boxes: _Boxes) -> _Faces:
    (first, second, third), half, other, half_other, shift = _reference(choice.axis, boxes)
    third = tuple(jnp.where(choice.toward, x, -x) for x in third)
    reach = sum(h * jnp.abs(dot_of(third, v)) for h, v in zip(half_other, other))
    u, w, v = _turned_to(choice.lying, other)
    du, dw, dv = _turned_to(choice.lying, half_other)
    middle = tuple(s + jnp.where(choice.below, -dv, dv) * x for s, x in zip(shift, v))
    across = (tuple(du * x for x in u), tuple(dw * x for x in w))
    return _Faces((first, second, third), half, across, middle, dot_of(third, shift) - half[2] - reach)


def _crossing(code: Array, boxes: _Boxes) -> Any:
    """Where edge i of a crosses edge j of b: the unit normal in W, the point midway from the centre of a, the gap."""
    half_a, axes_a, half_b, axes_b, apart = boxes
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
    middle = [0.5 * (on_a[m] + s * along_a[m] + on_b[m] + t * along_b[m]) for m in range(3)]
    return normal, middle, dot_of(normal, between)
