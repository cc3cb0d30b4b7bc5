"""Array types of one rotation or one body, and the two helpers that take vectors apart and put them together.

Arithmetic of 3- and 4-vectors is written by components. XLA then fuses a whole step into one loop over the bodies,
where array style (`jnp.cross`, `R @ hat(w)`) leaves small matrix products and copies that it cannot fuse: 45 ns
against 68 ns a body-step for the matrix kinematics.
"""

from typing import TypeAlias

import jax
import numpy as np
from jax import lax
from jaxtyping import Float, Inexact

Array: TypeAlias = jax.Array | np.ndarray
Scalar: TypeAlias = Float[Array, "*batch"]
Vector: TypeAlias = Float[Array, "*batch 3"]
Matrix: TypeAlias = Float[Array, "*batch 3 3"]
Real: TypeAlias = Inexact[Array, "..."]


def components(array: Array) -> list[jax.Array]:
    """The slices of `array` along its last axis.

    `x[..., i]` would do; the bare primitives trace five times faster, and that is the user's waiting time.
    """
    array = jax.numpy.asarray(array)
    axis = array.ndim - 1
    return [lax.squeeze(lax.slice_in_dim(array, i, i + 1, axis=axis), (axis,)) for i in range(array.shape[axis])]


def stack(*parts: jax.Array) -> jax.Array:
    """The inverse of `components`: puts equally shaped parts side by side along a new last axis."""
    axis = parts[0].ndim
    return lax.concatenate([lax.expand_dims(part, (axis,)) for part in parts], axis)


def entries(matrix: Array) -> list[list[jax.Array]]:
    """The nine scalars `m[i][j]` of a (..., 3, 3) array."""
    return [components(row) for row in _rows(matrix)]


def from_entries(rows: list[list[jax.Array]]) -> jax.Array:
    """The inverse of `entries`."""
    axis = rows[0][0].ndim
    return lax.concatenate([lax.expand_dims(stack(*row), (axis,)) for row in rows], axis)


def _rows(matrix: Array) -> list[jax.Array]:
    matrix = jax.numpy.asarray(matrix)
    axis = matrix.ndim - 2
    return [lax.squeeze(lax.slice_in_dim(matrix, i, i + 1, axis=axis), (axis,)) for i in range(matrix.shape[axis])]
