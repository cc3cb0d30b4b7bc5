"""The points of many pairs, most of which are not there: the cost is that of those that are."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

from jaxrb.collision.manifold import Manifold
from jaxrb.collision.touch import contact_points
from jaxrb.contact.platform import on_accelerator
from jaxrb.math.arrays import Array
from jaxrb.math.compaction import first_true

# Pairs looked at together: fewer waste no vector lanes on pairs that are not there, more pay less for each loop.
_TOGETHER = 32


# Traced once for all that ask here for the same kinds.
_points = jax.jit(jax.vmap(contact_points))


@jax.custom_jvp
def points_where(pairs: Any, there: Array) -> Manifold:
    """`contact_points` of the pairs (k, …) that are `there` (k,); of the others no point is valid.

    A derivative looks at all places, in one piece: a loop of unknown length cannot be run backwards.
    """
    return _in_turns(pairs, there)


@points_where.defjvp
def _rule(primals: Any, tangents: Any) -> Any:
    pairs, there = primals

    def all_of_them(pairs: Any) -> Manifold:
        return _only(_points(*pairs), there)

    return jax.jvp(all_of_them, (pairs,), (tangents[0],))


@custom_vmap
def _in_turns(pairs: Any, there: Array) -> Manifold:
    if on_accelerator() or len(there) <= _TOGETHER:
        return _only(_points(*pairs), there)
    rows = -(-len(there) // _TOGETHER)
    order, total = first_true(there, rows * _TOGETHER)
    order = order.reshape(rows, _TOGETHER)

    def of(at: Array) -> Manifold:
        return _points(*jax.tree.map(lambda leaf: leaf[jnp.maximum(at, 0)], pairs))

    def turn(carry: Any) -> Any:
        row, found = carry
        at = order[row]
        place = jnp.where(at >= 0, at, len(there))  # beyond the end: dropped
        return row + 1, jax.tree.map(lambda all_, new: all_.at[place].set(new, mode="drop"), found, of(at))

    nothing = jax.tree.map(
        lambda leaf: jnp.zeros((len(there), *leaf.shape[1:]), leaf.dtype), jax.eval_shape(of, order[0])
    )
    turns = -(-total // _TOGETHER)
    return lax.while_loop(lambda carry: carry[0] < turns, turn, (jnp.zeros((), jnp.int32), nothing))[1]


@_in_turns.def_vmap
def _worlds(size: int, batched: Any, pairs: Any, there: Array) -> tuple[Manifold, Any]:
    pairs, there = jax.tree.map(
        lambda leaf, has: leaf if has else jnp.broadcast_to(leaf, (size, *leaf.shape)),
        (pairs, there),
        tuple(batched),
    )
    count = there.shape[1]
    flat = jax.tree.map(lambda leaf: leaf.reshape(size * count, *leaf.shape[2:]), (pairs, there))
    found = jax.tree.map(lambda leaf: leaf.reshape(size, count, *leaf.shape[1:]), _in_turns(*flat))
    return found, jax.tree.map(lambda _: True, found)


def _only(points: Manifold, there: Array) -> Manifold:
    return points._replace(valid=points.valid & there[:, None])
