"""The search itself, for a batch of pairs of one kind: GJK for all, then exact depth for those that overlap.

One pair is a batch of one. `jax.vmap` makes a batch of it by a rule of its own: all axes that are mapped over become
one, which is cut into chunks that leave their loops early. Derivatives do not pass through here (`features.py`).
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

from jaxrb.collision.lanes import LANES
from jaxrb.collision.stages import Found, pair_of
from jaxrb.collision.stages import searched as stage_of
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array


def search(shape_a: Shape, shape_b: Shape, rotation: Array, translation: Array, swap: Any = False) -> Found:
    """Distance of the cores of one pair; `rotation` (3, 3) and `translation` (3,) place b in the frame of a.

    `swap` (): the faces and edges of a are in b and those of b in a, as they are where a pair was put into order.
    """
    pair = (shape_a, shape_b, rotation, translation, jnp.asarray(swap))
    leaves, structure = jax.tree.flatten(lax.stop_gradient(pair))
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
    dtype = leaves[-2].dtype
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
            before = jax.tree.map(lambda x: x[index], found)
            after = stage_of(pair_of(structure, leaves, index), before, second > 0)
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
