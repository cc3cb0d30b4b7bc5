"""Where spheres and capsules touch each other and boxes: a core of a point or a segment, and its radius.

Every pair is looked at in the frame of the first shape; cores first, since these have closed forms.
"""

from typing import Any

import jax.numpy as jnp

from jaxrb.collision import closed_forms
from jaxrb.collision.manifold import Manifold
from jaxrb.geometry.primitives import Box, Capsule, Pose
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.safe import divide, safe_sqrt, unit_or
from jaxrb.math.settled import settled
from jaxrb.math.vector import dot, matvec

# Capsules more parallel than this (sine squared, 0.6°) lie on each other along a line, as one lies on the face of a box
# whose normal is the contact's to within 1 − cosine.
_PARALLEL = 1e-4
_FLAT = 1e-4


def touch_cores(shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose) -> Manifold:
    """Spheres and capsules: the nearest point; of two capsules side by side both ends of what they share."""
    across = pose_a.orientation.as_matrix().swapaxes(-1, -2)
    center = matvec(across, pose_b.position - pose_a.position)
    half_a, half_b = (jnp.asarray(closed_forms.segment_of(s)) for s in (shape_a, shape_b))
    along = matvec(across, pose_b.orientation.as_matrix()[:, 2])
    nearest = closed_forms.segments(half_a, half_b, along, center).grown(shape_a.rounding, shape_b.rounding)
    middle = 0.5 * (nearest.point_a + nearest.point_b)
    if not (isinstance(shape_a, Capsule) and isinstance(shape_b, Capsule)):
        return _in_world(pose_a, nearest.normal, [middle], [nearest.distance], [0], [True])
    x, y, z = components(along)
    c, f = components(center)[2], dot(along, center)
    reach = half_b * jnp.abs(z)
    low, high = jnp.maximum(-half_a, c - reach), jnp.minimum(half_a, c + reach)
    both = (x * x + y * y < _PARALLEL) & (high > low)
    points, distances = [], []
    for s in (low, high):
        t = jnp.clip(s * z - f, -half_b, half_b)
        on_b = center + t * along
        # The point of a's core beside it, at most a hair from where the search began.
        on_a = stack(jnp.zeros_like(s), jnp.zeros_like(s), jnp.clip(components(on_b)[2], -half_a, half_a))
        gap = dot(on_b - on_a, nearest.normal)
        points.append(0.5 * (on_a + on_b + (shape_a.rounding - shape_b.rounding) * nearest.normal))
        distances.append(gap - shape_a.rounding - shape_b.rounding)
    return _in_world(
        pose_a,
        nearest.normal,
        [jnp.where(both, points[0], middle), points[1]],
        [jnp.where(both, distances[0], nearest.distance), distances[1]],
        [jnp.where(both, 1, 0), 2],
        [True, both],
    )


def touch_box_sphere(box: Box, pose_box: Pose, sphere: Shape, pose: Pose) -> Manifold:
    """A sphere and a box: one point, also where the sphere's centre is inside."""
    across = pose_box.orientation.as_matrix().swapaxes(-1, -2)
    contact = closed_forms.sphere_and_box(box, matvec(across, pose.position - pose_box.position))
    contact = contact.grown(0.0, sphere.rounding)
    middle = 0.5 * (contact.point_a + contact.point_b)
    return _in_world(pose_box, contact.normal, [middle], [contact.distance], [0], [True])


def touch_box_capsule(box: Box, pose_box: Pose, capsule: Capsule, pose: Pose) -> Manifold:
    """A capsule and a box: the nearest point; where it lies on a face, both ends of what lies there."""
    across = pose_box.orientation.as_matrix().swapaxes(-1, -2)
    center = matvec(across, pose.position - pose_box.position)
    along = jnp.asarray(capsule.half_height) * matvec(across, pose.orientation.as_matrix()[:, 2])
    half = components(box.half_extents)
    p, d = components(center), components(along)
    s = settled(_nearest_on_segment(half, p, d))
    core = [x + s * v for x, v in zip(p, d)]
    away = [x - jnp.clip(x, -h, h) for x, h in zip(core, half)]
    squared = sum(x * x for x in away)
    out, depth, s_deep = settled(_way_out(half, p, d))
    size = half[0] + half[1] + half[2] + jnp.asarray(capsule.half_height)
    # Of a gap this small the direction is round-off.
    noise = 64 * jnp.finfo(size.dtype).eps * size
    apart = squared > noise * noise
    free = unit_or(stack(*away), stack(*out))
    normal = jnp.where(apart, free, stack(*out))
    gap = jnp.where(apart, safe_sqrt(squared), depth)
    s = jnp.where(apart, s, s_deep)
    # The program is compiled in half the time where its stages are kept apart.
    s, gap, n = settled((s, gap, components(normal)))
    normal = stack(*n)
    low, high, flat = _over_face(half, p, d, n)
    both = flat & (high > low)
    # Nearest may be a point just beyond the face's edge.
    low, high = jnp.minimum(low, s), jnp.maximum(high, s)
    middles, distances = [], []
    surface = sum(h * jnp.abs(x) for h, x in zip(half, n))
    for one, alone in ((jnp.where(both, low, s), True), (high, False)):
        point = [x + one * v for x, v in zip(p, d)]
        height = sum(x * y for x, y in zip(point, n)) - surface
        height = jnp.where(both, height, gap) if alone else height
        back = 0.5 * (height + capsule.radius)
        middles.append(stack(*(x - back * y for x, y in zip(point, n))))
        distances.append(height - capsule.radius)
    return _in_world(pose_box, normal, middles, distances, [jnp.where(both, 1, 0), 2], [True, both])


def _nearest_on_segment(half: Any, p: Any, d: Any) -> Scalar:
    """The s in [−1, 1] for which p + s d is nearest to a box.

    The squared distance is convex and piecewise quadratic in s, so its slope is piecewise linear and rises; it bends
    only where the segment meets one of the six planes. Its zero lies between the last bend below and the first above.
    """

    def slope(s: Scalar) -> Scalar:
        total = jnp.zeros_like(s)
        for x, v, h in zip(p, d, half):
            at = x + s * v
            total += v * (at - jnp.clip(at, -h, h))
        return total

    low, high = -jnp.ones_like(p[0]), jnp.ones_like(p[0])
    low_slope, high_slope = slope(low), slope(high)
    start, last = low_slope, high_slope
    for x, v, h in zip(p, d, half):
        for side in (-h, h):
            bend = jnp.clip(divide(side - x, v), -1.0, 1.0)
            here = slope(bend)
            rising, falling = here >= 0, here <= 0
            later, sooner = falling & (bend > low), rising & (bend < high)
            low, low_slope = jnp.where(later, bend, low), jnp.where(later, here, low_slope)
            high, high_slope = jnp.where(sooner, bend, high), jnp.where(sooner, here, high_slope)
    inner = jnp.where(
        low < high, low + (high - low) * divide(-low_slope, high_slope - low_slope), 0.5 * (low + high)
    )
    return jnp.where(start >= 0, jnp.where(last <= 0, inner, -1.0), jnp.where(last <= 0, 1.0, inner))


def _way_out(half: Any, p: Any, d: Any) -> Any:
    """The shortest way of a segment p ± d out of a box: unit normal, minus its length, and s of the point that leaves.

    By the normals of the box's faces and the products of its edges with the segment: those of the faces of the sum of
    both.
    """
    one, zero = jnp.ones_like(p[0]), jnp.zeros_like(p[0])
    best: Any = None
    for i in range(3):
        sign = jnp.where(p[i] < 0, -1.0, 1.0).astype(one.dtype)
        normal = [sign if i == k else zero for k in range(3)]
        gap = sign * p[i] - half[i] - jnp.abs(d[i])
        offered = (gap, *normal, jnp.where(sign * d[i] > 0, -one, one))
        best = offered if best is None else _larger(best, offered)
    scale = 1024 * jnp.finfo(one.dtype).eps
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        squared = d[j] * d[j] + d[k] * d[k]
        usable = squared > scale * d[i] * d[i]
        safe = jnp.where(usable, squared, 1.0)
        length = jnp.sqrt(safe)
        nj, nk = -d[k] / length, d[j] / length
        sign = jnp.where(p[j] * nj + p[k] * nk < 0, -1.0, 1.0).astype(one.dtype)
        nj, nk = sign * nj, sign * nk
        gap = p[j] * nj + p[k] * nk - half[j] * jnp.abs(nj) - half[k] * jnp.abs(nk)
        corner_j, corner_k = (
            jnp.where(nj < 0, -half[j], half[j]),
            jnp.where(nk < 0, -half[k], half[k]),
        )
        s = ((corner_j - p[j]) * d[j] + (corner_k - p[k]) * d[k]) / safe
        normal = [zero, zero, zero]
        normal[j], normal[k] = nj, nk
        best = _larger(best, (jnp.where(usable, gap, -jnp.inf), *normal, jnp.clip(s, -1.0, 1.0)))
    gap, *normal, s = best
    return normal, gap, s


def _larger(best: Any, offered: Any) -> Any:
    better = offered[0] > best[0]
    return tuple(jnp.where(better, x, y) for x, y in zip(offered, best))


def _over_face(half: Any, p: Any, d: Any, normal: Any) -> tuple[Scalar, Scalar, Array]:
    """Between which s the segment p + s d lies over the face that the normal is of, and whether it is of one."""
    one = jnp.ones_like(p[0])
    low, high, flat = -one, one, jnp.zeros((), bool)
    for x, v, h, n in zip(p, d, half, normal):
        across = jnp.abs(n) > 1.0 - _FLAT
        # A segment along the edge of the face stays beside it at all s, or at none.
        tiny = jnp.finfo(one.dtype).eps * h
        rate = 1.0 / jnp.where(jnp.abs(v) > tiny, v, tiny)
        first, last = (-h - x) * rate, (h - x) * rate
        low = jnp.where(across, low, jnp.maximum(low, jnp.minimum(first, last)))
        high = jnp.where(across, high, jnp.minimum(high, jnp.maximum(first, last)))
        flat |= across
    return low, high, flat


def _in_world(
    pose: Pose, normal: Vector, points: list[Any], distances: list[Any], names: list[Any], valid: list[Any]
) -> Manifold:
    """Points in the frame of the first shape as a manifold in W."""
    turn = pose.orientation.as_matrix()
    there = [jnp.asarray(v) & jnp.ones((), bool) for v in valid]
    moved = [components(pose.position + matvec(turn, p)) for p in points]
    position = (stack(*(jnp.where(v, m[i], 0.0) for v, m in zip(there, moved))) for i in range(3))
    feature = stack(*(jnp.where(v, jnp.asarray(n, jnp.int32), -1) for v, n in zip(there, names)))
    distance = stack(*(jnp.where(v, d, 0.0) for v, d in zip(there, distances)))
    return Manifold(
        stack(*position), matvec(turn, normal), distance, feature, stack(*there), jnp.zeros((), bool)
    )
