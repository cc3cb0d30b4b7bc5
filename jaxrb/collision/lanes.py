"""Arithmetic of many pairs at once: components first, pairs along the last axis.

A kernel that sees pairs in its last axis is compiled into long loops over whole vectors; a short last axis (3
components, 8 vertices) costs 3–8 times as much. A chunk of `LANES` pairs fits the first cache and leaves its loops
when the slowest of its own pairs is done, not the slowest of the batch.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.math.vector import cross_of, dot_of

LANES = 128


def cross(a: Any, b: Any) -> jax.Array:
    """a × b, shapes (3, ...)."""
    return jnp.stack(cross_of(a, b))


def heights(points: Any, direction: Any) -> Any:
    """Coordinates (n, L) of points (n, 3, L) along directions (3, L)."""
    return points[:, 0] * direction[0] + points[:, 1] * direction[1] + points[:, 2] * direction[2]


def unit(vector: Any) -> Any:
    """v / |v|, shapes (3, ...); the zero vector stays zero."""
    squared = dot_of(vector, vector)
    return vector / jnp.sqrt(jnp.where(squared > 0, squared, 1.0))


def first_of(mask: Any) -> Any:
    """Number (L,) of the first True along the first axis of (n, L); the last where there is none."""
    count = mask.shape[0]
    numbers = lax.broadcasted_iota(jnp.int32, mask.shape, 0)
    return jnp.where(mask, numbers, count - 1).min(axis=0)


def row(table: Any, number: Any) -> Any:
    """Row `number` (L,) of a table (n, ..., L) or (n, ..., 1): shape (..., L). Cheapest where rows are few."""
    numbers = lax.broadcasted_iota(jnp.int32, (table.shape[0], *(1,) * (table.ndim - 1)), 0)
    return jnp.where(numbers == number, table, 0).sum(axis=0, dtype=table.dtype)


def gathered(table: Any, numbers: Any) -> Any:
    """Rows `numbers` (m, L) or (m, 1) of a table (n, L): shape (m, L)."""
    if numbers.shape[1] != table.shape[1]:
        return table[numbers[:, 0]]
    return jnp.take_along_axis(table, numbers, axis=0, mode="promise_in_bounds")
