"""First and second derivatives in both modes, for tests of functions at their special points."""

import jax
import jax.numpy as jnp
import numpy as np
from rotation_samples import QUICK, largest

EYE = np.eye(3)


def derivatives(function, points):
    """Value, and first and second derivative along each of six directions, which between them span the Hessian.

    The reverse mode is run too, and must give the same first derivatives.
    """
    pairs = np.concatenate([EYE, np.roll(EYE, 1, axis=0) + EYE])
    directions = (pairs if points.ndim == 2 else np.ones(1)).astype(points.dtype)

    def slope(x, u):
        return jax.jvp(function, (x,), (u,))[1]

    def at(x):
        value, pull = jax.vjp(function, x)
        along = jax.vmap(lambda u: slope(x, u))(directions)
        bend = jax.vmap(lambda u: jax.jvp(lambda x: slope(x, u), (x,), (u,))[1])(directions)
        weights = jnp.linspace(0.5, 1.5, value.size, dtype=value.dtype).reshape(value.shape)
        back = jnp.tensordot(directions, pull(weights)[0], axes=points.ndim - 1)
        return value, along, bend, back - jnp.tensordot(along, weights, axes=weights.ndim)

    both = jax.jit(jax.vmap(at), compiler_options=QUICK)
    *parts, mismatch = (np.asarray(part, np.float64) for part in both(points))
    assert largest(mismatch) <= 1e3 * np.finfo(points.dtype).eps * max(1.0, largest(parts[1]))
    return parts


def spread(vectors) -> list:
    """What `derivatives` gives for the identity map: the points, the six directions, zero."""
    directions = np.concatenate([EYE, np.roll(EYE, 1, axis=0) + EYE])
    shape = (len(vectors), 6, 3)
    return [np.asarray(vectors, np.float64), np.broadcast_to(directions, shape).copy(), np.zeros(shape)]
