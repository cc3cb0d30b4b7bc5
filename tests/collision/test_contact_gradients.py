"""Derivatives of distance, normal and witnesses against differences, and where they have no meaning, finite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pairs import on_device, turns
from rotation_samples import QUICK

import jaxrb as rb

GENERATOR = np.random.default_rng(3)
KINDS = {
    "hulls": (rb.ConvexHull(GENERATOR.normal(size=(10, 3))), rb.ConvexHull(GENERATOR.normal(size=(12, 3)))),
    "boxes": (rb.Box((0.4, 0.7, 0.5)), rb.Box((0.8, 0.3, 0.6))),
    "ellipsoids": (rb.Ellipsoid((0.4, 0.7, 1.1)), rb.Ellipsoid((0.8, 0.3, 0.6))),
    "capsule and plane": (rb.Capsule(0.3, 0.7), rb.HalfSpace((0.2, 0.1, 1.0), -0.4)),
}


@pytest.fixture(scope="module", params=KINDS)
def contact(request, dtype):
    """Eleven numbers of a contact as a function of 14 numbers of two poses, at 16 places."""
    shape_a, shape_b = on_device(KINDS[request.param], dtype)

    def answer(x):
        pose_a = rb.Pose(x[:3], rb.Quaternion(x[3:7]).normalise())
        pose_b = rb.Pose(x[7:10], rb.Quaternion(x[10:14]).normalise())
        c = rb.separation(shape_a, pose_a, shape_b, pose_b)
        return jnp.concatenate([c.distance[None], c.normal, c.point_a, c.point_b])

    generator = np.random.default_rng(4)
    aside = generator.normal(size=(16, 3))
    aside *= (np.linspace(0.5, 2.8, 16) / np.linalg.norm(aside, axis=1))[:, None]
    x = np.concatenate(
        [0.1 * generator.normal(size=(16, 3)), turns(generator, 16), aside, turns(generator, 16)], 1
    )
    return answer, np.asarray(x, dtype)


def test_first_derivatives_match_differences(contact, dtype):
    if dtype != jnp.float64:
        pytest.skip("differences in float32 know three digits; the formulas are the same in both types")
    answer, x = contact
    value = jax.jit(jax.vmap(answer), compiler_options=QUICK)
    exact = np.asarray(jax.jit(jax.vmap(jax.jacrev(answer)), compiler_options=QUICK)(x))
    h = 1e-5
    slope = [(np.asarray(value(x + h * e)) - np.asarray(value(x - h * e))) / (2 * h) for e in np.eye(14)]
    error = np.abs(exact - np.stack(slope, -1))
    assert error[:, 0].max() <= 1e-8
    assert np.quantile(error.max(axis=(1, 2)), 0.9) <= 1e-6


def test_second_derivatives_of_the_distance_match_differences(contact, dtype):
    if dtype != jnp.float64:
        pytest.skip("differences in float32 know three digits; the formulas are the same in both types")
    answer, x = contact
    slope = jax.jit(jax.vmap(jax.grad(lambda x: answer(x)[0])), compiler_options=QUICK)
    along = np.linspace(-1.0, 1.0, 14)
    bend = jax.jit(
        jax.vmap(lambda x: jax.jvp(jax.grad(lambda x: answer(x)[0]), (x,), (jnp.asarray(along),))[1])
    )
    h = 1e-5
    difference = (np.asarray(slope(x + h * along)) - np.asarray(slope(x - h * along))) / (2 * h)
    assert np.abs(np.asarray(bend(x)) - difference).max() <= 1e-6


def test_derivatives_are_finite_where_shapes_touch_or_coincide(contact, dtype):
    answer, x = contact
    same = np.tile([0.0, 0, 0, 1, 0, 0, 0], 2)
    special = np.stack([same, same, same]).astype(dtype)
    special[1, 7] = 1.0
    special[2, 9] = 1e-12
    jacobian = jax.jit(jax.vmap(jax.jacrev(answer)), compiler_options=QUICK)(
        np.concatenate([special, x[:13]])
    )
    assert np.isfinite(np.asarray(jacobian)).all()


def test_the_distance_of_a_hull_follows_its_vertices(dtype, tolerance):
    """A corner that touches carries all of the derivative: n · (db − da) with weights that add up to one."""
    hull = rb.ConvexHull(np.vstack([np.eye(3), -np.eye(3)]))
    pose = rb.Pose.identity(dtype)
    away = rb.Pose(jnp.asarray([0.0, 0.0, 3.0], dtype), rb.Quaternion.identity(dtype))

    def distance(vertices):
        return rb.separation(hull.with_vertices(vertices), pose, rb.Sphere(0.5), away).distance

    slope = jax.grad(distance)(jnp.asarray(hull.vertices, dtype))
    expected = np.where((np.asarray(hull.vertices) == [0, 0, 1]).all(axis=1)[:, None], [0.0, 0.0, -1.0], 0.0)
    np.testing.assert_allclose(slope, expected, atol=tolerance(float64=1e-14, float32=1e-6))
