"""The reverse pass that runs the method backwards."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import jaxrb as rb

STEPS = 400


@pytest.fixture(scope="module")
def losses():
    """The same loss with both adjoints, as functions of the scene's and the state's numbers; compiled once."""
    scene = rb.Scene(
        rb.replicate(rb.Body(2.0, (1.0, 2.0, 2.5)), 3), rb.LinearDrag(0.2, angular_coefficient=0.1)
    )
    spins = np.random.default_rng(0).normal(size=(3, 3)).tolist()
    state = scene.state(position=[(0, 0, 0), (1, 0, 0), (2, 0, 0)], angular_velocity=spins)
    numbers, unravel = ravel_pytree((scene, state))

    def loss(numbers, adjoint, steps=STEPS):
        scene, state = unravel(numbers)
        method = rb.ImplicitMidpoint(sweeps=3)
        path = rb.rollout(
            scene, state, dt=5e-3, steps=steps, save_every=steps // 4, method=method, adjoint=adjoint
        )
        return jnp.sum(path.final.orientation.wxyz[:, 0]) + jnp.sum(path.states.position**2)

    return numbers, loss


def test_both_adjoints_agree(losses, tolerance):
    numbers, loss = losses
    stored = jax.jit(jax.grad(lambda x: loss(x, "checkpoint")))(numbers)
    undone = jax.jit(jax.grad(lambda x: loss(x, "reversible")))(numbers)
    scale = float(jnp.abs(stored).max())
    np.testing.assert_allclose(undone, stored, atol=scale * tolerance(float64=1e-9, float32=1e-3))
    assert float(loss(numbers, "checkpoint")) == pytest.approx(float(loss(numbers, "reversible")), rel=1e-6)


def test_a_splitting_is_undone_to_round_off_under_gravity(tolerance):
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 2.5)), (rb.UniformGravity(), rb.FixedPoint((0.0, 0.1, -0.3))))
    state = scene.state(angular_velocity=[(0.3, 1.0, 0.2)])

    def loss(scene, adjoint):
        path = rb.rollout(
            scene, state, dt=0.02, steps=200, save_every=100, method=rb.ThreeAxisSplitting(), adjoint=adjoint
        )
        return path.final.orientation.wxyz[0, 1]

    gradient = jax.jit(jax.grad(loss), static_argnums=1)
    stored, undone = (ravel_pytree(gradient(scene, adjoint))[0] for adjoint in ("checkpoint", "reversible"))
    scale = float(jnp.abs(stored).max())
    np.testing.assert_allclose(undone, stored, atol=scale * tolerance(float64=1e-11, float32=1e-3))


def test_memory_does_not_grow_with_the_steps(losses):
    numbers, loss = losses

    def memory(steps):
        gradient = jax.jit(jax.grad(lambda x: loss(x, "reversible", steps)))
        return gradient.lower(numbers).compile().memory_analysis().temp_size_in_bytes

    assert memory(40_000) <= 1.1 * memory(400)


def test_methods_that_cannot_be_undone_are_refused():
    scene = rb.Scene(rb.Body(1.0, 1.0))
    with pytest.raises(rb.WrongStructure, match="ImplicitMidpoint"):
        rb.rollout(scene, scene.state(), dt=0.1, steps=4, adjoint="reversible")
    with pytest.raises(rb.WrongStructure, match="adjoint"):
        rb.rollout(scene, scene.state(), dt=0.1, steps=4, adjoint="stored")
