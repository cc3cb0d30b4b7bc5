"""Functions that stay smooth where the textbook formula divides zero by zero.

Every branch that is not taken is first given a harmless argument, since `jnp.where` differentiates both sides and
0 · inf = NaN. The thresholds choose between two expressions for the same number; nothing is added to a formula.
"""

import math

import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Array, Real, Scalar


def safe_sqrt(x: Scalar) -> Scalar:
    """√x with derivative 0, not infinity, at x = 0. NaN stays NaN."""
    positive = ~(x <= 0)
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def norm(v: Real) -> Scalar:
    """Euclidean length along the last axis; its gradient at the zero vector is zero."""
    return safe_sqrt(jnp.sum(v * v, axis=-1))


def normalise(v: Real) -> Real:
    """v / |v| along the last axis; the zero vector stays zero, with zero derivatives, and NaN stays NaN."""
    squared = jnp.sum(v * v, axis=-1, keepdims=True)
    positive = ~(squared <= 0)
    return jnp.where(positive, v / jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


# Below this squared angle the series of eight terms is exact to 4e-20; above it the direct formulas and their first
# two derivatives lose less than two digits.
_SERIES_BELOW = 0.25


def _entire(squared_angle: Scalar, offset: int, direct) -> Scalar:
    """Σ (−s)^k / (2k + offset)! near s = 0, `direct(√s)` elsewhere."""
    small = squared_angle < _SERIES_BELOW
    inside = jnp.where(small, squared_angle, 0.0)
    series = jnp.zeros_like(inside)
    for k in reversed(range(9)):
        series = 1.0 / math.factorial(2 * k + offset) - inside * series
    return jnp.where(small, series, direct(jnp.sqrt(jnp.where(small, 1.0, squared_angle))))


def cosine(squared_angle: Scalar) -> Scalar:
    """cos √s, smooth at s = 0."""
    return _entire(squared_angle, 0, jnp.cos)


def sinc(squared_angle: Scalar) -> Scalar:
    """sin √s / √s, smooth at s = 0."""
    return _entire(squared_angle, 1, lambda a: jnp.sin(a) / a)


def cosc(squared_angle: Scalar) -> Scalar:
    """(1 − cos √s) / s, smooth at s = 0."""
    return _entire(squared_angle, 2, lambda a: (1.0 - jnp.cos(a)) / (a * a))


def sinc_defect(squared_angle: Scalar) -> Scalar:
    """(√s − sin √s) / s^(3/2), smooth at s = 0."""
    return _entire(squared_angle, 3, lambda a: (a - jnp.sin(a)) / (a * a * a))


def arctan_ratio(squared_sine: Scalar, cosine_part: Scalar) -> Scalar:
    """atan2(√s, c) / √s for c ≥ 0, smooth at s = 0: the factor of the rotation logarithm.

    Where both are zero there is no rotation to speak of; the value there is 0 and the derivatives are 0.
    """
    # Twelve terms of the arctangent's series at s/c² < 0.01 leave 1e-26, and 1e-20 in the second derivative.
    small = squared_sine < 0.01 * cosine_part * cosine_part
    c = jnp.where(small, cosine_part, 1.0)
    ratio = jnp.where(small, squared_sine, 0.0) / (c * c)
    series = jnp.zeros_like(ratio)
    for k in reversed(range(12)):
        series = 1.0 / (2 * k + 1) - ratio * series
    nowhere = (squared_sine <= 0) & ~small
    s = jnp.sqrt(jnp.where(small | nowhere, 1.0, squared_sine))
    direct = jnp.arctan2(s, jnp.where(small | nowhere, 1.0, cosine_part)) / s
    return jnp.where(small, series / c, jnp.where(nowhere, 0.0, direct))


def arctan2(y: Scalar, x: Scalar) -> Scalar:
    """atan2 with value 0 and zero derivatives at the origin, where the angle has no meaning."""
    defined = (y != 0) | (x != 0)
    return jnp.where(defined, jnp.arctan2(jnp.where(defined, y, 0.0), jnp.where(defined, x, 1.0)), 0.0)


def divide(numerator: Array, denominator: Array) -> Array:
    """numerator / denominator, and 0 with zero derivatives where the denominator is 0."""
    defined = denominator != 0
    return jnp.where(defined, numerator / jnp.where(defined, denominator, 1.0), 0.0)


def unit_or(v: Real, fallback: Real) -> Real:
    """v / |v| for a v of any length, or `fallback` where v is the zero vector. NaN stays NaN."""
    # The largest component is taken out first: the square of 1e-30 is no number of float32. It needs no derivative,
    # since v / |v| does not depend on the scale.
    size = lax.stop_gradient(jnp.max(jnp.abs(v), axis=-1, keepdims=True))
    nonzero = size != 0
    return jnp.where(nonzero, normalise(v / jnp.where(nonzero, size, 1.0)), fallback)
