"""A run's own estimate of its error against the truth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb

COUNT, DURATION = 200, 20.0
METHODS = {rb.ExplicitEuler: 6400, rb.RungeKutta4: 400, rb.VelocityVerlet: 800, rb.ImplicitMidpoint: 1600}


@pytest.fixture(scope="module")
def tumblers():
    """200 random bodies with random spins, and where they end."""
    random = np.random.default_rng(0)
    second = random.uniform(0.05, 1.0, (COUNT, 3))
    inertia = second.sum(axis=1, keepdims=True) - second
    scene = rb.Scene(jax.vmap(rb.Body)(np.ones(COUNT), inertia))
    spin = (random.normal(size=(COUNT, 3)) * random.uniform(0.3, 3.0, (COUNT, 1))).tolist()
    state = scene.state(angular_velocity=spin)
    return scene, spin, rb.free_flight(scene, state, DURATION)


def true_errors(end, path):
    return np.asarray(end.orientation.angle_to(path.final.orientation.normalise()))


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)
def test_estimate_is_within_a_factor_of_five_and_never_flatters(tumblers, dtype, method):
    if dtype == jnp.float32:
        pytest.skip("the errors of these runs lie below the round-off of float32, which is tested below")
    scene, spin, end = tumblers
    state, steps = scene.state(angular_velocity=spin), METHODS[method]
    claims = 0
    for tolerance in (1e-1, 1e-2, 1e-3, 1e-5, 1e-7):
        path = rb.rollout(
            scene, state, dt=DURATION / steps, steps=steps, save_every=steps // 8, method=method(),
            tolerance=tolerance, on_error="flag",
        )  # fmt: skip
        met, truth = np.asarray(path.certificate.met), true_errors(end, path)
        claims += met.sum()
        assert not np.any(met & (truth > 2 * tolerance))
    ratio = np.asarray(path.certificate.attitude_error) / truth
    inside = np.mean((ratio > 0.2) & (ratio < 5.0))
    print(
        f"{method.__name__}, {steps} steps: {inside:.1%} within a factor of 5, median ratio {np.median(ratio):.2f}"
    )
    assert inside >= 0.95
    assert claims > 0


def test_energy_error_has_the_sign_of_the_drift(tumblers, tolerance):
    scene, spin, _ = tumblers
    state = scene.state(angular_velocity=spin)
    for method, sign in ((rb.RungeKutta4(), -1), (rb.ExplicitEuler(), 1)):
        steps = 400 if sign < 0 else 6400
        path = rb.rollout(
            scene, state, dt=DURATION / steps, steps=steps, save_every=steps // 8, method=method, certify=True
        )
        drift = float(rb.energy(scene, path.final) - rb.energy(scene, state))
        assert np.sign(drift) == sign
        assert float(path.certificate.energy_error) == pytest.approx(drift, rel=0.5)


def test_drift_vector_points_ahead_where_the_run_is_ahead(tolerance):
    # The implicit midpoint rule turns a quaternion by 4 atan(ω dt/4) a step: less than ω dt, so the run lags.
    scene = rb.Scene(rb.Body(1.0, 1.0))
    state = scene.state(angular_velocity=(0, 0, 2.0))
    path = rb.rollout(
        scene, state, dt=0.05, steps=400, save_every=100, method=rb.ImplicitMidpoint(), certify=True
    )
    lag = 400 * (4 * np.arctan(0.1 / 4) - 0.1)
    np.testing.assert_allclose(path.certificate.attitude_drift[0], (0, 0, lag), rtol=2e-2, atol=1e-5)
    assert bool(path.certificate.reliable[0])


def test_run_of_single_precision_knows_its_round_off(dtype):
    if dtype == jnp.float64:
        pytest.skip("float32 only")
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 2.5)))
    path = rb.rollout(
        scene,
        scene.state(angular_velocity=(0.3, 1.0, 0.2)),
        dt=1e-3,
        steps=20_000,
        save_every=1000,
        certify=True,
    )
    assert 1e-6 < float(path.certificate.attitude_error[0]) < 1e-2


def test_certificate_sees_springs_and_held_points(tolerance):
    top = rb.Scene(rb.Body(1.0, (0.5, 0.6, 0.3)), (rb.UniformGravity(), rb.FixedPoint(point=(0, 0, -0.3))))
    start = top.state(orientation=(0.9, 0.3, 0.2, np.sqrt(1 - 0.94)), angular_velocity=(0, 0, 6.0))
    coarse = rb.rollout(top, start, dt=0.02, steps=200, save_every=20, tolerance=0.05)
    fine = rb.rollout(top, start, dt=0.001, steps=4000, save_every=4000).final
    found, true = coarse.certificate, float(np.linalg.norm(coarse.final.position - fine.position))
    assert true / 5 < float(found.position_error[0]) < 5 * true
    assert bool(found.met[0])


def test_what_cannot_be_compared_is_refused():
    scene = rb.Scene(rb.Body(1.0, 1.0))
    with pytest.raises(rb.InvalidInput, match="nothing to compare"):
        rb.rollout(scene, scene.state(), dt=0.1, steps=3, certify=True)
    with pytest.raises(rb.WrongStructure, match="PrescribedTorque"):
        rb.rollout(scene, scene.state(), dt=0.1, steps=8, torque=np.zeros((8, 1, 3)), certify=True)
    for tolerance in (0.0, -1.0, 1.0, float("nan")):
        with pytest.raises(rb.InvalidInput, match="tolerance"):
            rb.rollout(scene, scene.state(), dt=0.1, steps=8, tolerance=tolerance)
