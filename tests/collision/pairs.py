"""Pairs of shapes with known answers, shared by the tests of this folder."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxrb as rb


def turns(generator, count):
    """Random unit quaternions (count, 4)."""
    q = generator.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def poses(positions, quaternions, dtype):
    """Poses with a leading axis."""
    return rb.Pose(jnp.asarray(positions, dtype), rb.Quaternion(jnp.asarray(quaternions, dtype)))


def at_origin(dtype):
    return rb.Pose.identity(dtype)


def on_device(tree, dtype):
    """Numbers in the type of this run; whole numbers as they are."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype if np.asarray(x).dtype.kind == "f" else None), tree)


def separations(shape_a, pose_a, shape_b, pose_b, axes=(0, 0, 0, 0)):
    """`separation` of a batch as arrays of the host in float64."""
    contact = jax.jit(jax.vmap(rb.separation, in_axes=axes))(shape_a, pose_a, shape_b, pose_b)
    return jax.tree.map(lambda x: np.asarray(x, np.float64), contact)


def box_by_fifteen_axes(half_a, rotation_a, position_a, half_b, rotation_b, position_b):
    """The signed answer of the fifteen axes in plain numpy: exact where boxes overlap, a lower bound where not."""
    axes = [rotation_a[..., i] for i in range(3)] + [rotation_b[..., i] for i in range(3)]
    axes += [np.cross(rotation_a[..., i], rotation_b[..., j]) for i in range(3) for j in range(3)]
    best = np.full(half_a.shape[:-1], -np.inf)
    for axis in axes:
        length = np.linalg.norm(axis, axis=-1)
        usable = length > 1e-9
        n = axis / np.where(usable, length, 1.0)[..., None]
        reach = sum(
            np.einsum("...i,...i", half, np.abs(np.einsum("...ji,...j->...i", rotation, n)))
            for half, rotation in ((half_a, rotation_a), (half_b, rotation_b))
        )
        gap = np.abs(np.einsum("...i,...i", n, position_b - position_a)) - reach
        best = np.where(usable, np.maximum(best, gap), best)
    return best
