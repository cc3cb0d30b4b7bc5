"""What rounding takes from long sums, and that a compensated run gets it back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb

STEPS = 100_000
DT = 2.0**-10  # [s], exact in both precisions


@pytest.fixture(scope="module", params=[rb.Quaternion, rb.RotationMatrix], ids=lambda r: r.__name__)
def tumbling(request, dtype):
    """States after 1e5 steps of an asymmetric body: plain, compensated, and exact in float64."""
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 3.0)))
    start = {"angular_velocity": [(0.25, 0.125, 1.0)], "velocity": [(0.1, -0.2, 0.3)]}
    state = scene.state(**start, rotation=request.param, dtype=dtype)
    plain, kept = (
        rb.rollout(
            scene, state, dt=DT, steps=STEPS, save_every=STEPS, method=rb.RungeKutta4(compensated=compensated)
        ).final
        for compensated in (False, True)
    )
    with jax.enable_x64(True):
        exact = rb.free_flight(scene, scene.state(**start, dtype=np.float64), STEPS * DT)
        exact = jax.tree.map(np.asarray, exact)
    return plain, kept, exact


def attitude_off(state, exact):
    wxyz = np.asarray(state.orientation.as_quaternion_array(), float)
    wxyz = wxyz / np.linalg.norm(wxyz)
    there = exact.orientation.wxyz
    return 2 * min(np.linalg.norm(wxyz - there), np.linalg.norm(wxyz + there))


def test_attitude_after_a_hundred_thousand_steps(tumbling, tolerance, dtype):
    plain, kept, exact = tumbling
    print(
        f"attitude error [rad]: plain {attitude_off(plain, exact):.2e}, kept {attitude_off(kept, exact):.2e}"
    )
    assert attitude_off(kept, exact) < tolerance(float64=1e-9, float32=5e-5)
    if dtype == jnp.float32:
        assert attitude_off(plain, exact) > 10 * attitude_off(kept, exact)


def test_uniform_motion_is_summed_to_the_last_digit(tumbling, dtype):
    plain, kept, _ = tumbling
    velocity = np.asarray([0.1, -0.2, 0.3], dtype).astype(float)
    off = np.abs(np.asarray(kept.position[0], float) / (velocity * STEPS * DT) - 1.0).max()
    assert off < 2 * np.finfo(dtype).eps
    assert np.abs(np.asarray(plain.position[0], float) / (velocity * STEPS * DT) - 1.0).max() > 10 * off


def test_compensation_keeps_the_derivative(tolerance, dtype):
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 3.0)), rb.UniformGravity())

    def turn(omega, compensated):
        state = scene.state(angular_velocity=omega, dtype=dtype)
        method = rb.RungeKutta4(compensated=compensated)
        return rb.rollout(scene, state, dt=0.01, steps=20, method=method).final.orientation.wxyz[0, 1]

    omega = jnp.asarray([[0.3, 1.0, 0.2]], dtype)
    plain, kept = (jax.grad(turn)(omega, compensated) for compensated in (False, True))
    np.testing.assert_allclose(kept, plain, atol=tolerance(float64=1e-13, float32=2e-6))


def test_a_single_step_that_would_lose_the_remainder_is_refused():
    scene = rb.Scene(rb.Body(1.0, 1.0))
    with pytest.raises(rb.WrongStructure, match="rollout"):
        rb.step(scene, scene.state(), method=rb.RungeKutta4(compensated=True))
