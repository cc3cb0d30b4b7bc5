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
from jaxrb.collision.lanes import LANES, dot, settled, unit
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

    def chunk(start: Any) -> Any:
        cut = [x if x.shape[0] == 1 else lax.dynamic_slice_in_dim(x, start, lanes) for x in leaves]
        return _apart(_pair(structure, cut, lanes))

    found, uncertain = lax.map(chunk, jnp.arange(chunks) * lanes)
    found, uncertain = jax.tree.map(lambda x: x.reshape(padded, *x.shape[2:]), (found, uncertain))
    order = jnp.argsort(~uncertain, stable=True)
    count = jnp.sum(uncertain)

    def more(carry: Any) -> Any:
        return carry[0] * lanes < count

    def refine(carry: Any) -> Any:
        k, found = carry
        index = lax.dynamic_slice_in_dim(order, k * lanes, lanes)
        cut = [x if x.shape[0] == 1 else x[index] for x in leaves]
        before = jax.tree.map(lambda x: x[index], found)
        after = _overlapping(_pair(structure, cut, lanes), before)
        wanted = uncertain[index]

        def put(old: Array, new: Array, whole: Array) -> Array:
            chosen = jnp.where(wanted.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
            return whole.at[index].set(chosen, unique_indices=True)

        return k + 1, jax.tree.map(put, before, after, found)

    _, found = lax.while_loop(more, refine, (jnp.zeros((), jnp.int32), found))
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
    a, b = settled([jnp.broadcast_to(x, (*x.shape[:2], lanes)) for x in points])
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


def _turns(pair: _Pair) -> int:
    return 32 if all(cores.is_polytope(shape) for shape in pair.shapes) else 96


def _apart(pair: _Pair) -> tuple[Found, Array]:
    """The answer where the cores are apart, and for which pairs it is not certain."""
    eps = jnp.finfo(pair.scale.dtype).eps
    simplex = gjk(*pair.supports, pair.towards, pair.scale, _turns(pair))
    distance = jnp.sqrt(jnp.where(simplex.squared > 0, simplex.squared, 0.0))
    normal = -simplex.nearest / jnp.where(distance > 0, distance, 1.0)
    margin = 8 * eps * pair.scale
    # The direction of a difference of points is known to round-off over its length: near contact take another way.
    uncertain = simplex.overlapping | (distance < eps**0.55 * pair.scale)
    uncertain = (
        uncertain | (distance - simplex.lower > 32 * eps * pair.scale) if _turns(pair) == 32 else uncertain
    )
    found = _found(distance, normal, simplex.lower - margin, distance + margin, simplex, 0.0)
    return found, uncertain


def _overlapping(pair: _Pair, before: Found) -> Found:
    """The answer where the cores overlap or touch."""
    eps = jnp.finfo(pair.scale.dtype).eps
    fans = [
        cores.normal_fan(shape, points, r)
        for shape, points, r in zip(pair.shapes, pair.points, (None, pair.rotation))
    ]
    # Arcs of the simpler body are cut at those of the other.
    swap = fans[1].ends.shape[0] < fans[0].ends.shape[0]
    first, second = (fans[1], fans[0]) if swap else (fans[0], fans[1])
    depth = depth_by_arcs(first, second, pair.scale)
    normal = -depth.normal if swap else depth.normal
    lengths = jnp.moveaxis(before.normal, 0, -1)
    other = _overlap(pair, lengths)
    value = _overlap(pair, normal)
    use = (other < value) & (dot(lengths, lengths) > 0.5)
    normal = jnp.where(use, lengths, normal)
    value = jnp.where(use, other, value)
    # Moved apart along the normal by a good length, b is nearest to a at points that were witnesses of the depth before.
    room = 0.5 * pair.scale
    shift = (value + room) * normal

    def moved(direction: Any) -> tuple[Any, Any]:
        point, number = pair.supports[1](direction)
        return point + shift, number

    simplex = gjk(pair.supports[0], moved, normal, pair.scale, _turns(pair))
    better = -unit(simplex.nearest)
    improved = _overlap(pair, better)
    use = improved < value - 2 * eps * pair.scale
    normal = jnp.where(use, better, normal)
    value = jnp.where(use, improved, value)
    margin = 8 * eps * pair.scale
    a = (simplex.weights[:, None] * simplex.points_a).sum(axis=0)
    b = (simplex.weights[:, None] * simplex.points_b).sum(axis=0) - shift
    gap = jnp.sqrt(dot(a - b, a - b))
    upper = jnp.where(value < 0, gap, -jnp.maximum(depth.lower, 0.0)) + margin
    return _found(-value, normal, -value - margin, upper, simplex, shift)


def _overlap(pair: _Pair, normal: Any) -> Any:
    """How far (L,) b must move along `normal` to leave a: negative where this direction separates them."""
    a, _ = pair.supports[0](normal)
    b, _ = pair.supports[1](-normal)
    return dot(normal, a) - dot(normal, b)


def _found(distance: Any, normal: Any, lower: Any, upper: Any, simplex: Simplex, shift: Any) -> Found:
    """Three corners of the simplex, those with the largest weights, and all with pairs first again."""
    least = jnp.argmin(simplex.weights, axis=0)
    places = lax.broadcasted_iota(jnp.int32, simplex.weights.shape, 0)
    # The last corner takes the place of the one left out.
    gone = (places == least)[:3]

    def three(x: Any) -> Any:
        return jnp.where(gone if x.ndim == 2 else gone[:, None], x[3:], x[:3])

    weights = three(simplex.weights)
    weights = weights / weights.sum(axis=0)
    numbers = three(simplex.numbers)
    points = jnp.stack([three(simplex.points_a), three(simplex.points_b) - shift])
    return Found(
        distance,
        jnp.moveaxis(normal, -1, 0),
        lower,
        upper,
        jnp.moveaxis(weights, -1, 0),
        jnp.moveaxis(jnp.stack([numbers // 65536, numbers % 65536], axis=1), -1, 0),
        jnp.moveaxis(points, -1, 0),
    )
