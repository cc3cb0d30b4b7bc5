"""Levenberg–Marquardt for parameters shared by many segments, each with a few unknowns of its own.

The normal matrix has the shape of an arrow: a block for the shared parameters, a small block for each
segment, and their borders. The segments' unknowns are eliminated one block at a time (Schur complement), so a
step costs time in proportion to the number of segments. The whole iteration is one compiled program.

Source: Levenberg 1944; Marquardt 1963; damping by the diagonal as in Moré 1978. The elimination is the one of
bundle adjustment (Triggs et al. 2000, section 6).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.math.arrays import Array, Scalar

# residual(shared (P,), local (Q,), data of one segment) -> (R,), in units of its own standard deviation
Residual = Callable[[Array, Array, Any], Array]

CONVERGED, OUT_OF_ITERATIONS, STUCK, NOT_FINITE = 0, 1, 2, 3
MEANING = {
    CONVERGED: "converged",
    OUT_OF_ITERATIONS: "stopped at the largest number of iterations",
    STUCK: "no step lowers the sum of squares any more",
    NOT_FINITE: "the residuals are not finite at the start",
}


class Normal(NamedTuple):
    """The normal equations, one entry a segment: JᵀJ in blocks, Jᵀr in parts, and the sum of squares."""

    shared: Array  # (S, P, P)
    border: Array  # (S, P, Q)
    local: Array  # (S, Q, Q)
    shared_gradient: Array  # (S, P)
    local_gradient: Array  # (S, Q)
    squares: Array  # (S,)


class Solution(NamedTuple):
    """Where the iteration ended. `cost` is ½ Σ weight·r²; `normal` is unweighted."""

    shared: Array
    local: Array
    cost: Scalar
    iterations: Scalar
    status: Scalar
    normal: Normal


class _Carry(NamedTuple):
    shared: Array
    local: Array
    cost: Scalar
    normal: Normal
    damping: Scalar
    trial_shared: Array
    trial_local: Array
    predicted: Scalar
    iterations: Scalar
    status: Scalar


def linearise(residual: Residual, shared: Array, local: Array, data: Any) -> Normal:
    """Normal equations of one segment. The Jacobian is taken forwards: P + Q columns in one pass."""
    stacked = jnp.concatenate([shared, local])

    def both(z):
        value = residual(z[: shared.size], z[shared.size :], data)
        return value, value

    jacobian, value = jax.jacfwd(both, has_aux=True)(stacked)
    product, gradient, p = jacobian.T @ jacobian, jacobian.T @ value, shared.size
    return Normal(
        product[:p, :p], product[:p, p:], product[p:, p:], gradient[:p], gradient[p:], value @ value
    )


@eqx.filter_jit
def levenberg_marquardt(
    residual: Residual,
    shared: Array,
    local: Array,
    data: Any,
    *,
    weight: Array,
    free: Array,
    max_iterations: int | Array = 100,
    tolerance: float | Array = 1e-9,
) -> Solution:
    """Minimise ½ Σ_s weight_s |residual(shared, local_s, data_s)|².

    Args:
        residual: of one segment; an `eqx.Module` or a function. Padded samples must give zeros.
        shared: (P,) start. local: (S, Q) start of each segment. data: pytree with leading axis S.
        weight: (S,) 0 leaves a segment out without a new program; its own unknowns stay where they are.
        free: (P,) 1 for shared parameters to be fitted, 0 for those held.
        max_iterations: trial steps, also those refused.
        tolerance: relative drop of the cost, made or foretold, below which it has converged.

    Nothing is raised here: `status` says how it ended (`MEANING` puts it in words).
    """
    epsilon = jnp.finfo(shared.dtype).eps
    tolerance = jnp.maximum(jnp.asarray(tolerance, shared.dtype), 4 * epsilon)

    def equations(shared, local):
        return jax.vmap(lambda phi, d: linearise(residual, shared, phi, d))(local, data)

    def body(carry: _Carry) -> _Carry:
        normal = equations(carry.trial_shared, carry.trial_local)
        cost = 0.5 * jnp.sum(jnp.where(weight > 0, weight * normal.squares, 0.0))
        better = cost < carry.cost  # False for NaN
        first = carry.iterations == 0
        drop = jnp.where(better, carry.cost - cost, 0.0)
        current = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (carry.trial_shared, carry.trial_local, cost, normal),
            (carry.shared, carry.local, carry.cost, carry.normal),
        )
        damping = jnp.where(better, jnp.maximum(carry.damping / 5.0, 1e-12), carry.damping * 4.0)
        damping = jnp.where(first, carry.damping, damping)
        shared, local, cost, normal = current
        step, local_step, predicted = _step(normal, weight, free, damping)
        done = (better & (drop < tolerance * cost) & ~first) | (predicted <= tolerance * cost) | (cost == 0)
        status = jnp.where(first & ~better, NOT_FINITE, jnp.where(done, CONVERGED, -1))
        status = jnp.where((status < 0) & (damping > 1e12), STUCK, status)
        return _Carry(
            shared, local, cost, normal, damping, shared + step, local + local_step, predicted,
            carry.iterations + 1, status,
        )  # fmt: skip

    blank = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(equations, shared, local)
    )
    infinity = jnp.asarray(jnp.inf, shared.dtype)
    start = _Carry(
        shared, local, infinity, blank, jnp.asarray(1e-3, shared.dtype), shared, local, infinity,
        jnp.asarray(0), jnp.asarray(-1),
    )  # fmt: skip
    end = jax.lax.while_loop(
        lambda carry: (carry.status < 0) & (carry.iterations <= max_iterations), body, start
    )
    status = jnp.where(end.status < 0, OUT_OF_ITERATIONS, end.status)
    return Solution(end.shared, end.local, end.cost, end.iterations, status, end.normal)


def _step(normal: Normal, weight: Array, free: Array, damping: Scalar) -> tuple[Array, Array, Scalar]:
    """The damped Gauss–Newton step, and the drop of the cost that the quadratic model foretells for it."""
    use = (weight > 0).astype(weight.dtype)
    border = normal.border * free[:, None]
    local = normal.local * use[:, None, None] + (1.0 - use)[:, None, None] * jnp.eye(normal.local.shape[-1])
    local_gradient = normal.local_gradient * use[:, None]
    damped = _damped(local, damping)
    # One factorisation for the border and the gradient together.
    right = jnp.concatenate([jnp.swapaxes(border, 1, 2), local_gradient[..., None]], axis=-1)
    solved = jnp.linalg.solve(damped, right)
    by_border, by_gradient = solved[..., :-1], solved[..., -1]
    w = jnp.where(weight > 0, weight, 0.0)
    gradient = jnp.einsum("s,sp->p", w, normal.shared_gradient) * free
    matrix = jnp.einsum("s,sij->ij", w, normal.shared) * free[:, None] * free + jnp.diag(1.0 - free)
    schur = _damped(matrix, damping) - jnp.einsum("s,sij,sjk->ik", w, border, by_border)
    reduced = gradient - jnp.einsum("s,sij,sj->i", w, border, by_gradient)
    step = -jnp.linalg.solve(schur, reduced) * free
    local_step = -(by_gradient + jnp.einsum("sij,j->si", by_border, step)) * use[:, None]
    predicted = -0.5 * (gradient @ step + jnp.sum(w[:, None] * local_gradient * local_step))
    return step, local_step, predicted


def _damped(matrix: Array, damping: Scalar) -> Array:
    """matrix + λ diag(matrix), with a floor under the diagonal for directions that nothing is known of."""
    diagonal = jnp.diagonal(matrix, axis1=-2, axis2=-1)
    # Round-off keeps the Schur complement of an unknown direction only as far from zero as this floor.
    floor = 64 * jnp.finfo(matrix.dtype).eps * jnp.max(diagonal, axis=-1, keepdims=True)
    extra = damping * jnp.maximum(diagonal, floor) + floor
    return matrix + extra[..., None] * jnp.eye(matrix.shape[-1], dtype=matrix.dtype)
