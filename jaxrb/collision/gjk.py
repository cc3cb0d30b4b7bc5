"""Distance of two convex sets known by their support maps (Gilbert, Johnson, Keerthi 1988).

GJK looks for the point v nearest to the origin in the set of differences A − B. It keeps up to four differences of
support points and in each turn adds the one farthest along −v, then throws away those that the nearest point of the
simplex does without. v·w / |v| for the added difference w bounds the distance from below, |v| from above.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxrb.collision.lanes import cross, dot

# (3, L) directions to support points (3, L) and their numbers (L,).
Support = Callable[[Any], tuple[Any, Any]]


class Simplex(NamedTuple):
    """What GJK ends with, for L pairs.

    `nearest` (3, L) is the difference of smallest length, Σ weights · (points_a − points_b); `overlapping` says that the
    simplex holds the origin. `lower` (L,) bounds the distance from below. `numbers` (4, L) are those of the vertices of
    a times 65536 plus those of b.
    """

    points_a: Any
    points_b: Any
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

    Only sub-simplices with the newest corner, the last, are tried: the others were in an earlier turn. Corners that are
    not in use are copies of the newest, which makes every sub-simplex with them degenerate, and those are passed over.
    Each candidate is compared by its distance, so no case distinction can contradict itself through round-off.
    """
    a, b, c, d = corners
    zero = jnp.zeros_like(a[0])
    one = jnp.ones_like(zero)
    tiny = jnp.finfo(zero.dtype).tiny
    best = dot(d, d)
    weights = (zero, zero, zero, one)

    def better(candidate: Any, valid: Any, *proposed: Any) -> None:
        nonlocal best, weights
        take = valid & (candidate < best)
        best = jnp.where(take, candidate, best)
        weights = tuple(jnp.where(take, p, w) for p, w in zip(proposed, weights))

    for i, corner in enumerate((a, b, c)):
        side = corner - d
        squared = dot(side, side)
        t = -dot(d, side) / jnp.where(squared > 0, squared, 1.0)
        point = d + t * side
        proposed = [zero, zero, zero, 1.0 - t]
        proposed[i] = t
        better(dot(point, point), (t > 0) & (t < 1) & (squared > 0), *proposed)
    for i, j, first, second in ((0, 1, a, b), (0, 2, a, c), (1, 2, b, c)):
        normal = cross(first - d, second - d)
        squared = dot(normal, normal)
        safe = jnp.where(squared > 0, squared, 1.0)
        u = dot(cross(second, d), normal) / safe
        v = dot(cross(d, first), normal) / safe
        w = 1.0 - u - v
        height = dot(d, normal)
        proposed = [zero, zero, zero, w]
        proposed[i], proposed[j] = u, v
        better(height * height / safe, (u > 0) & (v > 0) & (w > 0) & (squared > tiny), *proposed)
    volumes = [dot(b, cross(c, d)), -dot(a, cross(c, d)), dot(a, cross(b, d))]
    whole = dot(d - a, cross(b - d, c - d))
    safe = jnp.where(whole != 0, whole, 1.0)
    shares = [x / safe for x in volumes]
    shares.append(1.0 - shares[0] - shares[1] - shares[2])
    inside = (shares[0] > 0) & (shares[1] > 0) & (shares[2] > 0) & (shares[3] > 0) & (jnp.abs(whole) > tiny)
    better(-one, inside, *shares)
    weights = jnp.stack(weights)
    return weights, (weights[:, None] * corners).sum(axis=0), inside


def gjk(support_a: Support, support_b: Support, towards: Any, scale: Any, turns: int) -> Simplex:
    """GJK for L pairs, until every one is done or `turns` are over.

    Args:
        towards: (3, L), a first guess of the direction from a to b, not zero.
        scale: (L,), the largest coordinate that appears; distances are found to a few round-offs of it.
    """
    eps = jnp.finfo(towards.dtype).eps
    point_a, number_a = support_a(towards)
    point_b, number_b = support_b(-towards)
    difference = point_a - point_b
    zeros = jnp.zeros_like(scale)
    false = jnp.zeros(scale.shape, bool)
    start = Simplex(
        points_a=jnp.stack([point_a] * 4),
        points_b=jnp.stack([point_b] * 4),
        numbers=jnp.stack([number_a * 65536 + number_b] * 4),
        weights=jnp.stack([jnp.ones_like(scale), zeros, zeros, zeros]),
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
        difference = point_a - point_b
        reach = dot(s.nearest, difference)
        length = jnp.sqrt(jnp.where(s.squared > 0, s.squared, 1.0))
        lower = jnp.maximum(s.lower, jnp.where(s.done | (s.squared <= 0), -jnp.inf, reach / length))
        number = number_a * 65536 + number_b
        converged = (s.squared - reach <= 4 * eps * length * scale) | (s.squared <= (4 * eps * scale) ** 2)
        # The newest corner goes last; a corner in use there moves to the first place that is free.
        free = _first_free(s.weights)
        place = lax.broadcasted_iota(jnp.int32, s.weights.shape, 0) == free
        kept = jnp.where(place, s.weights[3], s.weights) > 0

        def arranged(old: Any, new: Any) -> Any:
            wide = (slice(None), None) if old.ndim == 3 else slice(None)
            moved = jnp.where(place[wide], old[3:], old)
            return jnp.where(kept[wide], moved, new[None]).at[3].set(new)

        points_a = arranged(s.points_a, point_a)
        points_b = arranged(s.points_b, point_b)
        numbers = arranged(s.numbers, number)
        weights, nearest, inside = nearest_on_simplex(points_a - points_b)
        squared = jnp.where(inside, 0.0, dot(nearest, nearest))
        stop = s.done | converged | (squared >= s.squared)

        def unless(old: Any, new: Any) -> Any:
            return jnp.where(stop, old, new)

        return Simplex(
            unless(s.points_a, points_a),
            unless(s.points_b, points_b),
            unless(s.numbers, numbers),
            unless(s.weights, weights),
            unless(s.nearest, nearest),
            unless(s.squared, squared),
            lower,
            s.overlapping | (inside & ~stop),
            stop | inside,
            s.turns + 1,
        )

    found = lax.while_loop(lambda s: (s.turns < turns) & ~jnp.all(s.done), turn, start)
    near = found.squared <= (4 * eps * scale) ** 2
    return found._replace(overlapping=found.overlapping | near)


def _first_free(weights: Any) -> Any:
    """The first place (L,) without weight; the last is free whenever no other is."""
    return jnp.where(weights[0] <= 0, 0, jnp.where(weights[1] <= 0, 1, jnp.where(weights[2] <= 0, 2, 3)))
