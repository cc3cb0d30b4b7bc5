"""Symmetric block tridiagonal systems of small blocks, eliminated block by block."""

import jax
import jax.numpy as jnp

from jaxrb.math.arrays import Array


def solve_chain(local: Array, link: Array, right: Array) -> Array:
    """Solve a block tridiagonal system: `local` (W, Q, Q), `link` (W, Q, Q) to the next block, `right` (W, Q, C)."""
    if local.shape[0] == 1:
        return solve_definite(local[0], right[0])[None]
    q = local.shape[-1]

    def eliminate(carry, window):
        matrix, column = carry
        tie, own, next_own = window
        solved = solve_definite(own - matrix, jnp.concatenate([tie, next_own - column], axis=-1))
        by_tie, by_right = solved[:, :q], solved[:, q:]
        return (tie.T @ by_tie, tie.T @ by_right), (by_tie, by_right)

    nothing = (jnp.zeros_like(local[0]), jnp.zeros_like(right[0]))
    _, (by_tie, by_right) = jax.lax.scan(eliminate, nothing, (link, local, right))

    def substitute(after, window):
        by_tie, by_right = window
        here = by_right - by_tie @ after
        return here, here

    return jax.lax.scan(substitute, jnp.zeros_like(right[0]), (by_tie, by_right), reverse=True)[1]


def solve_definite(matrix: Array, right: Array) -> Array:
    """Solve a positive definite system of a few unknowns by Gauss–Jordan elimination, unrolled.

    No pivots are needed. Batches of `jnp.linalg.solve` go through LAPACK one small matrix at a time.
    """
    table = jnp.concatenate([matrix, right], axis=-1)
    for i in range(matrix.shape[-1]):
        row = table[i] / table[i, i]
        table = (table - table[:, i : i + 1] * row).at[i].set(row)
    return table[:, matrix.shape[-1] :]
