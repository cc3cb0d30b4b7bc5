"""First-order descent, for what is not least squares: any optax transformation, on any loss of the residuals."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.math.arrays import Array, Scalar

_CHUNK = 10  # iterations in one call of the compiled program; in between progress is told and Ctrl-C is heard


def descend(
    loss: Callable[[Array], Scalar],
    start: Array,
    optimiser: Any,
    iterations: int,
    progress: Callable[[str], None],
) -> tuple[Array, int, str]:
    """The best of `iterations` steps from `start` (P,), how many were made, and how it ended.

    Derivatives are taken forwards, as everywhere in a fit: the unknowns are few, the residuals many. A loss that is
    not finite ends the descent; the best point before it is handed back.
    """

    def both(at: Array) -> tuple[Scalar, Scalar]:
        value = loss(at)
        return value, value

    @jax.jit
    def chunk(carry: Any) -> Any:
        def one(carry, _):
            at, state, best, least = carry
            slope, value = jax.jacfwd(both, has_aux=True)(at)
            better = value < least
            best, least = jnp.where(better, at, best), jnp.where(better, value, least)
            change, state = optimiser.update(slope, state, at, value=value, grad=slope, value_fn=loss)
            return (at + change, state, best, least), value

        return jax.lax.scan(one, carry, length=_CHUNK)

    import optax

    optimiser = optax.with_extra_args_support(optimiser)
    carry = (start, optimiser.init(start), start, jnp.asarray(jnp.inf, start.dtype))
    made = 0
    while made < iterations:
        carry, values = chunk(carry)
        made += _CHUNK
        progress(f"{made} of {iterations} steps, loss {float(carry[3]):.6g}")
        if not bool(jnp.all(jnp.isfinite(values))):
            return carry[2], made, "the loss is not finite any more; the best before it is kept"
    return carry[2], made, "made all its steps"


def by_optimiser(residual: Any, flat: Any, data: Any, optimiser: Any, loss: Any, steps: int, progress: Any):
    """Minimise a loss of `residual(step, None, data)`, by default half the sum of squares, from no step (P,).

    Returns the step, the information there, the steps made, and how it ended.
    """
    alone = {name: measured[0, 0] for name, measured in data.items()}
    value = (lambda r: 0.5 * jnp.sum(r**2)) if loss is None else loss

    def left(step):
        return residual(step, None, alone)

    moved, made, ended = descend(
        lambda step: value(left(step)), jnp.zeros_like(flat), optimiser, steps, progress
    )
    by_step = np.asarray(jax.jit(jax.jacfwd(left))(moved), float)
    return moved, by_step.T @ by_step, made, ended
