"""Choosing among many rows at run time, in arrays of fixed size."""

import jax.numpy as jnp

from jaxrb.math.arrays import Array


def first_true(mask: Array, capacity: int) -> tuple[Array, Array]:
    """Numbers (capacity,) of the true places of `mask` (k,), ascending, −1 beyond; and how many true there are.

    More than `capacity` of them is an overflow, for the caller to tell.
    """
    if not len(mask):
        return jnp.full(capacity, -1, jnp.int32), jnp.zeros((), jnp.int32)
    rank = jnp.cumsum(mask, dtype=jnp.int32)
    place = jnp.where(mask, rank - 1, capacity)  # beyond the end: dropped
    numbers = jnp.full(capacity, -1, jnp.int32)
    return numbers.at[place].set(jnp.arange(len(mask), dtype=jnp.int32), mode="drop"), rank[-1]
