"""The search itself, for a batch of pairs of one kind: GJK for all, then exact depth for those that overlap.

One pair is a batch of one. `jax.vmap` makes a batch of it by a rule of its own: all axes that are mapped over become
one, which is cut into chunks that leave their loops early. Derivatives do not pass through here (`features.py`).
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

from jaxrb.collision import cores
from jaxrb.collision.arcs import depth_by_arcs
from jaxrb.collision.gjk import Simplex, Support, gjk
from jaxrb.collision.lanes import LANES, cross, dot, first_of, settled, unit
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array


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


def search(shape_a: Shape, shape_b: Shape, rotation: Array, translation: Array) -> Found:
    """Distance of the cores of one pair; `rotation` (3, 3) and `translation` (3,) place b in the frame of a."""
    leaves, structure = jax.tree.flatten((shape_a, shape_b, rotation, translation))
    batch = _searched_by(structure)(*(jnp.asarray(leaf)[None] for leaf in leaves))
    return jax.tree.map(lambda x: x[0], batch)


@functools.cache
def _searched_by(structure: Any) -> Any:
    """The search for leaves with a leading axis of pairs, which is 1 for what all pairs share."""

    @custom_vmap
    def searched(*leaves: Array) -> Found:
        return _in_chunks(structure, leaves)

    @searched.def_vmap
    def rule(size: int, mapped: Any, *leaves: Array) -> Any:
        pairs = max(leaf.shape[1] if one else leaf.shape[0] for leaf, one in zip(leaves, mapped))

        def merged(leaf: Array, one: bool) -> Array:
            if not one and leaf.shape[0] == 1:
                return leaf
            if not one:
                leaf = jnp.broadcast_to(leaf[None], (size, *leaf.shape))
            if leaf.shape[1] != pairs:
                leaf = jnp.broadcast_to(leaf, (size, pairs, *leaf.shape[2:]))
            return leaf.reshape(size * pairs, *leaf.shape[2:])

        found = searched(*(merged(leaf, one) for leaf, one in zip(leaves, mapped)))
        # Where everything is shared the pairs are one pair.
        found = jax.tree.map(lambda x: x.reshape(size, pairs, *x.shape[1:]), found)
        return found, jax.tree.map(lambda _: True, found)

    return searched


def _in_chunks(structure: Any, leaves: Any) -> Found:
    pairs = max(leaf.shape[0] for leaf in leaves)
    lanes = min(LANES, pairs)
    chunks = -(-pairs // lanes)
    padded = chunks * lanes

    def filled(leaf: Array) -> Array:
        if leaf.shape[0] == 1 or padded == pairs:
            return leaf
        return jnp.concatenate([leaf, jnp.broadcast_to(leaf[-1:], (padded - pairs, *leaf.shape[1:]))])

    leaves = [filled(leaf) for leaf in leaves]
    dtype = leaves[-1].dtype
    found = Found(
        distance=jnp.zeros(padded, dtype),
        normal=jnp.zeros((padded, 3), dtype),
        lower=jnp.zeros(padded, dtype),
        upper=jnp.zeros(padded, dtype),
        weights=jnp.zeros((padded, 3), dtype),
        numbers=jnp.zeros((padded, 3, 2), jnp.int32),
        points=jnp.zeros((padded, 2, 3, 3), dtype),
        uncertain=jnp.zeros(padded, bool),
    )

    def stage(second: Any, state: Any) -> Any:
        """All pairs first, then once more those that are not certain: one program, compiled once."""
        order, count, found = state

        def more(carry: Any) -> Any:
            return carry[0] * lanes < count

        def chunk(carry: Any) -> Any:
            k, found = carry
            index = lax.dynamic_slice_in_dim(order, k * lanes, lanes)
            cut = [x if x.shape[0] == 1 else x[index] for x in leaves]
            before = jax.tree.map(lambda x: x[index], found)
            after = _searched(_pair(structure, cut, lanes), before, second > 0)
            wanted = k * lanes + jnp.arange(lanes) < count

            def put(old: Array, new: Array, whole: Array) -> Array:
                chosen = jnp.where(wanted.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
                return whole.at[index].set(chosen, unique_indices=True)

            return k + 1, jax.tree.map(put, before, after, found)

        _, found = lax.while_loop(more, chunk, (jnp.zeros((), jnp.int32), found))
        order = jnp.argsort(~found.uncertain, stable=True).astype(jnp.int32)
        return order, jnp.sum(found.uncertain, dtype=jnp.int32), found

    start = (jnp.arange(padded, dtype=jnp.int32), jnp.asarray(padded, jnp.int32), found)
    *_, found = lax.fori_loop(0, 2, stage, start)
    return jax.tree.map(lambda x: x[:pairs], found)


class _Pair(NamedTuple):
    """A chunk of pairs, placed in the frame of a."""

    shapes: tuple[Shape, Shape]
    rotation: Array
    points: tuple[Any, Any]
    supports: tuple[Support, Support]
    scale: Any
    towards: Any


def _pair(structure: Any, leaves: Any, lanes: int) -> _Pair:
    shape_a, shape_b, rotation, translation = jax.tree.unflatten(structure, leaves)
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
    return _Pair((shape_a, shape_b), rotation, (a, b), (supports[0], supports[1]), scale, towards)


def _searched(pair: _Pair, before: Found, second: Any) -> Found:
    """GJK; in the second stage after moving b out of a along the direction of least depth.

    Moved apart along the normal by a good length, b is nearest to a at the points that are the witnesses of the depth,
    and the direction between them is known as well as that of any two distant shapes.
    """
    eps = jnp.finfo(pair.scale.dtype).eps
    polytopes = all(cores.is_polytope(shape) for shape in pair.shapes)
    margin = 32 * eps * pair.scale
    nothing = jnp.zeros_like(pair.scale)
    normal, depth, least = settled(
        lax.cond(second, lambda: _least_depth(pair, before), lambda: (pair.towards, nothing, nothing))
    )
    shift = jnp.where(second, (depth + 0.5 * pair.scale) * normal, 0.0)

    def moved(direction: Any) -> tuple[Any, Any]:
        point, number = pair.supports[1](direction)
        return point + shift, number

    simplex = gjk(pair.supports[0], moved, normal, pair.scale, 32 if polytopes else 96, not polytopes)
    direction = settled(_direction(simplex))
    reach = lax.cond(second, lambda: _overlap(pair, direction), lambda: -simplex.lower)
    better = ~second | (reach < depth - 2 * eps * pair.scale)
    normal = jnp.where(better, direction, normal)
    depth = jnp.where(better, reach, depth)
    gap = simplex.nearest + shift
    gap = jnp.sqrt(dot(gap, gap))
    distance = jnp.where(second, -depth, gap)
    upper = jnp.where(second & (depth >= 0), -jnp.clip(jnp.minimum(least, depth), 0.0), gap) + margin
    # The direction of a difference of points is known to round-off over its length: near contact take another way.
    uncertain = ~second & (simplex.overlapping | (gap < eps**0.55 * pair.scale))
    if polytopes:
        uncertain = uncertain | (~second & (gap - simplex.lower > 32 * eps * pair.scale))
    return _found(pair, simplex, distance, normal, -depth - margin, upper, uncertain, shift)


def _least_depth(pair: _Pair, before: Found) -> tuple[Any, Any, Any]:
    """The direction of least depth, the depth there, and a lower bound of the depth."""
    fans = [
        cores.normal_fan(shape, points, r)
        for shape, points, r in zip(pair.shapes, pair.points, (None, pair.rotation))
    ]
    # Arcs of the simpler body are cut at those of the other.
    swap = fans[1].ends.shape[0] < fans[0].ends.shape[0]
    depth = depth_by_arcs(*(fans[::-1] if swap else fans), pair.scale)
    normal = -depth.normal if swap else depth.normal
    first = jnp.moveaxis(before.normal, 0, -1)
    value, other = _overlap(pair, normal), _overlap(pair, first)
    use = (other < value) & (dot(first, first) > 0.5)
    return jnp.where(use, first, normal), jnp.where(use, other, value), depth.lower


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


def _overlap(pair: _Pair, normal: Any) -> Any:
    """How far (L,) b must move along `normal` to leave a: negative where this direction separates them."""
    a, _ = pair.supports[0](normal)
    b, _ = pair.supports[1](-normal)
    return dot(normal, a) - dot(normal, b)


def _found(
    pair: _Pair,
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
