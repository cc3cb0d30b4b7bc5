"""Linear algebra of the contact solve: 6×6 blocks of bodies, and conjugate gradients preconditioned by them."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Array


def inverted(matrix: Array) -> Array:
    """Inverses (n, 6, 6) of symmetric positive definite matrices, by sweeping (Goodnight 1979, Amer. Stat. 33, 149).

    One small kernel, six times: the library's batched solve costs a microsecond a matrix, and a factorisation written
    out by components compiles for half a second.
    """

    def sweep(k: Any, a: Array) -> Array:
        here = jnp.arange(6) == k
        row = lax.dynamic_index_in_dim(a, k, axis=1)
        column = jnp.swapaxes(row, 1, 2)
        pivot = lax.dynamic_index_in_dim(row, k, axis=2)
        swept = a - column * row / pivot
        swept = jnp.where(here[:, None], row / pivot, jnp.where(here[None, :], column / pivot, swept))
        return jnp.where(here[:, None] & here[None, :], -1.0 / pivot, swept)

    return -lax.fori_loop(0, 6, sweep, matrix)


def multiplied(matrix: Array, vector: Array) -> Array:
    """Products (n, 6) of matrices (n, 6, 6) with vectors (n, 6)."""
    return jnp.sum(matrix * vector[:, None, :], axis=-1)


def conjugate_gradients(
    apply: Callable[[Array], Array],
    precondition: Callable[[Array], Array],
    right: Array,
    *,
    tolerance: Any,
    most: int,
) -> tuple[Array, Array]:
    """x with |A x − right| ≤ tolerance · |right| in the preconditioner's norm, or after `most` products; their number.

    (Hestenes and Stiefel 1952.) A is symmetric positive definite. A right side of zero costs nothing.
    """
    z = precondition(right)
    start = jnp.sum(right * z)

    def going(carry: Any) -> Any:
        return (carry[0] < most) & (carry[-1] > tolerance * tolerance * start)

    def step(carry: Any) -> Any:
        k, x, residual, direction, size = carry
        applied = apply(direction)
        length = size / jnp.sum(direction * applied)
        x, residual = x + length * direction, residual - length * applied
        z = precondition(residual)
        new = jnp.sum(residual * z)
        return k + 1, x, residual, z + (new / size) * direction, new

    carry = (jnp.zeros((), jnp.int32), jnp.zeros_like(right), right, z, start)
    k, x, *_ = lax.while_loop(going, step, carry)
    return x, k
