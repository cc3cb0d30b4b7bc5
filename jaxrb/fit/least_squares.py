"""Levenberg–Marquardt for parameters shared by many segments, each a chain of windows with unknowns of their own.

The normal matrix has the shape of an arrow: a block for the shared parameters, one for each segment, and their
borders. Within a segment each window is tied to the next only, so its block is tridiagonal, and is eliminated window
by window; the shared parameters follow by the Schur complement. A step costs time in proportion to the number of
windows, and the whole iteration is one compiled program. A segment of one window is the plain arrow.

Source: Levenberg 1944; Marquardt 1963; damping by the diagonal as in Moré 1978. The elimination is the one of
bundle adjustment (Triggs et al. 2000, section 6). Robust loss by weights that follow the residuals: Huber 1964.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxrb.compilation import jit
from jaxrb.fit.chain import solve_chain
from jaxrb.fit.problem import Normal, Prior, Shooting, Solution
from jaxrb.math.arrays import Array, Scalar

_LONGEST_STEP = 1.0  # of any shared parameter

CONVERGED, OUT_OF_ITERATIONS, STUCK, NOT_FINITE = 0, 1, 2, 3
MEANING = {
    CONVERGED: "converged",
    OUT_OF_ITERATIONS: "stopped at the largest number of iterations",
    STUCK: "no step lowers the sum of squares any more",
    NOT_FINITE: "the residuals are not finite at the start",
}


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


def linearise(
    problem: Shooting,
    shared: Array,
    local: Array,
    data: Any,
    joined: Array,
    continuity: Scalar,
    huber: Scalar,
) -> Normal:
    """Normal equations of one segment: `local` (W, Q), `joined` (W,) 1 where a window goes on into the next.

    The Jacobian is taken forwards: P + Q columns in one pass over all windows side by side.
    """
    p, last = shared.size, jnp.zeros_like(local[:1])

    def window(phi, d):
        def both(z):
            value = problem.shoot(problem.move(shared, z[:p]), z[p:], d)
            return value, value

        return jax.jacfwd(both, has_aux=True)(jnp.concatenate([jnp.zeros_like(shared), phi]))

    (jacobian, end_by), (value, end) = jax.vmap(window)(local, data)
    # Beyond `huber` standard deviations the loss grows linearly: the weight of the row is ψ(r)/r.
    size = jnp.abs(value)
    trust = jnp.where(size > huber, huber / jnp.where(size > huber, size, 1.0), 1.0)
    squares = jnp.sum(trust * value**2 + jnp.where(size > huber, huber * (size - huber), 0.0))
    product = jnp.einsum("wri,wr,wrj->wij", jacobian, trust, jacobian)
    gradient = jnp.einsum("wri,wr->wi", jacobian, trust * value)
    if local.shape[0] == 1:
        return _normal(product, gradient, jnp.zeros_like(product[:, p:, p:]), squares, p)
    following = jnp.concatenate([local[1:], last])
    data_following = jax.tree.map(lambda leaf: jnp.roll(leaf, -1, axis=0), data)
    strength = jnp.sqrt(continuity) * joined

    def jump(end, phi, d, s):
        def both(end, phi):
            value = s * problem.gap(end, phi, d)
            return value, value

        return jax.jacfwd(both, argnums=(0, 1), has_aux=True)(end, phi)

    (by_end, by_next), missed = jax.vmap(jump)(end, following, data_following, strength)
    by_own = by_end @ end_by  # (W, G, P + Q)
    product = product + jnp.einsum("wgi,wgj->wij", by_own, by_own)
    gradient = gradient + jnp.einsum("wgi,wg->wi", by_own, missed)
    across = jnp.einsum(
        "wgi,wgj->wij", by_own, by_next
    )  # (W, P + Q, Q): own and shared rows, the next's columns
    ahead = jnp.einsum("wgi,wgj->wij", by_next, by_next)
    ahead_gradient = jnp.einsum("wgi,wg->wi", by_next, missed)
    normal = _normal(product, gradient, across[:, p:], squares + jnp.sum(missed**2), p)

    def shifted(part):  # what a window adds to the next one's block
        return jnp.concatenate([jnp.zeros_like(part[:1]), part[:-1]])

    return normal._replace(
        border=normal.border + shifted(across[:, :p]),
        local=normal.local + shifted(ahead),
        local_gradient=normal.local_gradient + shifted(ahead_gradient),
    )


def _normal(product: Array, gradient: Array, link: Array, squares: Scalar, p: int) -> Normal:
    return Normal(
        product[:, :p, :p].sum(0), product[:, :p, p:], product[:, p:, p:], link,
        gradient[:, :p].sum(0), gradient[:, p:], squares,
    )  # fmt: skip


@jit
def levenberg_marquardt(
    problem: Shooting,
    shared: Array,
    local: Array,
    data: Any,
    *,
    weight: Array,
    free: Array,
    joined: Array | None = None,
    continuity: float | Array = 0.0,
    huber: float | Array = jnp.inf,
    prior: Prior | None = None,
    max_iterations: int | Array = 100,
    tolerance: float | Array = 1e-9,
    damping: float | Array = 1e-3,
) -> Solution:
    """Minimise ½ Σ_s weight_s (Σ_w |residual|² + continuity Σ_w |gap|²), the sums over segments and their windows.

    Args:
        problem: simulates one window; an `eqx.Module`.
        shared: (P,) start. local: (S, W, Q) start of each window. data: pytree with leading axes S, W.
        weight: (S,) 0 leaves a segment out without a new program; its own unknowns stay where they are.
        free: (P,) 1 for shared parameters to be fitted, 0 for those held.
        joined: (S, W) 1 where a window goes on into the next; None for segments of one window.
        continuity: weight of the squared gaps.
        huber: standard deviations beyond which a residual's pull stops growing; inf is least squares.
        prior: on the shared parameters.
        max_iterations: trial steps, also those refused.
        tolerance: relative drop of the cost, made or foretold, below which it has converged.
        damping: to begin with, of the diagonal; less near a solution, or what only a prior knows would hardly move.

    Nothing is raised here: `status` says how it ended (`MEANING` puts it in words).
    """
    dtype = shared.dtype
    tolerance = jnp.maximum(jnp.asarray(tolerance, dtype), 4 * jnp.finfo(dtype).eps)
    joined = jnp.zeros(local.shape[:2], dtype) if joined is None else joined
    prior = Prior(jnp.zeros_like(shared), jnp.zeros((shared.size,) * 2, dtype)) if prior is None else prior
    tie, bound = jnp.asarray(continuity, dtype), jnp.asarray(huber, dtype)

    def equations(shared, local):
        return jax.vmap(lambda phi, d, j: linearise(problem, shared, phi, d, j, tie, bound))(
            local, data, joined
        )

    def belief(shared):
        by_step = jax.jacfwd(lambda step: problem.move(shared, step))(jnp.zeros_like(shared))
        return by_step.T @ prior.precision @ (shared - prior.mean), by_step.T @ prior.precision @ by_step

    def body(carry: _Carry) -> _Carry:
        normal = equations(carry.trial_shared, carry.trial_local)
        off = carry.trial_shared - prior.mean
        cost = 0.5 * (
            jnp.sum(jnp.where(weight > 0, weight * normal.squares, 0.0)) + off @ prior.precision @ off
        )
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
        step, local_step, predicted = _step(normal, weight, free, damping, belief(shared))
        done = (better & (drop < tolerance * cost) & ~first) | (predicted <= tolerance * cost) | (cost == 0)
        status = jnp.where(first & ~better, NOT_FINITE, jnp.where(done, CONVERGED, -1))
        status = jnp.where((status < 0) & (damping > 1e12), STUCK, status)
        return _Carry(
            shared, local, cost, normal, damping, problem.move(shared, step), local + local_step, predicted,
            carry.iterations + 1, status,
        )  # fmt: skip

    shapes = jax.eval_shape(equations, shared, local)
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    infinity = jnp.asarray(jnp.inf, dtype)
    start = _Carry(
        shared, local, infinity, blank, jnp.asarray(damping, dtype), shared, local, infinity,
        jnp.asarray(0), jnp.asarray(-1),
    )  # fmt: skip
    end = jax.lax.while_loop(
        lambda carry: (carry.status < 0) & (carry.iterations <= max_iterations), body, start
    )
    status = jnp.where(end.status < 0, OUT_OF_ITERATIONS, end.status)
    return Solution(end.shared, end.local, end.cost, end.iterations, status, end.normal)


def _step(
    normal: Normal, weight: Array, free: Array, damping: Scalar, belief: tuple[Array, Array]
) -> tuple[Array, Array, Scalar]:
    """The damped Gauss–Newton step, and the drop of the cost that the quadratic model foretells for it."""
    use = (weight > 0).astype(weight.dtype)[:, None]
    identity = jnp.eye(normal.local.shape[-1], dtype=weight.dtype)
    border = normal.border * free[:, None]
    # Windows that are only padding, and segments left out, have no equations: their unknowns stay.
    empty = jnp.all(normal.local == 0, axis=(-2, -1)) | (use == 0)
    local = jnp.where(empty[..., None, None], identity, normal.local)
    local_gradient = normal.local_gradient * use[..., None]
    # One elimination for the border and the gradient together.
    right = jnp.concatenate([jnp.swapaxes(border, -1, -2), local_gradient[..., None]], axis=-1)
    right = jnp.where(empty[..., None, None], 0.0, right)
    link = normal.link * use[..., None, None]
    solved = jax.vmap(solve_chain)(_damped(local, damping), link, right)
    by_border, by_gradient = solved[..., :-1], solved[..., -1]
    w = jnp.where(weight > 0, weight, 0.0)
    pull = jnp.einsum("s,sp->p", w, normal.shared_gradient) + belief[0]
    gradient = pull * free
    matrix = jnp.einsum("s,sij->ij", w, normal.shared) + belief[1]
    matrix = matrix * free[:, None] * free + jnp.diag(1.0 - free)
    schur = _damped(matrix, damping) - jnp.einsum("s,swij,swjk->ik", w, border, by_border)
    reduced = gradient - jnp.einsum("s,swij,swj->i", w, border, by_gradient)
    step = -jnp.linalg.solve(schur, reduced) * free
    # No farther than the derivative can be trusted; the windows' own unknowns follow the shorter step.
    step = step * jnp.minimum(1.0, _LONGEST_STEP / jnp.maximum(jnp.max(jnp.abs(step)), 1e-30))
    local_step = -(by_gradient + by_border @ step) * use[..., None]
    predicted = -0.5 * (gradient @ step + jnp.sum(w[:, None, None] * local_gradient * local_step))
    return step, local_step, predicted


def _damped(matrix: Array, damping: Scalar) -> Array:
    """matrix + λ diag(matrix), with a floor under the diagonal for directions that nothing is known of."""
    diagonal = jnp.diagonal(matrix, axis1=-2, axis2=-1)
    # Round-off keeps the Schur complement of an unknown direction only as far from zero as this floor.
    floor = 64 * jnp.finfo(matrix.dtype).eps * jnp.max(diagonal, axis=-1, keepdims=True, initial=0.0)
    extra = damping * jnp.maximum(diagonal, floor) + floor
    return matrix + extra[..., None] * jnp.eye(matrix.shape[-1], dtype=matrix.dtype)
