"""diffrax's solvers on the scene's equations."""

import diffrax
import jax
import numpy as np
import pytest

import jaxrb as rb

BRICK = rb.Body(mass=2.0, inertia=(1.0, 2.0, 2.5))


@pytest.fixture(scope="module")
def scene():
    return rb.Scene(BRICK, (rb.UniformGravity(), rb.LinearDrag(0.1, angular_coefficient=0.05)))


@pytest.fixture(scope="module")
def start(scene):
    return scene.state(velocity=(1.0, 0.0, 5.0), angular_velocity=(0.3, 1.0, 0.2))


@pytest.mark.parametrize("rotation", [rb.Quaternion, rb.RotationMatrix], ids=lambda r: r.__name__)
def test_solve_agrees_with_rollout(scene, rotation, tolerance):
    state = scene.state(velocity=(1.0, 0.0, 5.0), angular_velocity=(0.3, 1.0, 0.2), rotation=rotation)
    rtol = tolerance(float64=1e-10, float32=1e-5)
    solved = rb.solve(
        scene, state, t1=2.0, solver=diffrax.Tsit5(), rtol=rtol, atol=rtol, torque=(0.1, 0.0, 0.0)
    )
    rolled = rb.rollout(scene, state, dt=0.01, steps=200, torque=(0.1, 0.0, 0.0))
    limit = tolerance(float64=1e-8, float32=2e-4)
    np.testing.assert_allclose(solved.final.position, rolled.final.position, atol=limit)
    assert float(solved.final.orientation.angle_to(rolled.final.orientation)[0]) < limit
    assert float(np.abs(solved.final.orientation.drift().scale[0])) < tolerance(float64=1e-14, float32=1e-6)


def test_saves_at_the_times_asked_for(scene, start, tolerance):
    times = np.array([0.0, 0.25, 1.0], np.float32).tolist()
    rtol = tolerance(float64=1e-10, float32=1e-5)
    path = rb.solve(scene, start, t1=1.5, times=times, rtol=rtol, atol=rtol)
    np.testing.assert_allclose(path.times, times)
    rolled = rb.rollout(scene, start, dt=0.01, steps=150, save_every=25)
    np.testing.assert_allclose(
        path.states.position[:, 0],
        rolled.states.position[[0, 1, 4], 0],
        atol=tolerance(float64=1e-8, float32=2e-4),
    )
    assert float(path.final.time) == pytest.approx(1.5)


def test_run_that_stops_early_is_an_error_not_a_short_result(scene, start):
    with pytest.raises(rb.RunFailed, match="max_steps"):
        rb.solve(scene, start, t1=10.0, max_steps=3, rtol=1e-6, atol=1e-6)
    path = rb.solve(scene, start, t1=10.0, max_steps=3, rtol=1e-6, atol=1e-6, on_error="flag")
    assert not bool(path.status.ok)


def test_solve_is_differentiable(scene, start, tolerance):
    rtol = tolerance(float64=1e-10, float32=1e-5)

    @jax.jit
    def height(speed):
        state = rb.State(
            start.position,
            start.orientation,
            start.velocity.at[0, 2].set(speed),
            start.angular_velocity,
            start.time,
        )
        return rb.solve(scene, state, t1=1.0, rtol=rtol, atol=rtol).final.position[0, 2]

    # ż = v e^(−kt): ∂z(1)/∂v = (1 − e^(−k))/k with k = c/m
    k = 0.05
    assert float(jax.grad(height)(5.0)) == pytest.approx(
        (1 - np.exp(-k)) / k, rel=tolerance(float64=1e-7, float32=1e-3)
    )


def test_wrong_settings_are_refused(scene, start):
    with pytest.raises(rb.WrongStructure, match="solver of diffrax"):
        rb.solve(scene, start, t1=1.0, solver=rb.RungeKutta4())
    with pytest.raises(rb.InvalidInput, match="ascending"):
        rb.solve(scene, start, t1=1.0, times=[0.5, 0.2])
    for t1 in (0.0, -1.0, float("nan")):
        with pytest.raises(rb.InvalidInput, match="t1"):
            rb.solve(scene, start, t1=t1)
    for wrong in ({"t1": "soon"}, {"t1": (1.0, 2.0)}, {"t1": 1.0, "times": "often"}):
        with pytest.raises(rb.WrongStructure, match=list(wrong)[-1]):
            rb.solve(scene, start, **wrong)


@pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"), reason="one program; the digits are those of float64"
)
def test_implicit_solvers_of_diffrax_are_taken():
    """They hold functions and marks beside their numbers; the end is that of an explicit one, and has a derivative."""
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 2.5)), (rb.UniformGravity(), rb.LinearDrag(50.0)))
    state = scene.state(velocity=(1.0, 0.0, 0.0), angular_velocity=(0.1, 1.0, 0.1))

    def end(velocity):
        start = scene.state(velocity=velocity, angular_velocity=(0.1, 1.0, 0.1))
        position = rb.solve(
            scene, start, t1=0.5, solver=diffrax.Kvaerno5(), rtol=1e-8, atol=1e-10
        ).final.position[0]
        return position[0], position

    explicit = rb.solve(scene, state, t1=0.5, rtol=1e-10, atol=1e-12).final.position[0]
    (_, implicit), slope = jax.value_and_grad(end, has_aux=True)(state.velocity[0])
    np.testing.assert_allclose(implicit, explicit, atol=1e-8)
    assert abs(float(slope[0]) - (1 - np.exp(-25.0)) / 50.0) < 1e-8
