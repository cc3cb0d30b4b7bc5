"""Hamilton's algebra, line by line of the lecture, and the star operator."""

import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import largest

from jaxrb import Quaternion, hat, vee
from jaxrb.math.quaternion import product
from jaxrb.math.vector import cofactors, cross, determinant, dot, matmul, matvec, solve


@pytest.fixture(scope="module")
def vectors(dtype):
    """Three sets of vectors (20, 3)."""
    return np.random.default_rng(0).normal(size=(3, 20, 3)).astype(dtype)


def test_units_multiply_as_hamilton_carved(dtype):
    """i² = j² = k² = ijk = −1."""
    one, i, j, k = np.eye(4, dtype=dtype)
    for square in (product(i, i), product(j, j), product(k, k), product(product(i, j), k)):
        assert largest(square + one) == 0
    assert largest(product(i, j) - k) == largest(product(j, i) + k) == 0


def test_product_of_scalar_and_vector_parts(vectors, dtype, tolerance):
    """[s₁s₂ − v₁·v₂, s₁v₂ + s₂v₁ + v₁ × v₂]."""
    a, b, s = (np.asarray(v, np.float64) for v in vectors)
    s1, s2 = s[:, :1], s[:, 1:2]
    found = product(*(np.concatenate(pair, -1).astype(dtype) for pair in ((s1, a), (s2, b))))
    scalar = s1 * s2 - np.sum(a * b, -1, keepdims=True)
    expected = np.concatenate([scalar, s1 * b + s2 * a + np.cross(a, b)], -1)
    assert largest(found - expected) < tolerance(float64=2e-15, float32=2e-6)


def test_square_of_a_pure_quaternion_is_minus_its_squared_length(dtype):
    assert np.asarray(product(*[np.asarray([0, 1, 2, 3], dtype)] * 2)).tolist() == [-14, 0, 0, 0]


def test_norm_is_multiplicative_and_inverse_is_conjugate_over_squared_norm(dtype, tolerance):
    small = tolerance(float64=4e-15, float32=2e-6)
    a, b = np.random.default_rng(1).normal(size=(2, 30, 4)).astype(dtype)
    norms = np.linalg.norm(product(a, b), axis=-1)
    assert largest(norms / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)) - 1) < small
    inverse = Quaternion(a).inverse().wxyz
    assert largest(inverse - Quaternion(a).conjugate().wxyz / np.sum(a**2, -1, keepdims=True)) < small
    assert largest(product(a, inverse) - np.eye(4)[0]) < small


def test_rotation_is_the_sandwich_product(vectors, dtype, tolerance):
    """q p q⁻¹, and the unit quaternion is [cos θ/2, u sin θ/2]."""
    q = Quaternion.exp(vectors[0])
    p = jnp.concatenate([jnp.zeros((20, 1), dtype), vectors[1]], -1)
    sandwich = product(product(q.wxyz, p), q.inverse().wxyz)
    assert largest(sandwich[:, 0]) < tolerance(float64=1e-15, float32=1e-6)
    assert largest(sandwich[:, 1:] - q.rotate(vectors[1])) < tolerance(float64=4e-15, float32=3e-6)
    angle = np.linalg.norm(vectors[0].astype(np.float64), axis=-1, keepdims=True)
    expected = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * vectors[0] / angle], -1)
    assert largest(q.wxyz - expected) < tolerance(float64=1e-15, float32=3e-7)


def test_star_operator_is_the_matrix_of_the_cross_product(vectors, tolerance):
    small = tolerance(float64=2e-15, float32=1e-6)
    v, b, _ = vectors
    star = np.asarray(hat(v))
    assert largest(star + np.swapaxes(star, -1, -2)) == 0
    assert largest(np.einsum("kij,kj->ki", star, b) - np.cross(v, b)) < small
    assert largest(cross(v, b) - np.cross(v, b)) < small
    assert largest(vee(star) - v) == 0


def test_star_of_a_rotated_vector_is_the_rotated_star(vectors, tolerance):
    """(R v)* = R v* Rᵀ."""
    r = Quaternion.exp(vectors[0])
    m = np.asarray(r.as_matrix(), np.float64)
    expected = m @ np.asarray(hat(vectors[1]), np.float64) @ np.swapaxes(m, -1, -2)
    assert largest(hat(r.rotate(vectors[1])) - expected) < tolerance(float64=4e-15, float32=3e-6)


def test_star_operators_commute_to_the_star_of_the_cross_product(vectors, tolerance):
    """a* b* − b* a* = (a × b)*: the Lie algebra of rotations."""
    a, b, _ = vectors
    one, other = np.asarray(hat(a)), np.asarray(hat(b))
    assert largest(one @ other - other @ one - hat(cross(a, b))) < tolerance(float64=4e-15, float32=2e-6)


def test_vee_of_any_matrix_is_the_vector_of_its_skew_part(dtype):
    m = np.arange(9, dtype=dtype).reshape(3, 3) ** 2
    assert largest(hat(vee(m)) - 0.5 * (m - m.T)) == 0


def test_matrix_algebra_by_components_equals_numpy(vectors, dtype, tolerance):
    small = tolerance(float64=1e-13, float32=1e-4)
    a, b = np.random.default_rng(3).normal(size=(2, 20, 3, 3)).astype(dtype)
    v = vectors[0]
    assert largest(matmul(a, b) - a @ b) < small
    assert largest(matvec(a, v) - np.einsum("kij,kj->ki", a, v)) < small
    assert largest(dot(v, v) - np.sum(v * v, -1)) < small
    assert largest(determinant(a) - np.linalg.det(a)) < small
    expected = np.linalg.det(a)[:, None, None] * np.swapaxes(np.linalg.inv(a), -1, -2)
    assert largest((cofactors(a) - expected) / np.abs(expected).max(axis=(1, 2), keepdims=True)) < small
    solved = np.asarray(solve(tuple(a[:, :, i] for i in range(3)), v))
    assert largest(np.einsum("kij,kj->ki", a, solved) - v) < small
