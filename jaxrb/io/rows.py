"""Arrays that grow by rows at their end."""

from typing import Any

import jax
import numpy as np


class Rows:
    """A tree of arrays whose leading axis grows. Room doubles, so that a row is copied about twice in all."""

    def __init__(self, first: Any):
        """`first`: the rows to begin with."""
        leaves, self._structure = jax.tree.flatten(first)
        self._leaves = [np.array(leaf) for leaf in leaves]  # own, to be written to

    @property
    def row_bytes(self) -> int:
        """Of a row."""
        return sum(leaf[0].nbytes for leaf in self._leaves)

    def put(self, at: int, more: Any, count: int) -> int:
        """Put the first `count` rows of `more` after the first `at`; how many there are now.

        Those before `at` are as they were at any moment, also where Ctrl-C comes in between.
        """
        end = at + count
        if end > len(self._leaves[0]):
            self._leaves = [_with_room(leaf, at, max(end, 2 * at)) for leaf in self._leaves]
        for leaf, new in zip(self._leaves, jax.tree.leaves(more), strict=True):
            leaf[at:end] = np.asarray(new)[:count]
        return end

    def first(self, count: int) -> Any:
        """The first `count` rows as a tree of views."""
        return jax.tree.unflatten(self._structure, [leaf[:count] for leaf in self._leaves])


def _with_room(leaf: np.ndarray, kept: int, room: int) -> np.ndarray:
    grown = np.empty((room, *leaf.shape[1:]), leaf.dtype)
    grown[:kept] = leaf[:kept]
    return grown
