"""Two boxes by their fifteen axes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pairs import box_by_fifteen_axes, on_device, poses, separations, turns
from rotation_samples import QUICK

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


def cases(count):
    """Half edges, quaternions and places of pairs: at random, with equal and nearly equal axes, crossed bars on end,
    corners opposite corners, edges along edges, faces that touch."""
    generator = np.random.default_rng(23)
    half = generator.uniform(0.2, 1.0, (2, count, 3))
    q, p = np.stack([turns(generator, count) for _ in range(2)]), generator.normal(size=(2, count, 3))
    kind = np.arange(count) % 8
    q[1, kind == 1] = q[0, kind == 1]
    for k, angle in ((2, 1e-4), (3, 1e-8), (4, 1e-15)):
        q[1, kind == k] = q[0, kind == k] + angle * generator.normal(size=(count, 4))[kind == k]
    bars = kind == 5
    q[:, bars], p[0, bars] = [1.0, 0.0, 0.0, 0.0], 0.0
    half[0, bars], half[1, bars] = [2.0, 0.1, 0.1], [0.1, 2.0, 0.1]
    p[1, bars] *= [0.5, 0.5, 0.3]
    # About z by 45°: of two squares on each other no corner lies in the other.
    stars = kind == 6
    half[0, stars] = half[1, stars] = [0.5, 0.5, 0.2]
    q[0, stars], q[1, stars] = [1.0, 0.0, 0.0, 0.0], [np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)]
    p[1, stars] = p[0, stars] + generator.normal(size=(count, 3))[stars] * [1e-2, 1e-2, 0.4]
    faces = kind == 7
    q[:, faces] = [1.0, 0.0, 0.0, 0.0]
    p[1, faces] = p[0, faces] + (half[0] + half[1])[faces] * generator.choice([-1, 0, 1], (count, 3))[faces]
    return half, q / np.linalg.norm(q, axis=-1, keepdims=True), p


def test_every_answer_of_two_boxes_is_proved_by_its_points_and_its_normal(dtype, tolerance):
    """No reference is needed: points of both boxes bound the distance from above, their shadows along the normal from
    below; and where boxes overlap nothing beats the best of fifteen axes, formed here one by one."""
    count = 20_000
    half, q, p = (np.asarray(x, dtype).astype(float) for x in cases(count))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    boxes = [on_device(rb.Box(h), dtype) for h in half]
    c = separations(boxes[0], poses(p[0], q[0], dtype), boxes[1], poses(p[1], q[1], dtype))
    with jax.enable_x64(True):
        r = [np.asarray(rb.Quaternion(jnp.asarray(x)).as_matrix()) for x in q]
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(c))
    small = tolerance(float64=4e-14, float32=2e-5)
    for k, point in enumerate((c.point_a, c.point_b)):
        own = np.einsum("pji,pj->pi", r[k], point - p[k])
        assert (np.abs(own) - half[k]).max() <= small
    between = c.point_b - c.point_a - c.distance[:, None] * c.normal
    assert np.abs(between).max() <= small
    shadows = sum(
        np.einsum("pi,pi->p", half[k], np.abs(np.einsum("pji,pj->pi", r[k], c.normal))) for k in (0, 1)
    )
    gap = np.einsum("pi,pi->p", c.normal, p[1] - p[0]) - shadows
    apart = c.distance > small
    assert 0.3 < apart.mean() < 0.9
    # A corner just beyond the end of a parallel edge, by less than a root of round-off, is as near as that edge's own
    # corner: of the two the wrong one turns the normal by as much, and `lower` tells. Three cases in float32.
    short = np.abs(gap - c.distance)[apart]
    assert np.quantile(short, 0.999) <= small
    assert short.max() <= tolerance(float64=4e-14, float32=1e-3)
    assert (c.lower - gap)[apart].max() <= small
    axes = box_by_fifteen_axes(half[0], r[0], p[0], half[1], r[1], p[1])
    deep = c.distance < -small
    assert np.abs(axes - c.distance)[deep].max() <= tolerance(float64=1e-13, float32=1e-5)
    assert (c.lower <= c.distance).all()
    assert (c.distance <= c.upper).all()
    assert np.median(c.upper - c.lower) <= tolerance(float64=1e-13, float32=1e-4)


def test_the_distance_of_boxes_follows_their_half_edges(dtype):
    if dtype != jnp.float64:
        pytest.skip("differences in float32 know three digits; the formulas are the same in both types")
    generator = np.random.default_rng(29)
    half, q = generator.uniform(0.2, 1.0, (2, 64, 3)), np.stack([turns(generator, 64) for _ in range(2)])
    place = generator.normal(size=(64, 3)) * 0.9

    def distance(h_a, h_b, pose_a, pose_b):
        return rb.separation(rb.Box(h_a), pose_a, rb.Box(h_b), pose_b).distance

    sizes = [jnp.asarray(h, dtype) for h in half]
    at = (poses(0 * place, q[0], dtype), poses(place, q[1], dtype))
    value = jax.jit(jax.vmap(distance), compiler_options=QUICK)
    slopes = jax.jit(jax.vmap(jax.grad(distance, (0, 1))), compiler_options=QUICK)(*sizes, *at)
    for k in (0, 1):
        for e in np.eye(3):
            moved = [[h + s * 1e-6 * e * (m == k) for m, h in enumerate(sizes)] for s in (1, -1)]
            ends = [value(*each, *at) for each in moved]
            np.testing.assert_allclose(slopes[k] @ e, (ends[0] - ends[1]) / 2e-6, atol=1e-8)
