"""What single points of contact leave to the next step, found again by hashing: sorting would cost 6 ms a step.

A point is named by its two bodies and its feature. Of names that fall into one place of the table one wins, and the
others have a second table; who loses both (one in a thousand) starts from no impulse, which costs work and no truth.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.contact.memory import Memory
from jaxrb.math.arrays import Array

_SPARSE = 4  # places in a table, a point
_FACTORS = ((0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D), (0x27D4EB2F, 0x165667B1, 0xD3A2646D))


def first_points(capacity: int, dtype: Any) -> Memory:
    """The memory of no contact."""
    none = jnp.full(capacity, -1, jnp.int32)
    return Memory((none, none), (none,), (jnp.zeros((capacity, 3), dtype),))


def remembered_points(name: tuple[Array, ...], impulse: Array) -> Memory:
    """What to leave: names (first, second, feature) (k,), −1 for none, and impulses (k, 1, 3)."""
    return Memory(name[:2], name[2:], (impulse[:, 0],))


def recalled_points(name: tuple[Array, ...], memory: Memory) -> Array:
    """The impulse (k, 1, 3) that each point had in the last step, zero where it had none."""
    then, impulse = (*memory.pair, *memory.feature), memory.impulse[0]
    bits = (_SPARSE * len(then[0]) - 1).bit_length()
    place = jnp.full(len(name[0]), -1, jnp.int32)
    left = then[0] >= 0
    rows = jnp.arange(len(then[0]), dtype=jnp.int32)
    for factors in _FACTORS:
        here = jnp.where(left, _hashed(then, factors, bits), 1 << bits)
        # The highest number wins, so that the answer does not hang on the order in which they are written.
        table = jnp.full(1 << bits, -1, jnp.int32).at[here].max(rows, mode="drop")
        left &= table.at[here].get(mode="clip") != rows
        found = table[_hashed(name, factors, bits)]
        same = found >= 0
        for own, other in zip(name, then, strict=True):
            same &= own == other[jnp.maximum(found, 0)]
        place = jnp.where(same, found, place)
    there = (place >= 0) & (name[0] >= 0)
    return jnp.where(there[:, None], impulse[jnp.maximum(place, 0)], 0.0)[:, None]


def _hashed(name: tuple[Array, ...], factors: tuple[int, ...], bits: int) -> Array:
    """A place below 2^bits (multiplicative hashing; the top bits are the mixed ones)."""
    code = jnp.zeros(len(name[0]), jnp.uint32)
    for part, factor in zip(name, factors, strict=True):
        code = (code ^ part.astype(jnp.uint32)) * np.uint32(factor)
        code ^= code >> np.uint32(15)
    return ((code * np.uint32(factors[0])) >> np.uint32(32 - bits)).astype(jnp.int32)
