"""What a least-squares fit is given and hands back: the problem, its normal equations, a prior, the solution."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax.numpy as jnp

from jaxrb.math.arrays import Array, Scalar


class Shooting(Protocol):
    """What is fitted: one window is simulated from its own unknowns, and must end where the next begins."""

    def shoot(self, shared: Array, local: Array, data: Any) -> tuple[Array, Array]:
        """Residuals (R,) in standard deviations, zero where padded, and the state (E,) at the window's end."""
        ...

    def gap(self, end: Array, following: Array, data: Any) -> Array:
        """From the start of the following window to the `end` before it, (G,); `data` of the following one."""
        ...

    def move(self, shared: Array, step: Array) -> Array:
        """The shared parameters (P,) a step (P,) away: their sum, or whatever keeps steps well scaled."""
        ...


class Alone(eqx.Module):
    """A plain `residual(shared (P,), local (Q,), data) -> (R,)` of segments that are one window each."""

    residual: Callable[[Array, Array, Any], Array] = eqx.field(static=True)

    def shoot(self, shared: Array, local: Array, data: Any) -> tuple[Array, Array]:
        return self.residual(shared, local, data), jnp.zeros((0,), shared.dtype)

    def gap(self, end: Array, following: Array, data: Any) -> Array:
        return end

    def move(self, shared: Array, step: Array) -> Array:
        return shared + step


class Normal(NamedTuple):
    """The normal equations, one entry a segment: JᵀJ in blocks, Jᵀr in parts, and the sum of squares.

    Derivatives by the shared parameters are by the step of `Shooting.move`, at no step.

    `link` couples a window's unknowns (rows) to those of the next one (columns).
    """

    shared: Array  # (S, P, P)
    border: Array  # (S, W, P, Q)
    local: Array  # (S, W, Q, Q)
    link: Array  # (S, W, Q, Q)
    shared_gradient: Array  # (S, P)
    local_gradient: Array  # (S, W, Q)
    squares: Array  # (S,)


class Solution(NamedTuple):
    """Where the iteration ended. `cost` is ½ Σ weight·r² and what the prior adds; `normal` is unweighted."""

    shared: Array
    local: Array
    cost: Scalar
    iterations: Scalar
    status: Scalar
    normal: Normal


class Prior(NamedTuple):
    """½ (shared − mean)ᵀ precision (shared − mean), added to the cost: `mean` (P,), `precision` (P, P)."""

    mean: Array
    precision: Array
