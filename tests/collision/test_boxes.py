"""Two boxes by their fifteen axes."""

import jax
import jax.numpy as jnp
import numpy as np
from pairs import box_by_fifteen_axes, turns

import jaxrb as rb
from jaxrb.collision.obb import separation_of_boxes


def test_fifteen_axes_agree_with_those_formed_one_by_one(dtype, tolerance):
    generator = np.random.default_rng(3)
    half = np.asarray(generator.uniform(0.2, 1.0, (2, 2000, 3)), dtype)
    place = np.asarray(generator.normal(size=(2000, 3)), dtype)
    rotation = np.asarray(rb.Quaternion(jnp.asarray(turns(generator, 2000), dtype)).as_matrix())
    gap, axis = jax.jit(separation_of_boxes)(*half, rotation, place)
    still = np.broadcast_to(np.eye(3), (2000, 3, 3))
    half, place, rotation = half.astype(float), place.astype(float), rotation.astype(float)
    true = box_by_fifteen_axes(half[0], still, np.zeros((2000, 3)), half[1], rotation, place)
    assert np.abs(np.asarray(gap) - true).max() <= tolerance(float64=1e-14, float32=2e-6)
    # Along the axis found the boxes' shadows are as far apart as it says.
    n = np.asarray(axis, float)
    shadow = np.einsum("pi,pi->p", half[0], np.abs(n))
    shadow += np.einsum("pi,pi->p", half[1], np.abs(np.einsum("pji,pj->pi", rotation, n)))
    assert np.abs(np.einsum("pi,pi->p", n, place) - shadow - true).max() <= tolerance(
        float64=1e-14, float32=2e-6
    )


def test_equal_boxes_in_one_place_part_along_their_shortest_edge(dtype):
    half = jnp.asarray([0.3, 0.1, 0.2], dtype)
    gap, axis = separation_of_boxes(half, half, jnp.eye(3, dtype=dtype), jnp.zeros(3, dtype))
    np.testing.assert_allclose(gap, -0.2, rtol=1e-6)
    np.testing.assert_array_equal(jnp.abs(axis), [0.0, 1.0, 0.0])
