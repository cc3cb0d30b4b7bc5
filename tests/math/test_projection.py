"""Back to an exact rotation: renormalising quaternions, orthogonalising matrices, and the drift that calls for it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import largest, rotation_vectors

from jaxrb import Quaternion, RotationMatrix


@pytest.fixture(scope="module")
def perturbed(dtype):
    """`perturbed(δ)`: matrices and quaternions with a relative defect of that size in every number."""
    vectors = rotation_vectors(dtype)
    draw = np.random.default_rng(0)
    noise, shift = draw.uniform(-1, 1, (len(vectors), 3, 3)), draw.uniform(-1, 1, (len(vectors), 4))
    m, q = RotationMatrix.exp(vectors).matrix, Quaternion.exp(vectors).wxyz

    def at(defect):
        return RotationMatrix((m + defect * noise).astype(dtype)), Quaternion(
            (q + defect * shift).astype(dtype)
        )

    return at


@pytest.fixture(scope="module")
def project():
    """The projections, compiled once."""
    names = ("normalise", "renormalise", "polar", "gram_schmidt")
    return {name: jax.jit(lambda r, name=name: getattr(r, name)()) for name in names}


def polar_by_svd(matrix) -> np.ndarray:
    """U Vᵀ: the nearest rotation in the Frobenius norm."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, np.float64))
    return u @ vt


@pytest.mark.parametrize("defect", [0.0, 1e-6, 1e-2, 0.2])
def test_nearest_rotation_is_the_polar_factor(perturbed, project, tolerance, defect):
    matrix, _ = perturbed(defect)
    small = tolerance(float64=1e-14, float32=2e-6)
    assert largest(project["polar"](matrix).matrix - polar_by_svd(matrix.matrix)) < small
    assert largest(project["normalise"](matrix).matrix - polar_by_svd(matrix.matrix)) < small


@pytest.mark.parametrize("defect", [1e-2, 0.2])
def test_gram_schmidt_orthonormalises_and_keeps_the_first_axis(perturbed, project, tolerance, defect):
    small = tolerance(float64=2e-15, float32=1e-6)
    matrix, _ = perturbed(defect)
    found = np.asarray(project["gram_schmidt"](matrix).matrix, np.float64)
    assert largest(np.swapaxes(found, -1, -2) @ found - np.eye(3)) < small
    assert largest(np.linalg.det(found) - 1) < small
    first = np.asarray(matrix.matrix, np.float64)[..., 0]
    assert largest(found[..., 0] - first / np.linalg.norm(first, axis=-1, keepdims=True)) < small
    # The second stays in the plane of the first two.
    assert largest(np.linalg.det(np.stack([found[..., 0], found[..., 1], matrix.matrix[..., 1]], -1))) < small


def test_renormalising_a_matrix_leaves_the_square_of_the_defect(perturbed, project, dtype, tolerance):
    """One Newton–Schulz step; halving δ divides what is left by four, and the nearest rotation is not moved away."""
    large = tolerance(float64=1e-3, float32=4e-2)
    left, moved = [], []
    for defect in (large, 0.5 * large):
        matrix, _ = perturbed(defect)
        found = np.asarray(project["renormalise"](matrix).matrix, np.float64)
        left.append(np.abs(np.swapaxes(found, -1, -2) @ found - np.eye(3)).max(axis=(1, 2)))
        moved.append(np.abs(found - polar_by_svd(matrix.matrix)).max(axis=(1, 2)))
    assert left[0].max() < 20 * large**2
    assert 3.5 < np.median(left[0] / left[1]) < 4.5
    assert 3.5 < np.median(moved[0] / moved[1]) < 4.5


def test_renormalising_a_quaternion_is_exact(perturbed, project, tolerance):
    small = tolerance(float64=1e-15, float32=3e-7)
    for defect in (1e-6, 0.1):
        _, q = perturbed(defect)
        given = np.asarray(q.wxyz, np.float64)
        expected = given / np.linalg.norm(given, axis=-1, keepdims=True)
        assert largest(project["renormalise"](q).wxyz - expected) < small
        assert largest(project["normalise"](q).wxyz - expected) < small


@pytest.mark.parametrize("name", ["normalise", "renormalise"])
def test_projection_leaves_exact_rotations_alone(perturbed, project, tolerance, name):
    for rotation in perturbed(0.0):
        found = project[name](rotation)
        assert largest(found.as_matrix() - rotation.as_matrix()) < tolerance(float64=2e-15, float32=1e-6)


def test_quaternion_that_shrank_to_nothing_is_not_repaired_in_silence(dtype):
    zero = Quaternion(np.zeros(4, dtype))
    assert not np.isfinite(np.asarray(zero.renormalise().wxyz)).any()


def test_drift_measures_breathing_scaling_and_skewing(dtype, tolerance):
    """A quaternion breathes, a matrix grows evenly or skews: the lecture's comparison of representations."""
    small = tolerance(float64=2e-15, float32=1e-6)
    vectors = rotation_vectors(dtype)
    q, m = Quaternion.exp(vectors), RotationMatrix.exp(vectors)
    for exact in (q.drift(), m.drift()):
        assert largest(exact.scale) < small
        assert largest(exact.skew) < small
    breathed, grown = Quaternion(q.wxyz * 1.01).drift(), RotationMatrix(m.matrix * 1.01).drift()
    assert largest(breathed.scale - 0.01) < small
    assert largest(grown.scale - 0.01) < small
    assert largest(grown.skew) < small
    shear = np.eye(3)
    shear[0, 1] = 0.02
    skewed = RotationMatrix(m.matrix @ shear.astype(dtype)).drift()
    assert largest(skewed.skew - 0.02 / np.hypot(1, 0.02)) < 2 * small


@pytest.mark.parametrize("angle", [0.1, 1.6, 3.0])
@pytest.mark.parametrize("kind", [Quaternion, RotationMatrix], ids=lambda k: k.__name__)
def test_turned_projects_the_product_whatever_the_angle(kind, angle, dtype, tolerance):
    """Drift leaves quadratically, at large turns too, where a projection of the factor would make it grow."""
    step = Quaternion.exp(angle * jnp.asarray([0.36, -0.48, 0.8], dtype)).wxyz
    rotation = jax.tree.map(
        lambda x: x * jnp.asarray(1.01, dtype), kind.exp(jnp.asarray([0.3, 0.2, -0.5], dtype))
    )
    after = [rotation := rotation.turned(step, renormalise=True) for _ in range(40)]
    assert float(jnp.abs(after[0].drift().scale)) < 4e-4  # 1.5 · 0.01², for the matrix with three axes
    assert float(jnp.abs(after[-1].drift().scale)) < tolerance(float64=2e-15, float32=1e-6)
