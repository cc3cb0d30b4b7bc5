"""Exact penetration depth of two convex polytopes by branch and bound over arcs of normals.

The depth is the smallest F(n) = max n·a − min n·b over unit vectors n: how far b must move along n to leave a. On the
sphere of normals every edge of a is an arc between the normals of its two faces; together with the same picture of −b
the arcs cut the sphere into cells with one support point of each body. Inside a cell or an arc of a cell F has no
minimum where the bodies overlap, so the smallest value lies at a face normal of a or b or where an arc of a crosses
one of b. Crossings are not enumerated: between two normals whose support points on b are q1 and q2, F is at least the
larger of n·(p − q1) and n·(p − q2), which bounds it from below by their common value at the crossing. Arcs whose
bound beats the best value so far are cut in two there, the others need no look.

Any normal that is tried gives an upper bound of the depth, the arcs not yet cut a lower one: the answer carries its
own certificate.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxrb.collision.lanes import first_of, gathered, heights, row, unit
from jaxrb.math.settled import settled
from jaxrb.math.vector import dot_of as dot

# Arcs that wait to be cut again; more than this many at once have not been seen.
_WAITING = 6


class NormalFan(NamedTuple):
    """A polytope for this search: `points` (n, 3, L), unit face normals (f, 3, L), and for each edge one of its ends
    (e, L) and the numbers of its two faces (e, L) each. Whole numbers may have a last axis of 1: the same for all.
    `offsets` (f, L): of the faces along their normals where these are at hand, None: what the points say.
    """

    points: Any
    normals: Any
    ends: Any
    faces: tuple[Any, Any]
    offsets: Any = None


class Depth(NamedTuple):
    """Direction (3, L) in which b leaves a soonest, the depth found there (L,) and a lower bound of the depth (L,)."""

    normal: Any
    depth: Any
    lower: Any
    turns: Any


class _Search(NamedTuple):
    best: Any  # (L,) smallest value so far
    normal: Any  # (3, L) where
    edge_bounds: Any  # (e, L) lower bounds of whole edges, infinite once cut
    waiting: Any  # (w, L) lower bounds of parts of edges
    parts: Any  # (15, w, L) these: end p, normals n1 n2, support points q1 q2
    bound: Any  # (L,) lower bound of the part in hand, the least of all
    part: Any  # (15, L)
    crossing: Any  # (3, L) where to cut it, not of length one
    dropped: Any  # (L,) smallest bound that had no room to wait
    done: Any
    turns: Any


def depth_by_arcs(a: NormalFan, b: NormalFan, scale: Any, turns: int = 64) -> Depth:
    """The depth for L overlapping pairs, to a few round-offs of `scale` (L,), the largest coordinate."""
    tolerance = 8 * jnp.finfo(scale.dtype).eps * scale
    least, normal, supports = settled(_face_values(a, b))
    best = least
    if a.offsets is not None or b.offsets is not None:
        # A sliver's normal, known to few digits, lets corners stand out beyond its own.
        out, back = (heights(fan.points, list(normal)) for fan in (a, b))
        best = jnp.maximum(best, out.max(axis=0) - back.min(axis=0))
    if a.ends.shape[0] == 0 or b.ends.shape[0] == 0:
        # A point has no edges, and then all minima are at the other's faces.
        return Depth(normal, best, least - tolerance, jnp.zeros((), jnp.int32))
    state = _start(a, supports, best, normal, scale, tolerance)
    found = lax.while_loop(
        lambda s: (s.turns < turns) & ~jnp.all(s.done),
        lambda s: _turn(a, b, supports, s, tolerance),
        state,
    )
    open_bound = jnp.where(found.done, jnp.inf, found.bound)
    lower = jnp.minimum(jnp.minimum(jnp.minimum(found.best, least) - tolerance, open_bound), found.dropped)
    return Depth(found.normal, found.best, lower, found.turns)


def _face_values(a: NormalFan, b: NormalFan) -> tuple[Any, Any, Any]:
    """The smallest value at a face normal, that normal, and b's support points (f, 3, L) at the normals of a."""
    infinite = jnp.full(a.points.shape[2:], jnp.inf, a.points.dtype)
    best, normal, supports = infinite, jnp.zeros((3, *infinite.shape), a.points.dtype), None
    for one, other, sign in ((a, b, 1.0), (b, a, -1.0)):
        if one.normals.shape[0] == 0:
            continue
        values, numbers = settled(_supported(one, other, sign > 0))
        if numbers is not None:
            supports = jnp.stack([gathered(other.points[:, k], numbers) for k in range(3)], axis=1)
        which = first_of(values <= values.min(axis=0))
        better = values.min(axis=0) < best
        normal = jnp.where(better, sign * row(one.normals, which), normal)
        best = jnp.where(better, values.min(axis=0), best)
    return best, normal, supports


def _supported(one: NormalFan, other: NormalFan, numbered: bool) -> tuple[Any, Any]:
    """How far the other must move along each face normal (f, L), and its support points' numbers (f, L).

    One face at a time: what it needs then stays in the caches. All 124 faces of a hull of 64 corners at once are 8 MB,
    and cost twice as much.
    """

    def of_face(face: Any) -> tuple[Any, Any]:
        normals, offset = face
        reach = settled(heights(other.points, normals))
        least = reach.min(axis=0)
        own = heights(one.points, normals).max(axis=0) if offset is None else offset
        return own - least, first_of(reach <= least) if numbered else None

    return lax.map(of_face, (one.normals, one.offsets))


def _gather3(table: Any, numbers: Any) -> list[Any]:
    return [gathered(table[:, k], numbers) for k in range(3)]


def _crossing(n1: Any, n2: Any, q1: Any, q2: Any) -> tuple[Any, Any]:
    """Where n·q1 = n·q2 on the way from n1 to n2, as a share of the chord; whether there is such a place."""
    step = [q2[k] - q1[k] for k in range(3)]
    first = jnp.maximum(dot(n1, step), 0.0)
    second = jnp.maximum(-dot(n2, step), 0.0)
    total = first + second
    return first / jnp.where(total > 0, total, 1.0), total > 0


def _lower_bound(p: Any, n1: Any, n2: Any, q1: Any, q2: Any) -> Any:
    """The least that n·p − min n·b can be between n1 and n2, without the ends; infinite if one point supports all."""
    t, exists = _crossing(n1, n2, q1, q2)
    lever = [p[k] - q1[k] for k in range(3)]
    s1, s2 = dot(n1, lever), dot(n2, lever)
    chord = [n1[k] + t * (n2[k] - n1[k]) for k in range(3)]
    squared = dot(chord, chord)
    valid = exists & (squared > 0)
    return jnp.where(valid, (s1 + t * (s2 - s1)) / jnp.sqrt(jnp.where(valid, squared, 1.0)), jnp.inf)


def _start(a: NormalFan, supports: Any, best: Any, normal: Any, scale: Any, tolerance: Any) -> _Search:
    p = _gather3(a.points, a.ends)
    n1, n2 = (_gather3(a.normals, faces) for faces in a.faces)
    q1, q2 = (_gather3(supports, faces) for faces in a.faces)
    dtype, lanes = scale.dtype, scale.shape[0]
    nothing = jnp.full((_WAITING, lanes), jnp.inf, dtype)
    state = _Search(
        best=best,
        normal=normal,
        edge_bounds=_lower_bound(p, n1, n2, q1, q2),
        waiting=nothing,
        parts=jnp.zeros((15, _WAITING, lanes), dtype),
        bound=best,
        part=jnp.zeros((15, lanes), dtype),
        crossing=jnp.zeros((3, lanes), dtype),
        dropped=jnp.full(lanes, jnp.inf, dtype),
        done=jnp.zeros(lanes, bool),
        turns=jnp.zeros((), jnp.int32),
    )
    return _next(a, supports, state, tolerance)


def _next(a: NormalFan, supports: Any, s: _Search, tolerance: Any) -> _Search:
    """Take the part with the least bound in hand; done where that bound cannot beat the best value."""
    least_edge = s.edge_bounds.min(axis=0)
    edge = first_of(s.edge_bounds <= least_edge)
    least_part = s.waiting.min(axis=0)
    place = first_of(s.waiting <= least_part)
    is_part = least_part <= least_edge
    bound = jnp.where(is_part, least_part, least_edge)
    first, second = (row(jnp.broadcast_to(f, (f.shape[0], f.shape[-1])), edge) for f in a.faces)
    of_edge = jnp.concatenate(
        [
            row(a.points, row(a.ends, edge)),
            row(a.normals, first),
            row(a.normals, second),
            row(supports, first),
            row(supports, second),
        ]
    )
    chosen = lax.broadcasted_iota(jnp.int32, s.waiting.shape, 0) == place
    of_part = jnp.where(chosen[None], s.parts, 0.0).sum(axis=1)
    part = jnp.where(is_part, of_part, of_edge)
    taken = lax.broadcasted_iota(jnp.int32, s.edge_bounds.shape, 0) == edge
    n1, n2, q1, q2 = part[3:6], part[6:9], part[9:12], part[12:15]
    t, _ = _crossing(n1, n2, q1, q2)
    return s._replace(
        edge_bounds=jnp.where(taken & ~is_part, jnp.inf, s.edge_bounds),
        waiting=jnp.where(chosen & is_part, jnp.inf, s.waiting),
        bound=bound,
        part=part,
        # Carried round the loop before it is made a unit vector: otherwise the compiler forms it twice with different
        # rounding, and normal and value no longer belong together where two arcs nearly coincide.
        crossing=jnp.stack([n1[k] + t * (n2[k] - n1[k]) for k in range(3)]),
        done=s.done | ~(bound < s.best - tolerance),
    )


def _turn(a: NormalFan, b: NormalFan, supports: Any, s: _Search, tolerance: Any) -> _Search:
    """Cut the part in hand where its two bounds cross, and put both pieces back."""
    m = unit(s.crossing)
    p, n1, n2, q1, q2 = (s.part[3 * k : 3 * k + 3] for k in range(5))
    reach = heights(b.points, m)
    least = reach.min(axis=0)
    q3 = row(b.points, first_of(reach <= least))
    value = dot(m, p) - least
    active = ~s.done & (dot(m, m) > 0)
    better = active & (value < s.best)
    best = jnp.where(better, value, s.best)
    # Supported by a point already known the bound was exact, and there is nothing more to find in between.
    known = jnp.all(q3 == q1, axis=0) | jnp.all(q3 == q2, axis=0)
    cut = active & ~known & (value > s.bound + tolerance)
    waiting, parts, dropped = s.waiting, s.parts, s.dropped
    places = lax.broadcasted_iota(jnp.int32, waiting.shape, 0)
    for piece in ((p, n1, m, q1, q3), (p, m, n2, q3, q2)):
        bound = _lower_bound(*piece)
        put = cut & (bound < best - tolerance)
        most = waiting.max(axis=0)
        place = (places == first_of(waiting >= most)) & put
        dropped = jnp.where(put, jnp.minimum(dropped, most), dropped)
        waiting = jnp.where(place, bound, waiting)
        parts = jnp.where(place[None], jnp.concatenate(piece)[:, None], parts)
    s = s._replace(
        best=best,
        normal=jnp.where(better, m, s.normal),
        waiting=waiting,
        parts=parts,
        dropped=dropped,
        turns=s.turns + 1,
    )
    return _next(a, supports, s, tolerance)
