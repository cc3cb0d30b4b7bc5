"""Pairs of boxes that overlap, by a uniform grid: for many bodies of like size, at linear cost.

Bodies are sorted by the cell of their centre, cells as wide as the largest box, in rows along x. The neighbours of a
body then lie in five short stretches of that order: its own row from itself on, and the four rows that come after it
(each pair is so met once). Where sizes differ so much that cells hold many, the answer says so and is not to be used.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxrb.math.arrays import Array, components
from jaxrb.math.compaction import first_true

# Places in the stretches of all bodies, a body: touching balls of one size have six to fourteen, at their densest 25.
_LOOKED = 28
# Cells along an axis: three such numbers, each with a rim of one, are a key in 31 bits.
_CELLS = 1000
_ROWS = ((0, 1), (1, -1), (1, 0), (1, 1))  # (z, y) of the rows that come after a body's own


class GridPairs(NamedTuple):
    """Pairs (capacity,) of bodies, −1 beyond `count`; `total` there were, `tests` of pairs made.

    `crowded`: the stretches were too long and pairs are missing, whatever the capacity.
    """

    first: Array
    second: Array
    count: Array
    total: Array
    tests: Array
    crowded: Array


def grid_pairs(
    low: Array, high: Array, capacity: int, keep: Callable[[Array, Array], Array] | None = None
) -> GridPairs:
    """Pairs of finite boxes low (n, 3), high (n, 3) [m] that overlap, each once; of these those that `keep` lets pass.

    `keep(first, second)` is given numbers of bodies in arrays of any shape, with pairs among them that do not overlap.
    """
    count, most = len(low), _LOOKED * len(low)
    order, start, length = _stretches(low, high)
    # All places of all stretches one after the other: who is looked at as the t-th.
    end = jnp.cumsum(length, dtype=jnp.int32)
    begin = end - length
    stretch = jnp.cumsum(jnp.zeros(most, jnp.int32).at[begin].add(1, mode="drop"), dtype=jnp.int32) - 1
    turn = jnp.arange(most, dtype=jnp.int32)
    valid = turn < end[-1]
    here = stretch % count
    at = jnp.where(valid, start[stretch] + turn - begin[stretch], here)
    meets = valid
    for one, other in zip(components(low[order]), components(high[order]), strict=True):
        meets &= (one[here] <= other[at]) & (one[at] <= other[here])
    if keep is not None:
        meets &= keep(order[here], order[at])
    number, total = first_true(meets, capacity)
    row = jnp.maximum(number, 0)
    first, second = order[here[row]], order[at[row]]
    some = number >= 0
    first, second = (
        jnp.where(some, side, -1) for side in (jnp.minimum(first, second), jnp.maximum(first, second))
    )
    return GridPairs(first, second, jnp.minimum(total, capacity), total, end[-1], end[-1] > most)


def _stretches(low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Bodies (n,) in the order of their cells; of the five stretches of each (5n,), start and length."""
    center = 0.5 * (low + high)
    least = jnp.min(center, axis=0)
    size = jnp.maximum(jnp.max(high - low), jnp.max(center - least) / _CELLS)
    # A little wider, so that round-off of the division loses no neighbour.
    cell = jnp.floor((center - least) / (1.0001 * jnp.where(size > 0, size, 1.0))).astype(jnp.int32) + 1
    across = np.int32(_CELLS + 3)
    x, y, z = components(cell)
    key = (z * across + y) * across + x
    order = jnp.argsort(key).astype(jnp.int32)
    key = key[order]
    middle = key + jnp.asarray([(dz * across + dy) * across for dz, dy in _ROWS], jnp.int32)[:, None]
    bounds = jnp.concatenate([key + 2, (middle - 1).ravel(), (middle + 2).ravel()])
    place = jnp.searchsorted(key, bounds).astype(jnp.int32)
    count = len(key)
    start = jnp.concatenate([jnp.arange(1, count + 1, dtype=jnp.int32), place[count : 5 * count]])
    end = jnp.concatenate([place[:count], place[5 * count :]])
    return order, start, jnp.maximum(end - start, 0)
