"""Gradients of a loss blurred by noise: for where its own derivative is zero, undefined, or of a slope too small.

What comes out is the gradient of another loss, F(x) = E f(x + s z) with z normal: it is right for that, and tells of f
only as far as f is alike over distances s. Both error and bias are part of the answer.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.accuracy.smoothed_gradient_report import INTERPOLATED, SmoothedGradient
from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, RunFailed, WrongStructure
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.safe import divide
from jaxrb.scene.settings import ON_ERROR, check_choice, check_count

# So many standard errors are taken for chance.
_CONFIDENCE = 2.0


def smoothed_gradient(
    loss: Callable[[Any], Any],
    at: Any,
    *,
    scale: Any,
    key: Any,
    samples: int = 256,
    order: int | str = 0,
    antithetic: bool = True,
    bias_limit: Scalar | float | None = None,
    batch: int = 64,
    on_error: str = "raise",
) -> SmoothedGradient:
    """The gradient of E f(x + s z), z normal: the loss f seen through a blur of size s. Works inside `jit`.

    Order 0 is the mean of (f(x + s z) − f(x − s z)) z/2s: unbiased whatever f is, also where f jumps (Nesterov and
    Spokoiny 2017, "Random gradient-free minimization of convex functions"); its variance grows with the number of
    unknowns. Order 1 is the mean of the gradients ∇f(x + s z): much less noisy where f is smooth, but blind to jumps.
    "interpolated" is α times the one plus 1 − α times the other: with the α of least mean squared error, or, under a
    limit on the bias, of least variance (Suh, Simchowitz, Zhang, Tedrake 2022, "Do differentiable simulators give
    better policy gradients?", section 5).

    Args:
        loss: one real number of `at`. Define it once: a new function object is compiled anew.
        at: any tree; its floating arrays are what is blurred.
        scale: s, in the units of each leaf: one number, or a tree of them like `at`.
        key: of `jax.random`; the same key gives the same answer.
        samples: evaluations of the loss, and at order 1 and between of its gradient.
        order: 0, 1 or "interpolated".
        antithetic: samples in pairs x ± s z, which takes all even parts of f out of the noise. Without, order 0
            compares each value with f(x).
        bias_limit: γ of Suh et al., in units of loss (the length of s · gradient): what the bias and the confidence
            radius of order 0, two standard errors, may come to together.
        batch: evaluations at a time, side by side.
        on_error: "raise" `RunFailed` where a sample is not finite, or "flag" it in `not_finite`. Nothing is left out.

    Raises:
        WrongStructure, InvalidInput: no floating leaf, a loss that is not one real number; a scale not positive.
    """
    numbers, rest = eqx.partition(jax.tree.map(_as_floating, at), eqx.is_inexact_array)
    leaves = jax.tree.leaves(numbers)
    if not leaves:
        raise WrongStructure("smoothed_gradient: `at` holds no floating array; give what the loss depends on")
    if order not in (0, 1, INTERPOLATED):
        raise InvalidInput(f"smoothed_gradient: order is {order!r}; give 0, 1 or {INTERPOLATED!r}")
    check_choice("on_error", on_error, ON_ERROR)
    samples = check_count("smoothed_gradient: samples", samples, 4)
    batch = check_count("smoothed_gradient: batch", batch, 1)
    scales = _scales(scale, leaves)
    limit = None if bias_limit is None else jnp.asarray(bias_limit)
    found = _estimated(loss, numbers, rest, scales, key, limit, samples, order, bool(antithetic), batch)
    if on_error == "raise" and is_concrete(found.not_finite) and int(found.not_finite):
        raise RunFailed(
            f"smoothed_gradient: {int(found.not_finite)} of {samples} samples are not finite; take a smaller scale, "
            "make the loss finite within it, or keep the result with on_error='flag'"
        )
    return found


def _as_floating(leaf: Any) -> Any:
    return jnp.asarray(leaf) if isinstance(leaf, (float, np.floating, np.ndarray)) else leaf


def _scales(scale: Any, leaves: list) -> list:
    given = jax.tree.leaves(scale)
    if jax.tree.structure(scale) == jax.tree.structure(0):
        given = given * len(leaves)
    if len(given) != len(leaves):
        raise WrongStructure(
            f"smoothed_gradient: scale has {len(given)} numbers; give one, or one for each of the {len(leaves)} "
            "floating leaves of `at`, in a tree like it"
        )
    for s in given:
        if is_concrete(s) and not (np.isfinite(s).all() and (np.asarray(s) > 0).all()):
            raise InvalidInput(f"smoothed_gradient: scale {s!r}, but must be positive and finite")
    return [jnp.asarray(s, leaf.dtype) for s, leaf in zip(given, leaves, strict=True)]


@eqx.filter_jit
def _estimated(
    loss: Callable, numbers: Any, rest: Any, scales: list, key: Any, limit: Any, samples: int, order: Any,
    antithetic: bool, batch: int,
) -> SmoothedGradient:  # fmt: skip
    leaves, structure = jax.tree.flatten(numbers)

    def value(moved: list) -> Any:
        found = loss(eqx.combine(jax.tree.unflatten(structure, moved), rest))
        if jnp.shape(found) != () or not jnp.issubdtype(jnp.result_type(found), jnp.floating):
            raise WrongStructure("smoothed_gradient: the loss must give one real number")
        return found

    count = -(-samples // 2) if antithetic else samples
    keys = jax.random.split(key, len(leaves))
    noise = [
        jax.random.normal(k, (count, *leaf.shape), leaf.dtype) for k, leaf in zip(keys, leaves, strict=True)
    ]
    here = None if antithetic else value(leaves)

    def drawn(z: list) -> tuple[Any, Any, Any, Any]:
        """Mean value, first- and zeroth-order gradient times s of one draw, and whether all is finite."""
        sides = [
            [x + sign * s * part for x, s, part in zip(leaves, scales, z, strict=True)]
            for sign in (1.0, -1.0)
        ]
        found = [(value(side), None) if order == 0 else jax.value_and_grad(value)(side)
                 for side in (sides if antithetic else sides[:1])]  # fmt: skip
        values = [v for v, _ in found]
        fine = jnp.all(jnp.stack([jnp.isfinite(v) for v in values]))
        first = None
        if order != 0:
            first = [
                s * sum(parts) / len(parts)
                for s, parts in zip(scales, zip(*(g for _, g in found)), strict=True)
            ]
            fine = fine & jnp.all(jnp.stack([jnp.all(jnp.isfinite(g)) for g in first]))
        rise = 0.5 * (values[0] - values[1]) if antithetic else values[0] - here
        zeroth = [rise * part for part in z]
        return sum(values) / len(values), first, zeroth, fine

    values, first, zeroth, fine = lax.map(drawn, noise, batch_size=min(batch, count))
    share = jnp.asarray(1.0 if order == 1 else 0.0, values.dtype)
    if order == INTERPOLATED:
        share = _share(first, zeroth, limit)
    chosen = zeroth if order == 0 else first
    if order == INTERPOLATED:
        chosen = [share * a + (1.0 - share) * b for a, b in zip(first, zeroth, strict=True)]
    off = None if first is None else [a - b for a, b in zip(first, zeroth, strict=True)]

    def told(rows: list | None, statistic: Callable) -> Any:
        if rows is None:
            return None
        return jax.tree.unflatten(structure, [statistic(r) / s for r, s in zip(rows, scales, strict=True)])

    per_draw = 2 if antithetic else 1
    return SmoothedGradient(
        told(chosen, _mean), told(chosen, _error), _mean(values), _error(values), told(off, _mean), told(off, _error),
        share, jnp.sum(~fine, dtype=jnp.int32) * per_draw, order, count * per_draw,
    )  # fmt: skip


def _share(first: list, zeroth: list, limit: Any) -> Scalar:
    """α. With variances σ₀², σ₁² and the bias B of order 1: without a limit that of the least mean squared error,
    σ₀²/(B² + σ₀² + σ₁²), B² less what chance may add; with one, that of Suh et al. (2022)."""
    rows = list(zip(first, zeroth, strict=True))
    squared = sum(jnp.sum((_mean(a) - _mean(b)) ** 2) for a, b in rows)
    errors = [sum(jnp.sum(_error(part) ** 2) for part in parts) for parts in (zeroth, first)]
    both = errors[0] + errors[1]
    if limit is None:
        chance = sum(jnp.sum(_error(a - b) ** 2) for a, b in rows)
        all_of_it = jnp.maximum(squared - _CONFIDENCE**2 * chance, 0.0) + both
        return jnp.where(all_of_it > 0, divide(errors[0], all_of_it), 1.0)
    least, apart = jnp.where(both > 0, divide(errors[0], both), 1.0), jnp.sqrt(squared)
    room = jnp.maximum(limit - _CONFIDENCE * jnp.sqrt(errors[0]), 0.0)
    return jnp.where(least * apart <= room, least, divide(room, apart))


def _mean(rows: Array) -> Array:
    return jnp.mean(rows, axis=0)


def _error(rows: Array) -> Array:
    """Standard error of the mean."""
    return jnp.std(rows, axis=0, ddof=1) / np.sqrt(len(rows))
