"""Stabilised explicit Adams stepping: one evaluation of the equations of motion a step, at order 6 to 12.

The derivatives of the last k steps lie in a ring; a step adds their weighted sum to the state and overwrites the
oldest. Everything that moves is one array of rows (rows, n), one column a body: on XLA's CPU a step is then two loops
over whole rows, 7 ns where a tuple of components costs 18–30. Fixed steps, fixed memory.
(Adams–Bashforth: Hairer, Nørsett, Wanner, "Solving Ordinary Differential Equations I", 1993, section III.1.)
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.integrators.adams_motion import Field
from jaxrb.integrators.adams_weights import Scheme, interpolation, ring_weights, starter
from jaxrb.math.arrays import Array, Scalar


@jax.custom_jvp
def weighted_sum(weights: Array, history: Array) -> Array:
    """Σ weights[j] · history[j]. Written out, since a reduction over the first axis is not vectorised by XLA."""
    total = weights[0] * history[0]
    for j in range(1, history.shape[0]):
        total = total + weights[j] * history[j]
    return total


@weighted_sum.defjvp
def _weighted_sum_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # The transpose of the written-out sum is k padded additions; of this one it is a product.
    (weights, history), (d_weights, d_history) = primals, tangents
    shape = (-1,) + (1,) * (history.ndim - 1)
    change = weights.reshape(shape) * d_history + d_weights.reshape(shape) * history
    return weighted_sum(weights, history), jnp.sum(change, axis=0)


def _written(ring: Array, slot: Any, value: Array) -> Array:
    return lax.dynamic_update_index_in_dim(ring, value, slot, 0)


def started(field: Field, rows: Array, time: Scalar, step: Scalar, scheme: Scheme) -> tuple[Array, Array]:
    """The rows after nodes − 1 Runge–Kutta steps, and the ring (nodes, rows, n) of the derivatives up to there.

    The stages are a loop over one dense table: a stage then compiles once, not 6 or 12 times.
    """
    stages, weights = starter(scheme)
    count = len(weights)
    # Each stage is reached from the one before: y + Σ (Aᵢ₊₁ − Aᵢ) K.
    table = jnp.asarray(jnp.concatenate([stages[1:], weights[None]]) - stages, rows.dtype) * step
    offset = jnp.asarray(stages.sum(1), rows.dtype)

    def one(carry: tuple, at: tuple) -> tuple[tuple, Array]:
        def stage(carry: tuple, at: tuple) -> tuple[tuple, None]:
            rows, slopes = carry
            number, changes, now, scheduled = at
            slopes = _written(slopes, number, field(now, scheduled, rows))
            return (rows + weighted_sum(changes, slopes), slopes), None

        carry, _ = lax.scan(stage, carry, (jnp.arange(count), table, *at))
        return carry, carry[1][0]

    index = jnp.arange(scheme.nodes - 1).astype(rows.dtype)
    times = time + (index[:, None] + offset) * step
    empty = jnp.zeros((count, *rows.shape), rows.dtype)
    (rows, _), history = lax.scan(one, (rows, empty), (times, field.schedule(times)))
    now = time + (scheme.nodes - 1) * step
    newest = field(now, field.schedule(now), rows)
    return rows, jnp.concatenate([history, newest[None]])


def turn(
    field: Field, rows: Array, ring: Array, time: Scalar, step: Scalar, done: Array, scheme: Scheme
) -> tuple[Array, Array]:
    """One turn of the ring: as many steps as it has slots. `done` steps lie behind."""
    table = jnp.asarray(ring_weights(scheme), rows.dtype)

    def one(carry: tuple, at: tuple) -> tuple[tuple, None]:
        rows, ring = carry
        slot, weights, now, scheduled = at
        rows = rows + step * weighted_sum(weights, ring)
        return (rows, _written(ring, slot, field(now, scheduled, rows))), None

    slots = jnp.arange(scheme.nodes)
    times = time + (done + slots + 1).astype(step.dtype) * step  # counted, not added up
    return lax.scan(one, (rows, ring), (slots, table, times, field.schedule(times)))[0]


def stepped(
    field: Field,
    rows: Array,
    time: Scalar,
    span: Scalar,
    cycles: int | Array,
    scheme: Scheme,
    times: Array | None,
) -> tuple[Array, Array, Array | None]:
    """Advance rows (rows, n) by `span` [s] in a start and `cycles` turns of the ring.

    A whole number of cycles can be differentiated: each turn is then recomputed in the reverse pass. A traced number
    costs no new program when it changes. `times` (s,) [s], ascending, are interpolated on the way.

    Returns:
        The last rows, the last ring, and the rows at the times (s, rows, n), or None without times.
    """
    first = scheme.nodes - 1
    step = span / jnp.asarray(first + scheme.nodes * cycles, rows.dtype)
    begun = started(field, rows, time, step, scheme)

    def cycle(number: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        return turn(field, carry[0], carry[1], time, step, first + number * scheme.nodes, scheme)

    if isinstance(cycles, int):
        body = jax.checkpoint(lambda carry, number: (cycle(number, carry), carry), prevent_cse=False)
        (rows, ring), before = lax.scan(body, begun, jnp.arange(cycles))
        if times is None:
            return rows, ring, None
        ends = jax.tree.map(lambda early, last: jnp.concatenate([early, last[None]]), before, (rows, ring))
        return rows, ring, _interpolated(ends, time, step, times, cycles, scheme)
    if times is None:
        return *lax.fori_loop(0, cycles, cycle, begun), None

    return _saving(cycle, begun, time, step, cycles, scheme, times)


def _saving(
    cycle: Any, begun: tuple, time: Scalar, step: Scalar, cycles: Array, scheme: Scheme, times: Array
) -> tuple[Array, Array, Array]:
    """The cycles, and after each the rows at the times that it has passed."""
    count = times.shape[0]

    def save_due(rows: Array, ring: Array, turns: Any, is_last: Any, done: Array, saved: Array) -> tuple:
        now = time + (scheme.nodes - 1 + turns * scheme.nodes) * step

        def due(carry: tuple) -> Array:
            return (carry[0] < count) & (is_last | (times[jnp.minimum(carry[0], count - 1)] <= now))

        def save(carry: tuple) -> tuple:
            done, saved = carry
            value = between(rows, ring, step, (times[done] - now) / step, scheme)
            return done + 1, _written(saved, done, value)

        return lax.while_loop(due, save, (done, saved))

    def body(number: Array, carry: tuple) -> tuple:
        rows, ring = cycle(number, carry[:2])
        return rows, ring, *save_due(rows, ring, number + 1, number + 1 == cycles, carry[2], carry[3])

    saved = jnp.zeros((count, *begun[0].shape), begun[0].dtype)
    first = save_due(begun[0], begun[1], 0, False, jnp.zeros((), jnp.int32), saved)
    rows, ring, _, saved = lax.fori_loop(0, cycles, body, (*begun, *first))
    return rows, ring, saved


def _interpolated(
    ends: tuple[Array, Array], time: Scalar, step: Scalar, times: Array, cycles: int, scheme: Scheme
) -> Array:
    """Rows at the times (s, rows, n) from rows and ring at the start's end and after each turn."""
    steps = (times - time) / step
    turns = jnp.clip(jnp.ceil((steps - (scheme.nodes - 1)) / scheme.nodes), 0, cycles).astype(jnp.int32)

    def one(turn: Array, steps: Array) -> Array:
        rows, ring = jax.tree.map(lambda leaf: leaf[turn], ends)
        return between(rows, ring, step, steps - (scheme.nodes - 1 + turn * scheme.nodes), scheme)

    return jax.vmap(one)(turns, steps)


def between(rows: Array, ring: Array, step: Scalar, steps: Scalar, scheme: Scheme) -> Array:
    """Rows at `steps` ∈ [−nodes, 0] steps from the newest, by the polynomial through the ring's derivatives.

    The ring has just been filled. Error of the order of the ring's nodes: never above that of the method.
    """
    nodes = scheme.nodes
    s = 2.0 * steps / nodes + 1.0
    legendre = [jnp.ones_like(s), s]
    for m in range(1, nodes):
        legendre.append(((2 * m + 1) * s * legendre[m] - m * legendre[m - 1]) / (m + 1))
    integrals = [s - 1.0] + [(legendre[m + 1] - legendre[m - 1]) / (2 * m + 1) for m in range(1, nodes)]
    weights = jnp.asarray(interpolation(scheme), rows.dtype) @ jnp.stack(integrals) * (0.5 * nodes)
    return rows + step * weighted_sum(weights, ring)
