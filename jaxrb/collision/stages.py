"""The search for one chunk of pairs: GJK, and where the shapes overlap the least depth and GJK once more."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.collision import cores
from jaxrb.collision.arcs import depth_by_arcs
from jaxrb.collision.gjk import Simplex, Support, gjk
from jaxrb.collision.lanes import cross, first_of, unit
from jaxrb.collision.newton import Ruling, along_rulings, best_of_many, newton
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array
from jaxrb.math.settled import settled
from jaxrb.math.vector import dot_of as dot

# Ways out of a smooth body that are followed to their end, those that begin within this share of the best. Of hulls
# deep inside cylinders one way is too deep in one pair of fifty, by up to 0.5 %; three in one of two hundred, by 0.02.
_WAYS, _RIVAL = 3, 1.25


class Found(NamedTuple):
    """The answer for the cores of pairs, in the frame of a; a leading axis of pairs.

    `weights` (3,) and `numbers` (3, 2) name up to three vertices of each polytope whose weighted sums are the witness
    points; `points` (2, 3, 3) are these vertices, also of smooth shapes.
    """

    distance: Array
    normal: Array
    lower: Array
    upper: Array
    weights: Array
    numbers: Array
    points: Array
    uncertain: Array


class Pair(NamedTuple):
    """A chunk of pairs, placed in the frame of a. Of `shapes` the whole numbers are still those of all pairs, and where
    `swap` each other's."""

    shapes: tuple[Shape, Shape]
    index: Array
    swap: Array
    rotation: Array
    points: tuple[Any, Any]
    supports: tuple[Support, Support]
    scale: Any
    towards: Any


def _cut(leaf: Array, index: Array) -> Array:
    """The rows of some pairs; a leading axis of 1 is shared by all."""
    return leaf if leaf.shape[0] == 1 else leaf[index]


def pair_of(structure: Any, leaves: Any, index: Array) -> Pair:
    """The pairs number `index` (L,) of all. Faces and edges, of most pairs never looked at, are left where they are."""
    lanes = index.shape[0]
    cut = [_cut(leaf, index) if _is_number(leaf) else leaf for leaf in leaves]
    shape_a, shape_b, rotation, translation, swap = jax.tree.unflatten(structure, cut)
    frames = ((shape_a, None, None), (shape_b, rotation, translation))
    points = [cores.placed(cores.corners(shape), r, t) for shape, r, t in frames]
    a, b = settled(tuple([jnp.broadcast_to(x, (*x.shape[:2], lanes)) for x in points]))
    supports = [
        cores.polytope_support(x) if cores.is_polytope(shape) else cores.smooth_support(shape, r, t)
        for x, (shape, r, t) in zip((a, b), frames)
    ]
    scale = jnp.maximum(jnp.abs(a).max(axis=(0, 1)), jnp.abs(b).max(axis=(0, 1)))
    towards = b.mean(axis=0) - a.mean(axis=0)
    up = jnp.zeros_like(towards).at[2].set(1.0)
    towards = jnp.where(dot(towards, towards) > 0, towards, up)
    scale, towards = settled((scale, towards))
    return Pair((shape_a, shape_b), index, swap, rotation, (a, b), (supports[0], supports[1]), scale, towards)


def searched(pair: Pair, before: Found, second: Any) -> Found:
    """GJK; in the second stage after moving b out of a along the direction of least depth.

    Moved apart along the normal by a good length, b is nearest to a at the points that are the witnesses of the depth,
    and the direction between them is known as well as that of any two distant shapes.
    """
    eps = jnp.finfo(pair.scale.dtype).eps
    polytopes = all(cores.is_polytope(shape) for shape in pair.shapes)
    margin = 32 * eps * pair.scale
    nothing = jnp.zeros_like(pair.scale)
    slack = jnp.where(second, 8 * eps, 0.0).astype(pair.scale.dtype)
    ways = 1 if polytopes else _WAYS
    first = (jnp.stack([pair.towards] * ways), jnp.stack([nothing] * ways), nothing)
    normals, depths, least = settled(lax.cond(second, lambda: _least_depth(pair, before), lambda: first))

    def apart(normal: Any, depth: Any) -> tuple[Simplex, Any, Any, Any]:
        """GJK, and the better of the direction known before and the one it finds."""
        shift = jnp.where(second, (depth + 0.5 * pair.scale) * normal, 0.0)

        def moved(direction: Any) -> tuple[Any, Any]:
            point, number = pair.supports[1](direction)
            return point + shift, number

        simplex = gjk(
            pair.supports[0], moved, normal, pair.scale, 32 if polytopes else 64, not polytopes, slack
        )
        direction = settled(_direction(simplex))
        reach = lax.cond(second, lambda: _overlap(pair, direction), lambda: -simplex.lower)
        better = ~second | (reach < depth - 2 * eps * pair.scale)
        return simplex, shift, jnp.where(better, direction, normal), jnp.where(better, reach, depth)

    if polytopes:
        simplex, shift, normal, depth = apart(normals[0], depths[0])
    else:
        simplex, shift, normal, depth = _best_way(pair, apart, normals, depths, second)
    gap = simplex.nearest + shift
    gap = jnp.sqrt(dot(gap, gap))
    distance = jnp.where(second, -depth, gap)
    upper = jnp.where(second & (depth >= 0), -jnp.clip(jnp.minimum(least, depth), 0.0), gap) + margin
    # The direction of a difference of points is known to round-off over its length: near contact take another way.
    uncertain = ~second & (simplex.overlapping | (gap < eps**0.55 * pair.scale))
    if polytopes:
        uncertain = uncertain | (~second & (gap - simplex.lower > 32 * eps * pair.scale))
    if not polytopes:
        simplex = _at_supports(pair, simplex, normal, distance, shift)
        distance = jnp.where(second | uncertain, distance, -depth)
        held = _held(simplex) + shift
        upper = jnp.where(second, upper, jnp.sqrt(dot(held, held)) + margin)
    return _found(pair, simplex, distance, normal, -depth - margin, upper, uncertain, shift)


def _best_way(pair: Pair, apart: Any, normals: Any, depths: Any, second: Any) -> Any:
    """`_smooth_rounds` from several ways out (w, 3, L), and the least deep of their ends. Which of two minima is lower,
    neither the inscribed polytopes know nor Newton's method where it meets a kink.
    """

    def one(carry: Any) -> Any:
        k, *best = carry
        found = _smooth_rounds(pair, apart, normals[k], depths[k], second)
        better = (k == 0) | (found[-1] < best[-1])
        chosen = jax.tree.map(lambda new, old: jnp.where(better, new, old) if new.ndim else new, found, best)
        return k + 1, *chosen

    shapes = jax.eval_shape(lambda: _smooth_rounds(pair, apart, normals[0], depths[0], second))
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)

    def going(carry: Any) -> Any:
        k, best = carry[0], carry[-1]
        return (k == 0) | (second & (k < _WAYS) & jnp.any(depths[jnp.minimum(k, _WAYS - 1)] < _RIVAL * best))

    _, *found = lax.while_loop(going, one, (jnp.zeros((), jnp.int32), *nothing))
    return found


def _smooth_rounds(pair: Pair, apart: Any, normal: Any, depth: Any, second: Any) -> Any:
    """GJK and Newton's method in turns: the first finds kinks in few steps, the second minima between them."""
    settled_at = 64 * jnp.finfo(depth.dtype).eps

    def once(carry: Any) -> Any:
        k, _, *_, before, depth = carry
        simplex, shift, normal, _ = apart(before, depth)
        value = _overlap(pair, normal)
        normal, depth = newton(pair.supports, normal, value, pair.scale, 6)
        normal, depth = along_rulings(pair.supports, normal, depth, pair.scale, _rulings(pair, simplex), 4)
        change = normal - before
        return k + 1, jnp.any(dot(change, change) > settled_at**2), simplex, shift, normal, depth

    shapes = jax.eval_shape(apart, normal, depth)
    simplex, shift, *_ = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    rounds = jnp.where(second, 16, 1)
    first = (jnp.zeros((), jnp.int32), jnp.ones((), bool), simplex, shift, normal, depth)
    _, _, *found = lax.while_loop(lambda carry: (carry[0] < rounds) & carry[1], once, first)
    return found


def _rulings(pair: Pair, simplex: Simplex) -> list[Ruling]:
    """Those of both bodies, by normals from a to b."""
    found = []
    for k, shape in enumerate(pair.shapes):
        if cores.is_polytope(shape):
            points = simplex.points_a if k == 0 else simplex.points_a - simplex.differences
            found.append(Ruling(unit(_edge(simplex, points)), jnp.zeros_like(pair.scale)))
        elif (cosine := cores.cosine_of_ruling(shape)) is not None:
            axis = jnp.zeros_like(pair.towards).at[2].set(1.0)
            if k == 1:
                axis, cosine = jnp.moveaxis(pair.rotation[..., 2], 0, -1) + 0.0 * axis, -cosine
            found.append(Ruling(axis, jnp.broadcast_to(cosine, pair.scale.shape).astype(pair.scale.dtype)))
    return found


def _edge(simplex: Simplex, points: Any) -> Any:
    """The longest side (3, L) between those corners of a polytope that touch; zero where only one does."""
    edge = jnp.zeros_like(points[0])
    for i, j in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
        side = points[i] - points[j]
        active = (simplex.weights[i] > 0) & (simplex.weights[j] > 0)
        edge = jnp.where(active & (dot(side, side) > dot(edge, edge)), side, edge)
    return edge


def _at_supports(pair: Pair, simplex: Simplex, normal: Any, distance: Any, shift: Any) -> Simplex:
    """With the support points along the normal as witnesses, where these face each other better than the simplex."""
    a, number_a = pair.supports[0](normal)
    b, number_b = pair.supports[1](-normal)
    facing = a - b + distance * normal
    before = _held(simplex) + shift + distance * normal
    use = dot(facing, facing) <= dot(before, before)
    only = jnp.zeros_like(simplex.weights).at[0].set(1.0)
    return simplex._replace(
        weights=jnp.where(use, only, simplex.weights),
        differences=jnp.where(use, a - b - shift, simplex.differences),
        points_a=jnp.where(use, a, simplex.points_a),
        numbers=jnp.where(use, number_a * 65536 + number_b, simplex.numbers),
    )


def _held(simplex: Simplex) -> Any:
    """The difference of the witnesses, which are on the bodies: a sliver's nearest point is all round-off."""
    weights, differences = _three(simplex, simplex.weights, simplex.differences)
    return jnp.sum(weights[:, None] * differences, axis=0) / weights.sum(axis=0)


def _with_topology(pair: Pair) -> tuple[Shape, Shape]:
    """The shapes of the chunk with their own faces and edges."""
    one, other = pair.shapes
    if type(one) is not type(other):
        return jax.tree.map(lambda x: x if _is_number(x) else _cut(x, pair.index), pair.shapes)
    swap = _cut(pair.swap, pair.index)

    def own(x: Array, y: Array) -> Array:
        if _is_number(x):
            return x
        x, y = _cut(x, pair.index), _cut(y, pair.index)
        # Of other sizes they were not exchanged: only what is alike in form is put into order by its numbers.
        return jnp.where(swap.reshape(-1, *(1,) * (x.ndim - 1)), y, x) if x.shape[1:] == y.shape[1:] else x

    return jax.tree.map(own, one, other), jax.tree.map(own, other, one)


def _is_number(leaf: Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jnp.inexact)


def _least_depth(pair: Pair, before: Found) -> tuple[Any, Any, Any]:
    """Ways out (w, 3, L), the depths there (w, L), the least first, and a lower bound of the depth."""
    shapes = _with_topology(pair)
    fans = [
        cores.normal_fan(shape, points, r)
        for shape, points, r in zip(shapes, pair.points, (None, pair.rotation))
    ]
    # Arcs of the simpler body are cut at those of the other.
    swap = fans[1].ends.shape[0] < fans[0].ends.shape[0]
    cut, other = (fans[1], fans[0]) if swap else (fans[0], fans[1])
    depth = depth_by_arcs(cut, other, pair.scale)
    normal = -depth.normal if swap else depth.normal
    first = jnp.moveaxis(before.normal, 0, -1)
    value, other = _overlap(pair, normal), _overlap(pair, first)
    use = (other < value) & (dot(first, first) > 0.5)
    normal, value = jnp.where(use, first, normal), jnp.where(use, other, value)
    if all(cores.is_polytope(shape) for shape in pair.shapes):
        normal, value = normal[None], value[None]
    else:
        # The inscribed polytopes may put two ways out in the wrong order.
        even = jnp.asarray(cores.directions(), value.dtype)[:, :, None]
        # Minima of flat shapes are close together, where the normals of their faces are.
        own = [sign * fan.normals for fan, sign in zip(fans, (1.0, -1.0))]
        directions = jnp.concatenate([jnp.broadcast_to(even, (*even.shape[:2], *value.shape)), *own])
        known = jnp.stack([normal, -normal])
        normal, value = best_of_many(pair.supports, directions, known, pair.scale, _WAYS)
    return normal, value, depth.lower


def _direction(simplex: Simplex) -> Any:
    """Unit vector (3, L) from a to b: across the plane, line or point that holds the nearest difference.

    Formed from the edges of that feature, which are long, where the nearest difference itself may be all round-off.
    """
    v = simplex.nearest
    weights, differences = _three(simplex, simplex.weights, simplex.differences)
    active = weights > 0
    count = active.sum(axis=0)
    # From the nearest point, which lies on the feature, to its corners.
    edges = jnp.where(active[:, None], differences - v, 0.0)
    around = cross(edges[0], edges[1]) + cross(edges[1], edges[2]) + cross(edges[2], edges[0])
    longest = edges[0]
    for other in edges[1:]:
        longest = jnp.where(dot(other, other) > dot(longest, longest), other, longest)
    squared = dot(longest, longest)
    across = v
    for _ in range(2):
        across = across - longest * (dot(across, longest) / jnp.where(squared > 0, squared, 1.0))
    vector = jnp.where(count > 2, around * jnp.where(dot(around, v) < 0, -1.0, 1.0), across)
    return -unit(vector)


def _three(simplex: Simplex, *tables: Any) -> list[Any]:
    """Of tables (4, ..., L) the rows of the three corners with the largest weights; the fourth has none."""
    places = lax.broadcasted_iota(jnp.int32, simplex.weights.shape, 0)
    # The last corner takes the place of the one left out.
    gone = (places == first_of(simplex.weights <= simplex.weights.min(axis=0)))[:3]
    return [jnp.where(gone if x.ndim == 2 else gone[:, None], x[3:], x[:3]) for x in tables]


def _overlap(pair: Pair, normal: Any) -> Any:
    """How far (L,) b must move along `normal` to leave a: negative where this direction separates them."""
    a, _ = pair.supports[0](normal)
    b, _ = pair.supports[1](-normal)
    return dot(normal, a) - dot(normal, b)


def _found(
    pair: Pair,
    simplex: Simplex,
    distance: Any,
    normal: Any,
    lower: Any,
    upper: Any,
    uncertain: Any,
    shift: Any,
) -> Found:
    """The three corners of the simplex that matter, and everything with pairs first again."""
    weights, numbers = _three(simplex, simplex.weights, simplex.numbers)
    if simplex.points_a is None:
        points = jnp.zeros((2, 3, 3, *pair.scale.shape), pair.scale.dtype)
    else:
        points_a, differences = _three(simplex, simplex.points_a, simplex.differences)
        points = jnp.stack([points_a, points_a - differences - shift])
    rows = (weights / weights.sum(axis=0), jnp.stack([numbers // 65536, numbers % 65536], axis=1), points)
    weights, numbers, points = (jnp.moveaxis(x, -1, 0) for x in rows)
    return Found(distance, jnp.moveaxis(normal, -1, 0), lower, upper, weights, numbers, points, uncertain)
