"""Values, gradients and Hessians where the textbook formulas divide zero by zero: finite, and correct.

The references are other formulas for the same functions that have no singular point: power series summed to the end,
and compositions whose derivative is known exactly.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import EYE, derivatives, spread
from rotation_samples import GROUPS, QUICK, largest, numbers, unit_vectors

from jaxrb import EulerAngles, Quaternion, RotationMatrix, hat, slerp
from jaxrb.math import safe


def special_vectors(dtype) -> np.ndarray:
    """Rotation vectors at zero, near zero, on the switches between series and formula, at half a turn."""
    axes = np.concatenate([EYE, unit_vectors(4, seed=2)])
    angles = [
        1e-300,
        1e-20,
        1e-9,
        1e-4,
        0.2,
        0.49999,
        0.5,
        0.50001,
        0.99999,
        1.0,
        1.00001,
        2.0,
        3.1415,
        math.pi,
    ]
    vectors = (np.asarray(angles)[:, None, None] * axes).reshape(-1, 3)
    return np.concatenate([np.zeros((1, 3)), vectors]).astype(dtype)


def agree(found, expected, small):
    """Each derivative agrees, relative to its size or one; NaN does not agree."""
    for order, (one, other) in enumerate(zip(found, expected, strict=True)):
        assert largest(one - other) / max(1.0, largest(other)) < small * 10**order


def series(s, offset, terms=20):
    """Σ (−s)^k / (2k + offset)! by Horner's rule."""
    total = jnp.zeros_like(s)
    for k in reversed(range(terms)):
        total = 1.0 / math.factorial(2 * k + offset) - s * total
    return total


def exponential_series(kind, v):
    """exp(v) by power series: no square root, no quotient, accurate beyond half a turn."""
    s = jnp.sum(v * v)
    if kind is Quaternion:
        return jnp.concatenate([series(0.25 * s, 0)[None], 0.5 * series(0.25 * s, 1) * v])
    return series(s, 0) * EYE.astype(v.dtype) + series(s, 1) * hat(v) + series(s, 2) * jnp.outer(v, v)


@pytest.mark.parametrize("kind", GROUPS)
def test_exponential_is_smooth(kind, dtype, tolerance):
    points = special_vectors(dtype)
    found = derivatives(lambda v: numbers(kind.exp(v)), points)
    expected = derivatives(lambda v: exponential_series(kind, v), points)
    agree(found, expected, tolerance(float64=3e-14, float32=2e-5))


@pytest.mark.parametrize("name", ["cosine", "sinc", "cosc", "sinc_defect"])
def test_entire_functions_have_the_derivatives_of_their_series(name, dtype, tolerance):
    """On both sides of the switch at 0.25, and third derivatives too: a Hessian of a derivative map needs them."""
    offset = ["cosine", "sinc", "cosc", "sinc_defect"].index(name)

    def towers(function):
        first = jax.grad(function)
        second = jax.grad(first)
        tower = jax.vmap(lambda s: jnp.stack([function(s), first(s), second(s), jax.grad(second)(s)]))
        return jax.jit(tower, compiler_options=QUICK)

    s = np.asarray([0.0, 1e-30, 1e-9, 0.1, 0.2499, 0.25, 0.2501, 0.5, 2.0, 9.0], dtype)
    error = np.abs(np.asarray(towers(getattr(safe, name))(s) - towers(lambda s: series(s, offset))(s)))
    assert (error.max(0) < tolerance(float64=1e-15, float32=6e-7) * np.asarray([1, 10, 200, 5000])).all()


@pytest.mark.parametrize("kind", [Quaternion, RotationMatrix, EulerAngles])
def test_logarithm_of_the_exponential_is_the_identity_to_second_order(kind, dtype, tolerance):
    """Value v, Jacobian 1, Hessian 0; beyond half a turn the other way round, v − 2π v/|v|."""
    points = special_vectors(dtype)
    if kind is EulerAngles:  # away from the lock of pitch; derivatives there are the subject of another test
        middle = EulerAngles.exp(points).angles[:, 1]
        points = points[np.abs(np.cos(middle)) > 0.1]

    def other_way_round(v):
        return v - 2 * np.pi * v / jnp.sqrt(jnp.sum(v * v))

    found = derivatives(lambda v: kind.exp(v).log(), points)
    expected = spread(points)
    around = derivatives(other_way_round, np.where(np.abs(points).max(-1, keepdims=True) > 0.1, points, 1))
    turned = (np.sum(found[0] * points, -1) < 0)[:, None]
    assert (np.linalg.norm(points, axis=-1) > 3.14)[turned[:, 0]].all()
    for order in range(3):
        where = turned.reshape(-1, *[1] * (expected[order].ndim - 1))
        expected[order] = np.where(where, around[order], expected[order])
    agree(found, expected, tolerance(float64=3e-13, float32=1e-4))


def test_slerp_from_equal_ends_is_smooth_in_both(dtype, tolerance):
    """slerp(R, R exp v, f) = R exp(f v) and slerp(R exp v, R, f) = R exp((1 − f) v), at v = 0 and near it."""
    kind = Quaternion
    points = special_vectors(dtype)
    points = points[np.linalg.norm(points, axis=-1) < 1e-3]
    r = kind.exp(np.asarray([0.3, -1.0, 0.4], dtype))
    small = tolerance(float64=1e-14, float32=3e-6)
    for function, scale in (
        (lambda v: slerp(r, r @ kind.exp(v), 0.3), 0.3),
        (lambda v: slerp(r @ kind.exp(v), r, 0.3), 0.7),
    ):
        found = derivatives(lambda v, function=function: numbers(function(v)), points)
        expected = derivatives(
            lambda v, scale=scale: numbers(r @ kind(exponential_series(kind, scale * v))), points
        )
        agree(found, expected, small)


def test_slerp_between_equal_ends_does_not_depend_on_the_fraction(dtype, tolerance):
    r = Quaternion.exp(np.asarray([0.3, -1.0, 0.4], dtype))
    _, rate, bend = derivatives(lambda f: slerp(r, r, f).wxyz, np.asarray([0.0, 0.5], dtype))
    assert largest(rate) + largest(bend) < tolerance(float64=1e-15, float32=1e-6)


def test_axis_angle_is_smooth_in_the_angle_and_finite_without_an_axis(dtype, tolerance):
    axis = np.asarray([0.6, 0.0, 0.8], dtype)
    points = np.asarray([0.0, np.pi], dtype)
    found = derivatives(lambda a: Quaternion.from_axis_angle(axis, a).wxyz, points)
    expected = derivatives(lambda a: exponential_series(Quaternion, a * axis), points)
    agree(found, expected, tolerance(float64=1e-14, float32=1e-5))
    nowhere = np.zeros((1, 3), dtype)
    without = derivatives(lambda u: Quaternion.from_axis_angle(u, jnp.ones((), dtype)).wxyz, nowhere)
    assert largest(without[0] - [[1, 0, 0, 0]]) == 0
    assert largest(without[1]) + largest(without[2]) == 0
    at_identity = derivatives(lambda v: jnp.append(*Quaternion.exp(v).as_axis_angle()), nowhere)
    assert all(np.isfinite(x).all() for x in at_identity)


def test_angle_between_equal_rotations_has_a_zero_gradient_and_elsewhere_the_axis(dtype, tolerance):
    """|v| has no derivative at zero: zero is chosen there, between those of all directions."""
    points = np.asarray([[0, 0, 0], [1e-9, 0, 0], [0.3, 0, 0], [0, 0, 3.0]], dtype)
    one = Quaternion.identity(dtype)
    value, slope, bend = derivatives(lambda v: one.angle_to(Quaternion.exp(v)), points)
    small = tolerance(float64=1e-14, float32=1e-5)
    assert largest(value - np.linalg.norm(points, axis=-1)) < small
    assert largest(slope[:, :3] - [[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 1]]) < small
    assert np.isfinite(bend).all()
    assert largest(bend[2, :3] - np.asarray([0, 1, 1]) / points[2, 0]) < 100 * small


def test_conversions_from_matrices_are_smooth_where_the_largest_component_changes(dtype, tolerance):
    """Shepperd's four branches meet at thirds of a turn about a diagonal and at half turns about face diagonals."""
    thirds = 2 * np.pi / 3 * np.asarray([[1, 1, 1], [1, -1, 1], [-1, 1, 1]]) / np.sqrt(3)
    halves = np.pi * np.asarray([[1, 1, 0], [0, 1, 1], [1, 0, -1]]) / np.sqrt(2)
    halves_of_halves = np.pi / 2 * EYE
    points = np.concatenate([np.zeros((1, 3)), np.pi * EYE, thirds, halves, halves_of_halves]).astype(dtype)
    found = derivatives(lambda v: Quaternion.from_matrix(RotationMatrix.exp(v).matrix).wxyz, points)
    expected = derivatives(lambda v: Quaternion.exp(v).wxyz, points)
    sign = np.sign(np.sum(found[0] * expected[0], -1))
    expected = [part * sign.reshape(-1, *[1] * (part.ndim - 1)) for part in expected]
    agree(found, expected, tolerance(float64=1e-14, float32=5e-6))


@pytest.mark.parametrize("sequence", ["zyx", "zxz", "xyz", "yzy"])
def test_euler_angles_are_smooth_away_from_lock_and_finite_in_it(sequence, dtype, tolerance):
    middle = 1.1 if sequence[0] == sequence[2] else 0.6
    lock = 0.0 if sequence[0] == sequence[2] else np.pi / 2

    def there_and_back(angles):
        return EulerAngles.from_rotation(EulerAngles(angles, sequence), sequence).angles

    points = np.asarray([[0, middle, 0], [0.5, middle, -2], [3.0, middle, 3.0], [0.2, lock, 0.5]], dtype)
    found = derivatives(there_and_back, points)
    regular = [part[:3] for part in found]
    agree(regular, spread(points[:3]), tolerance(float64=2e-14, float32=2e-5))
    assert all(np.isfinite(part).all() for part in found[:2])


def test_lengths_and_directions_at_the_zero_vector(dtype):
    """|v| and v/|v| have no derivative at zero: the value is zero, and so are the derivatives, in float32 too."""
    zero = np.zeros((1, 3), dtype)
    for function in (safe.norm, safe.normalise, lambda v: safe.unit_or(v, jnp.zeros_like(v))):
        assert sum(largest(part) for part in derivatives(function, zero)) == 0
    origin = np.zeros(1, dtype)
    for function in (safe.safe_sqrt, lambda x: safe.arctan2(x, x * 2), lambda x: safe.divide(x, x)):
        assert sum(largest(part) for part in derivatives(function, origin)) == 0


def test_lengths_and_directions_elsewhere(dtype, tolerance):
    """∂|v| = u and ∂u = (1 − u uᵀ)/|v|."""
    points = (np.asarray([1e-3, 1.0, 1e3])[:, None] * unit_vectors(3)).astype(dtype)
    u = points / np.linalg.norm(points, axis=-1, keepdims=True)
    across = EYE - u[:, :, None] * u[:, None, :]
    length = np.linalg.norm(points, axis=-1)[:, None]
    small = tolerance(float64=1e-14, float32=1e-5)
    _, slope, bend = derivatives(safe.norm, points)
    assert largest(slope[:, :3] - u) < small
    assert largest(bend[:, :3] * length - np.diagonal(across, axis1=1, axis2=2)) < small
    for direction in (safe.normalise, lambda v: safe.unit_or(v, jnp.zeros_like(v))):
        value, slope, _ = derivatives(direction, points)
        assert largest(value - u) < small
        assert largest(slope[:, :3] * length[..., None] - across) < small


def test_nan_is_never_taken_for_zero(dtype):
    bad = np.asarray([np.nan, 0.0, 1.0], dtype)
    for function in (safe.norm, safe.normalise, lambda v: safe.unit_or(v, jnp.zeros_like(v))):
        assert np.isnan(np.asarray(function(bad))).any()
    assert np.isnan(float(safe.safe_sqrt(bad[0])))
    assert np.isnan(float(safe.arctan_ratio(bad[0], bad[2])))
    assert np.isnan(np.asarray(Quaternion(np.full(4, np.nan, dtype)).normalise().wxyz)).all()
    assert np.isnan(np.asarray(Quaternion.exp(bad).wxyz)).any()
