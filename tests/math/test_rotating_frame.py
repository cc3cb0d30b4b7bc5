"""The derivative of a vector seen from a rotating frame (section 3 of the lecture)."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxrb as rb
from jaxrb.math.vector import rate_in_world


def test_rate_seen_from_the_world_is_that_of_the_world_components(dtype, tolerance):
    omega = jnp.asarray([0.3, -0.7, 1.1], dtype)
    start = rb.Quaternion.exp(jnp.asarray([0.4, 0.1, -0.2], dtype))

    def body_components(t):
        return jnp.stack([jnp.cos(t), t * t, 1.0 + 0.5 * t])

    def world_components(t):
        return (start @ rb.Quaternion.exp(t * omega)).rotate(body_components(t))

    t = jnp.asarray(0.0, dtype)
    seen = rate_in_world(jax.jacfwd(body_components)(t), omega, body_components(t))
    np.testing.assert_allclose(
        start.rotate(seen), jax.jacfwd(world_components)(t), atol=tolerance(float64=1e-14, float32=1e-6)
    )
