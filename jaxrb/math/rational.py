"""Rotations by a given angle without trigonometric functions.

A sine costs 8 ns of one core and a division 0.3 ns, where a whole Runge–Kutta step of a body costs 20. The quaternion
of a rotation by θ is [1 − v², 2v u]/(1 + v²) with v = tan(θ/4), and Padé's approximation of that tangent makes it a
quotient of polynomials. Its length is one whatever the error of the angle, so nothing that rotates by it gains or loses
length.

Error of the angle [rad]: round-off up to θ = 4, 1e-12 at 2π; beyond, the angle no longer follows θ, but stays finite
and smooth. A step that turns a body by more than a quarter turn is warned of anyway.
"""

import math

import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Scalar, Vector, components, stack

# Numerator and denominator of tan x ≈ x · n(x²)/d(x²), the convergent of order [9/8] of Lambert's continued fraction,
# both divided by 34459425.
_NUMERATOR = (1.0, -4729725 / 34459425, 135135 / 34459425, -990 / 34459425, 1 / 34459425)
_DENOMINATOR = (1.0, -16216200 / 34459425, 945945 / 34459425, -13860 / 34459425, 45 / 34459425)

_TWO_TURNS = 4 * math.pi
_COARSE = 12.5625


def half_turn_factors(squared_angle: Scalar) -> tuple[Scalar, Scalar]:
    """cos(θ/2) and sin(θ/2)/θ of θ², to round-off for |θ| ≤ π."""
    squared = 0.0625 * squared_angle
    n, d = _horner(_NUMERATOR, squared), _horner(_DENOMINATOR, squared)
    n_squared, d_squared = squared * (n * n), d * d
    inverse = 1.0 / (d_squared + n_squared)
    return (d_squared - n_squared) * inverse, 0.5 * (n * d) * inverse


def half_turn(angle: Scalar) -> tuple[Scalar, Scalar]:
    """cos(θ/2) and sin(θ/2) of θ [rad], to round-off for |θ| ≤ 8."""
    half = 0.5 * angle
    cosine, factor = half_turn_factors(half * half)
    sine = factor * half
    return cosine * cosine - sine * sine, 2.0 * (cosine * sine)


def less_turns(angle: Scalar) -> Scalar:
    """The angle without whole double turns, 4π [rad]: |θ| ≤ 2π, and the quaternion is the same."""
    turns = jnp.round(lax.stop_gradient(angle) * (1.0 / _TWO_TURNS))
    # In two parts, the first of so few digits that its multiples are exact.
    return (angle - turns * _COARSE) - turns * (_TWO_TURNS - _COARSE)


def turn(rotation_vector: Vector) -> Vector:
    """The quaternion wxyz (..., 4) of a rotation vector (..., 3) [rad]."""
    x, y, z = components(rotation_vector)
    cosine, factor = half_turn_factors(x * x + y * y + z * z)
    return stack(cosine, factor * x, factor * y, factor * z)


def _horner(coefficients: tuple[float, ...], x: Scalar) -> Scalar:
    value = coefficients[-1] * x + coefficients[-2]
    for coefficient in coefficients[-3::-1]:
        value = value * x + coefficient
    return value
