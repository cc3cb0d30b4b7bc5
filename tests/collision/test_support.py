"""Support maps, and hulls: what they keep and what they refuse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb

SHAPES = {
    "sphere": rb.Sphere(0.7),
    "box": rb.Box((0.5, 0.6, 0.9)),
    "capsule": rb.Capsule(0.4, 0.6),
    "cylinder": rb.Cylinder(0.5, 0.7),
    "cone": rb.Cone(0.6, 1.2),
    "ellipsoid": rb.Ellipsoid((0.4, 0.7, 1.1)),
    "hull": rb.ConvexHull(np.random.default_rng(0).normal(size=(12, 3))),
}


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_no_support_point_is_farther_than_the_one_for_its_direction(shape, dtype, tolerance):
    directions = jnp.asarray(np.random.default_rng(1).normal(size=(300, 3)), dtype)
    points = shape.support(directions)
    reach = np.asarray(points @ directions.T, float)
    assert (reach - np.diag(reach)[None]).max() <= tolerance(float64=1e-14, float32=1e-5)
    np.testing.assert_allclose(shape.support(3.0 * directions), points, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_support_is_finite_with_its_derivatives_where_it_is_not_unique(shape, dtype):
    special = jnp.asarray(np.vstack([np.zeros(3), np.eye(3), -np.eye(3)]), dtype)
    jacobian = jax.vmap(jax.jacfwd(lambda d: shape.farthest(d)))(special)
    assert np.isfinite(np.asarray(shape.farthest(special))).all()
    assert np.isfinite(np.asarray(jacobian)).all()


def test_the_hull_of_a_box_is_the_box(dtype, tolerance):
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-2.0, 2.0) for z in (-0.5, 0.5)])
    hull = rb.ConvexHull(np.vstack([corners, 0.3 * corners]))
    assert (len(hull.vertices), len(hull.faces), len(hull.edges)) == (8, 6, 12)
    box = rb.Box((1.0, 2.0, 0.5)).mass_properties(3.0)
    mine = hull.mass_properties(3.0)
    np.testing.assert_allclose(mine.mass, box.mass, rtol=1e-6)
    np.testing.assert_allclose(mine.inertia.as_matrix(), box.inertia.as_matrix(), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 0, 0]] * 5, "enclose no volume"),
        ([[k, 2 * k, 0] for k in range(5)], "on one line"),
        ([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]], "in one plane"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, np.nan]], "point 3"),
    ],
)
def test_points_without_volume_are_refused(points, message):
    with pytest.raises(rb.InvalidInput, match=message):
        rb.ConvexHull(points)


def test_a_hull_cannot_be_traced_and_says_what_to_do():
    with pytest.raises(rb.WrongStructure, match="with_vertices"):
        jax.jit(lambda p: rb.ConvexHull(p).vertices)(jnp.eye(4, 3))


def test_a_half_space_has_a_unit_normal_and_no_mass():
    assert rb.HalfSpace((0, 3, 4)).normal == pytest.approx([0, 0.6, 0.8])
    with pytest.raises(rb.InvalidInput, match="zero vector"):
        rb.HalfSpace((0, 0, 0))
    with pytest.raises(rb.WrongStructure, match="no mass"):
        rb.HalfSpace().mass_properties(1.0)
