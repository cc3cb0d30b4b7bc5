"""Rotations without trigonometric functions, and the small change that a turn makes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.math.rational import turn

ANGLES = np.array([0.0, 1e-12, 1e-3, 0.1, 1.0, np.pi / 2, 3.0, 4.0])
AXIS = np.array([2.0, -3.0, 6.0]) / 7.0


def test_rational_turn_is_the_exponential(tolerance):
    vectors = jnp.asarray((ANGLES[:, None] * AXIS).tolist())
    np.testing.assert_allclose(
        turn(vectors), rb.Quaternion.exp(vectors).wxyz, atol=tolerance(float64=1e-15, float32=5e-7)
    )


def test_turn_of_a_tangent_is_the_exponential_of_twice_its_arctangent(tolerance):
    lengths = np.tan(np.array([0.0, 1e-9, 1e-3, 0.1, 0.5, 1.0, 1.5]))
    found = rb.Quaternion.of_tangent(jnp.asarray((lengths[:, None] * AXIS).tolist())).wxyz
    wanted = rb.Quaternion.exp(jnp.asarray((2 * np.arctan(lengths)[:, None] * AXIS).tolist())).wxyz
    np.testing.assert_allclose(found, wanted, atol=tolerance(float64=1e-15, float32=5e-7))


def test_rational_turn_has_length_one_at_any_angle(tolerance):
    vectors = jnp.asarray((np.array([0.0, 1.0, 10.0, 1e3])[:, None] * AXIS).tolist())
    np.testing.assert_allclose(
        jnp.sum(turn(vectors) ** 2, axis=-1), 1.0, atol=tolerance(float64=2e-15, float32=1e-6)
    )


def test_rational_turn_is_smooth_at_zero():
    zero = jnp.zeros(3)
    jacobian = jax.jacobian(turn)(zero)
    np.testing.assert_allclose(jacobian, np.vstack([np.zeros(3), 0.5 * np.eye(3)]), atol=1e-7)
    assert np.isfinite(jax.jacobian(jax.jacobian(turn))(zero)).all()


@pytest.mark.parametrize("kind", [rb.Quaternion, rb.RotationMatrix])
def test_turned_is_the_product_and_projects(kind, tolerance):
    small = tolerance(float64=1e-15, float32=5e-7)
    start = kind.exp(jnp.asarray([0.3, -0.2, 0.9]))
    wxyz = turn(jnp.asarray([0.01, 0.02, -0.03]))
    expected = (start @ kind.from_rotation(rb.Quaternion(wxyz))).as_matrix()
    np.testing.assert_allclose(start.turned(wxyz, renormalise=False).as_matrix(), expected, atol=3 * small)
    swollen = jax.tree.map(lambda x: 1.0001 * x, start)
    assert abs(float(swollen.turned(wxyz, renormalise=True).drift().scale)) < 1e-7
    assert abs(float(swollen.turned(wxyz, renormalise=False).drift().scale)) > 9e-5


def test_change_of_a_small_turn_is_relatively_exact(tolerance):
    tiny = rb.Quaternion(turn(jnp.asarray([1e-6, 0.0, 0.0])))
    change = tiny.unrotation_change(jnp.asarray([1.0, 1.0, 1.0]))
    np.testing.assert_allclose(change[1], 1e-6, rtol=1e-6 + tolerance(float64=1e-12, float32=1e-6))
