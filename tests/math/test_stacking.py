"""The two primitives under every transformation of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrb.math.stacking import components, stack


@pytest.fixture(scope="module")
def sample(dtype):
    return jnp.asarray(np.random.default_rng(0).normal(size=(2, 5, 3)), dtype)


def test_components_undo_stack(sample):
    np.testing.assert_array_equal(stack(*components(sample)), sample)
    np.testing.assert_array_equal(
        stack(*components(sample)), jnp.stack([sample[..., i] for i in range(3)], axis=-1)
    )


@pytest.mark.parametrize("axis", [0, 1])
def test_vmap_over_any_axis(sample, axis):
    def turned(v):
        a, b, c = components(v)
        return stack(c * a, a, b)

    np.testing.assert_array_equal(jax.vmap(turned, in_axes=axis, out_axes=axis)(sample), turned(sample))


def test_vmap_over_some_parts(sample):
    other = jnp.ones(5, sample.dtype)
    mapped = jax.vmap(lambda v: stack(v, other))(sample[..., 0])
    np.testing.assert_array_equal(mapped, jnp.stack([sample[..., 0], jnp.ones((2, 5))], axis=-1))


def test_derivatives_of_both_modes_and_second_order(sample, dtype):
    def function(v):
        a, b, c = components(v)
        return jnp.sum(jnp.sin(stack(a * b, c * c * a, b, jnp.zeros_like(a))) ** 2)

    tolerance = 1e-5 if dtype == jnp.float64 else 5e-2
    check_grads(function, (sample,), order=2, modes=("fwd", "rev"), atol=tolerance, rtol=tolerance)
    check_grads(
        lambda v: function(jax.vmap(lambda w: w)(v)), (sample,), order=1, modes=("rev",), atol=0.1, rtol=0.1
    )


def test_unused_components_have_zero_cotangents(sample):
    gradient = jax.grad(lambda v: jnp.sum(components(v)[1]))(sample)
    np.testing.assert_array_equal(gradient, jnp.zeros_like(sample).at[..., 1].set(1.0))


def test_parts_that_do_not_match_are_refused(sample):
    with pytest.raises(TypeError, match="do not match"):
        jax.jit(stack)(sample[..., 0], sample[0, :, 0])
