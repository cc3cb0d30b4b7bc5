"""Distance of two convex sets known by their support maps (Gilbert, Johnson, Keerthi 1988).

GJK looks for the point v nearest to the origin in the set of differences A − B. It keeps up to four differences of
support points and in each turn adds the one farthest along −v, then throws away those that the nearest point of the
simplex does without. v·w / |v| for the added difference w bounds the distance from below, |v| from above.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxrb.collision.lanes import cross
from jaxrb.math.settled import settled
from jaxrb.math.vector import dot_of as dot

# (3, L) directions to support points (3, L) and their numbers (L,).
Support = Callable[[Any], tuple[Any, Any]]


class Simplex(NamedTuple):
    """What GJK ends with, for L pairs.

    `nearest` (3, L) is the difference of smallest length, Σ weights · differences; `overlapping` says that the simplex
    holds the origin. `lower` (L,) bounds the distance from below. `numbers` (4, L) are those of the vertices of a
    times 65536 plus those of b; `points_a` (4, 3, L) is None where these suffice.
    """

    differences: Any
    points_a: Any
    numbers: Any
    weights: Any
    nearest: Any
    squared: Any
    lower: Any
    overlapping: Any
    done: Any
    turns: Any


def nearest_on_simplex(corners: Any) -> tuple[Any, Any, Any]:
    """The point nearest to the origin of simplices (4, 3, L): weights (4, L), the point (3, L), whether it holds it.

    Only sub-simplices with the newest corner, the last, are tried: the others were in an earlier turn. Corners that
    are not in use are copies of the newest, which makes every sub-simplex with them degenerate, and those are passed
    over. Candidates are compared by their distance, so no case distinction can contradict itself through round-off;
    those of one kind are computed as one array, which halves compile time, and stored before one is chosen, or each
    of the many sums that a choice leads to would compute all of them again.
    """
    a, b, c, d = corners
    zero = jnp.zeros_like(d[0])
    tiny = jnp.finfo(zero.dtype).tiny
    # Components first, candidates second.
    others = jnp.moveaxis(corners[:3], 1, 0)
    newest = d[:, None]
    sides = others - newest
    squared = dot(sides, sides)
    t = -dot(newest, sides) / jnp.where(squared > 0, squared, 1.0)
    points = newest + t * sides
    # Made perpendicular once more: where the shapes nearly touch, a sum of long vectors has lost its direction.
    points = points - sides * (dot(points, sides) / jnp.where(squared > 0, squared, 1.0))
    on_edges = jnp.where((t > 0) & (t < 1) & (squared > 0), dot(points, points), jnp.inf)
    first, second = (jnp.stack([others[:, k] for k in ks], axis=1) for ks in ((0, 0, 1), (1, 2, 2)))
    normals = cross(first - newest, second - newest)
    squared = dot(normals, normals)
    safe = jnp.where(squared > 0, squared, 1.0)
    u = dot(cross(second, newest), normals) / safe
    v = dot(cross(newest, first), normals) / safe
    w = 1.0 - u - v
    height = dot(newest, normals)
    on_faces = jnp.where((u > 0) & (v > 0) & (w > 0) & (squared > tiny), height * height / safe, jnp.inf)
    whole = dot(d - a, cross(b - d, c - d))
    safe = jnp.where(whole != 0, whole, 1.0)
    c_d = cross(c, d)
    p, q, r = dot(b, c_d) / safe, -dot(a, c_d) / safe, dot(a, cross(b, d)) / safe
    rest = 1.0 - p - q - r
    inside = (p > 0) & (q > 0) & (r > 0) & (rest > 0) & (jnp.abs(whole) > tiny)
    in_whole = jnp.where(inside, -1.0, jnp.inf)
    z, s = zero, 1.0 - t
    on_corner = [z, z, z, zero + 1.0]
    on_side = [t[0], z, z, s[0], z, t[1], z, s[1], z, z, t[2], s[2]]
    on_face = [u[0], v[0], z, w[0], u[1], z, v[1], w[1], z, u[2], v[2], w[2]]
    weights = jnp.stack([*on_corner, *on_side, *on_face, p, q, r, rest]).reshape(8, 4, -1)
    values = jnp.concatenate([dot(d, d)[None], on_edges, on_faces, in_whole[None]])
    on_plane = normals * (height / jnp.where(squared > 0, squared, 1.0))
    nearest = jnp.concatenate([newest, points, on_plane, jnp.zeros_like(newest)], axis=1)
    choices = jnp.concatenate([weights, jnp.moveaxis(nearest, 0, 1)], axis=1)
    values, choices = settled((values, choices))
    # Of candidates that differ by round-off only the one with most corners is right: it alone knows how far aside of
    # the others the nearest point lies.
    least = values.min(axis=0)
    equal = values <= least + 4 * jnp.finfo(values.dtype).eps * jnp.abs(least)
    candidates = lax.broadcasted_iota(jnp.int32, (8, 1, 1), 0)
    chosen = jnp.where(equal, candidates[:, 0], 0).max(axis=0)
    choice = jnp.where(candidates == chosen, choices, 0.0).sum(axis=0)
    return choice[:4], choice[4:], values[7] < 0


def gjk(
    support_a: Support, support_b: Support, towards: Any, scale: Any, turns: int, remember: bool, slack: Any
) -> Simplex:
    """GJK for L pairs, until every one is done or `turns` are over.

    Args:
        towards: (3, L), a first guess of the direction from a to b, not zero.
        scale: (L,), the largest coordinate that appears; distances are found to a few round-offs of it.
        slack: share by which a squared distance may grow in a turn. Zero ends the search where the distance is found, a
            few round-offs let it go on to the nearest points themselves, which are known to a root of that.
        remember: keep the points of a, where they cannot be looked up by number.
    """
    eps = jnp.finfo(towards.dtype).eps
    point_a, number_a = support_a(towards)
    point_b, number_b = support_b(-towards)
    difference = point_a - point_b
    false = jnp.zeros(scale.shape, bool)
    start = Simplex(
        differences=jnp.stack([difference] * 4),
        points_a=jnp.stack([point_a] * 4) if remember else None,
        numbers=jnp.stack([number_a * 65536 + number_b] * 4),
        weights=jnp.zeros((4, *scale.shape), scale.dtype).at[0].set(1.0),
        nearest=difference,
        squared=dot(difference, difference),
        lower=jnp.full_like(scale, -jnp.inf),
        overlapping=false,
        done=false,
        turns=jnp.zeros((), jnp.int32),
    )

    def turn(s: Simplex) -> Simplex:
        point_a, number_a = support_a(-s.nearest)
        point_b, number_b = support_b(s.nearest)
        difference, number = settled((point_a - point_b, number_a * 65536 + number_b))
        reach = dot(s.nearest, difference)
        length = jnp.sqrt(jnp.where(s.squared > 0, s.squared, 1.0))
        lower = jnp.maximum(s.lower, jnp.where(s.done | (s.squared <= 0), -jnp.inf, reach / length))
        converged = (s.squared - reach <= 4 * eps * length * scale) | (s.squared <= (4 * eps * scale) ** 2)
        # The newest corner goes last; a corner in use there moves to the first place that is free.
        places = lax.broadcasted_iota(jnp.int32, s.weights.shape, 0)
        place = places == _first_free(s.weights)
        kept = (jnp.where(place, s.weights[3], s.weights) > 0) & (places < 3)

        def arranged(old: Any, new: Any) -> Any:
            if old.ndim == 3:
                return jnp.where(kept[:, None], jnp.where(place[:, None], old[3:], old), new)
            return jnp.where(kept, jnp.where(place, old[3:], old), new)

        differences = settled(arranged(s.differences, difference))
        weights, nearest, inside = nearest_on_simplex(differences)
        weights, nearest = settled((weights, nearest))
        squared = jnp.where(inside, 0.0, dot(nearest, nearest))
        stop = (
            s.done
            | converged
            | (squared > s.squared * (1.0 + slack))
            | ((slack <= 0) & (squared >= s.squared))
        )

        def unless(old: Any, new: Any) -> Any:
            return jnp.where(stop, old, new)

        return Simplex(
            unless(s.differences, differences),
            unless(s.points_a, arranged(s.points_a, point_a)) if remember else None,
            unless(s.numbers, arranged(s.numbers, number)),
            unless(s.weights, weights),
            unless(s.nearest, nearest),
            unless(s.squared, squared),
            lower,
            s.overlapping | (inside & ~stop),
            stop | inside,
            s.turns + 1,
        )

    found = lax.while_loop(lambda s: (s.turns < turns) & ~jnp.all(s.done), turn, start)
    return found._replace(overlapping=found.overlapping | (found.squared <= (4 * eps * scale) ** 2))


def _first_free(weights: Any) -> Any:
    """The first place (L,) without weight; the last is free whenever no other is."""
    return jnp.where(weights[0] <= 0, 0, jnp.where(weights[1] <= 0, 1, jnp.where(weights[2] <= 0, 2, 3)))
