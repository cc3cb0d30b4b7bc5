"""Values kept by a branch that the compiler cannot foresee: the same values, whichever way the branch looks."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.math.settled import settled


def test_settled_values_are_the_same_whatever_the_first_of_them():
    def kept(x):
        return settled({"first": x, "second": 3.0 * x + 1.0})

    for first in (1.5, 0.0, -0.0, -2.5, np.inf, -np.inf, np.nan):
        x = jnp.asarray([first, 2.0])
        found = jax.jit(kept)(x)
        np.testing.assert_array_equal(found["first"], x)
        np.testing.assert_array_equal(found["second"], 3.0 * x + 1.0)
    rows = jnp.asarray([[-1.0, 2.0], [1.0, -2.0], [0.0, 0.0]])
    np.testing.assert_array_equal(jax.jit(jax.vmap(kept))(rows)["second"], 3.0 * rows + 1.0)
