"""Splitting methods at the edges: rest, effects that depend on velocity, kinds of inertia, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.body.euler_equation import solver
from jaxrb.integrators import METHODS
from jaxrb.integrators.principal_frame import principal_frame

NAMES = ["ThreeAxisSplitting", "ThreeAxisSplitting4", "MoserVeselov4"]
FULL = np.array([[1.0, 0.1, 0.05], [0.1, 2.0, 0.1], [0.05, 0.1, 2.5]])


@pytest.mark.parametrize(
    ("name", "inertia"),
    [
        ("ThreeAxisSplitting", 1.5),
        ("ThreeAxisSplitting", (1.0, 1.0, 2.0)),
        ("ThreeAxisSplitting", FULL),
        ("MoserVeselov4", (1.0, 1.0, 2.0)),
        ("MoserVeselov4", FULL),
    ],
    ids=["splitting sphere", "splitting symmetric", "splitting full", "moser symmetric", "moser full"],
)
def test_gradient_is_finite_at_rest_and_right_in_motion(name, inertia, tolerance):
    @jax.jit
    def end(moments, omega):
        scene = rb.Scene(rb.Body(1.0, moments))
        still = scene.state(rotation=rb.Quaternion)
        state = rb.State(still.position, still.orientation, still.velocity, omega[None], still.time)
        return rb.step(scene, state, None, 0.2, method=METHODS[name]()).orientation.wxyz[0, 1]

    moments = jnp.asarray(np.asarray(inertia).tolist())
    gradient = jax.jit(jax.grad(end, (0, 1)))
    assert all(np.isfinite(g).all() for g in gradient(moments, jnp.zeros(3)))
    omega = jnp.asarray([0.3, 0.9, -0.4])
    found = gradient(moments, omega)
    h = tolerance(float64=1e-5, float32=2e-2)
    way = jnp.asarray([1.0, -2.0, 0.5])
    difference = (end(moments, omega + h * way) - end(moments, omega - h * way)) / (2 * h)
    assert float(difference) == pytest.approx(
        float(found[1] @ way), rel=tolerance(float64=1e-7, float32=2e-2)
    )
    assert np.isfinite(found[0]).all()


@pytest.mark.parametrize("name", NAMES)
def test_drag_is_met_at_the_order_of_the_method(name, dtype):
    if dtype == jnp.float32:
        pytest.skip("round-off of float32 hides the order")
    method = METHODS[name]()
    scene = rb.Scene(
        rb.Body(1.0, (1.0, 2.0, 2.5)), (rb.UniformGravity(), rb.QuadraticDrag(coefficient=0.4, area=1.0))
    )
    state = scene.state(velocity=[(3.0, 0.0, 4.0)], angular_velocity=[(1.0, 0.5, 0.2)])
    exact = rb.rollout(scene, state, dt=2e-3, steps=500, save_every=500).final.velocity

    def error(steps):
        path = rb.rollout(scene, state, dt=1 / steps, steps=steps, save_every=steps, method=method)
        return float(jnp.abs(path.final.velocity - exact).max())

    # 3.6 here, 3.9 at finer steps: what the rounds of the last kick leave is of the order of the method itself.
    assert np.log2(error(20) / error(40)) > method.order - 0.5


def test_a_torque_alone_turns_a_body_at_rest(dtype, tolerance):
    """Without a force, and about a principal axis: ω = τt/I and the angle τt²/2I, whatever the splitting."""
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 2.5)), rb.PrescribedTorque((0.0, 0.6, 0.0)))
    state = scene.state(rotation=rb.Quaternion)
    end = rb.rollout(scene, state, dt=0.1, steps=10, save_every=10, method="ThreeAxisSplitting").final
    small = tolerance(float64=1e-14, float32=1e-6)
    np.testing.assert_allclose(end.angular_velocity[0], [0.0, 0.3, 0.0], atol=small)
    np.testing.assert_allclose(end.orientation.log()[0], [0.0, 0.15, 0.0], atol=small)


@pytest.mark.parametrize("kind", ["principal", "full"])
def test_rounds_of_moser_and_veselov_reach_round_off_for_half_a_radian_a_step(kind, dtype, tolerance):
    """What they leave shows in the energy; a fault in their Jacobian leaves ten thousand times as much."""
    random = np.random.default_rng(2)
    moments = random.uniform(1.0, 1.9, (100, 3))
    axes = random.normal(size=(100, 3))
    omega = jnp.asarray(0.5 * axes / np.linalg.norm(axes, axis=1, keepdims=True), dtype)
    inertia = rb.PrincipalInertia(jnp.asarray(moments, dtype))
    if kind == "full":
        turns = np.linalg.qr(random.normal(size=(100, 3, 3)))[0]
        tensors = np.einsum("nik,nk,njk->nij", turns, moments, turns)
        inertia = rb.FullInertia(jnp.asarray(tensors[:, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)], dtype))
    later = jax.jit(rb.MoserVeselov().turn_freely)(solver(inertia), omega, 1.0)[1]
    before, after = (jnp.sum(w * inertia.apply(w), axis=-1) for w in (omega, later))
    assert float(jnp.abs(after / before - 1.0).max()) < tolerance(float64=1e-15, float32=6e-7)


def test_principal_axes_are_those_of_the_tensor_and_of_a_diagonal_one_the_identity(dtype, tolerance):
    """Also at two and three equal moments, where any axes in their plane would do."""
    random = np.random.default_rng(4)
    moments = np.array(
        [[1.0, 1.5, 2.0], [1.0, 1.0, 1.7], [1.3, 1.0, 1.0], [2.0, 2.0, 2.0], [1.0, 1.000001, 1.5]]
    )
    turns = np.concatenate([np.linalg.qr(random.normal(size=(5, 3, 3)))[0], np.tile(np.eye(3), (5, 1, 1))])
    tensors = np.einsum("nik,nk,njk->nij", turns, np.tile(moments, (2, 1)), turns)
    six = jnp.asarray(tensors[:, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)], dtype)
    axes = np.asarray(jax.jit(jax.vmap(principal_frame))(six), np.float64)
    small = tolerance(float64=4e-15, float32=2e-6)
    np.testing.assert_allclose(
        np.einsum("nji,njk->nik", axes, axes), np.tile(np.eye(3), (10, 1, 1)), atol=small
    )
    seen = np.einsum("nji,njk,nkl->nil", axes, tensors, axes)
    np.testing.assert_allclose(seen * (1 - np.eye(3)), 0.0, atol=small)
    np.testing.assert_array_equal(axes[5:], np.tile(np.eye(3), (5, 1, 1)))
