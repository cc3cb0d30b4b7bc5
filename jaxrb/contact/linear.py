"""Linear algebra of the contact solve: 6×6 blocks of bodies, and conjugate gradients preconditioned by them.

Symmetric 6×6 matrices are 21 numbers, row by row of the lower triangle, as arrays over the bodies.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Array, components, stack

LOWER = tuple((i, j) for i in range(6) for j in range(i + 1))


def factorised(matrix: Array) -> Array:
    """L and D (..., 21) of a symmetric positive definite matrix L D Lᵀ, the reciprocals of D on the diagonal.

    By components: a batched library call costs about a microsecond a matrix, this a tenth of that.
    """
    a = dict(zip(LOWER, components(matrix), strict=True))
    lower: dict[tuple[int, int], Any] = {}
    for j in range(6):
        scaled = [lower[j, k] * a[k, k] for k in range(j)]
        pivot = a[j, j]
        for k in range(j):
            pivot = pivot - lower[j, k] * scaled[k]
        a[j, j] = pivot
        for i in range(j + 1, 6):
            entry = a[i, j]
            for k in range(j):
                entry = entry - lower[i, k] * scaled[k]
            lower[i, j] = entry / pivot
    return stack(*(1.0 / a[i, i] if i == j else lower[i, j] for i, j in LOWER))


def solved(factors: Array, right: Array) -> Array:
    """x (..., 6) of L D Lᵀ x = right."""
    f = dict(zip(LOWER, components(factors), strict=True))
    x = list(components(right))
    for i in range(6):
        for k in range(i):
            x[i] = x[i] - f[i, k] * x[k]
    x = [x[i] * f[i, i] for i in range(6)]
    for i in reversed(range(6)):
        for k in range(i + 1, 6):
            x[i] = x[i] - f[k, i] * x[k]
    return stack(*x)


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
