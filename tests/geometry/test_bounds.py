"""Bounding volumes: each holds its solid, touches it, and is as small as stated."""

import jax
import jax.numpy as jnp
import mesh_samples as samples
import numpy as np
import pytest
from rotation_samples import QUICK, largest, unit_vectors

import jaxrb as rb
from jaxrb.errors import WrongStructure
from jaxrb.geometry.bounds import (
    AxisAlignedBox,
    BoundingSphere,
    bounding_box,
    bounding_sphere,
    boxes_gap,
    oriented_box,
    spheres_gap,
)
from jaxrb.geometry.bounds_points import smallest_ball, tight_box

POINTS = np.random.default_rng(1).normal(size=(40, 3)) * [1.0, 2.0, 3.0]
SHAPES = {
    "sphere": rb.Sphere(0.7),
    "box": rb.Box((0.4, 0.5, 0.6)),
    "ellipsoid": rb.Ellipsoid((0.3, 0.9, 0.5)),
    "cylinder": rb.Cylinder(0.4, 0.7),
    "capsule": rb.Capsule(0.3, 0.5),
    "steep cone": rb.Cone(0.4, 0.9),
    "flat cone": rb.Cone(0.9, 0.3),
    "hull": rb.ConvexHull(POINTS),
}


def outline(shape, directions):
    """Farthest points (n, 3) of a shape in many directions, in its own frame, on the host."""
    return np.asarray(
        jax.jit(jax.vmap(shape.farthest), compiler_options=QUICK)(jnp.asarray(directions)), float
    )


@pytest.fixture(scope="module")
def outlines(dtype):
    directions = np.concatenate([unit_vectors(2000), np.eye(3), -np.eye(3)]).astype(dtype)
    return {name: outline(shape, directions) for name, shape in SHAPES.items()}


@pytest.fixture(scope="module")
def pose(dtype):
    return rb.Pose(
        jnp.asarray([0.3, -2.0, 5.0], dtype), rb.Quaternion.exp(jnp.asarray([0.4, 1.1, -0.5], dtype))
    )


@pytest.mark.parametrize("name", SHAPES)
def test_sphere_holds_its_shape_and_touches_it(name, outlines, tolerance):
    sphere, points = bounding_sphere(SHAPES[name]), outlines[name]
    reach = np.linalg.norm(points - np.asarray(sphere.center, float), axis=-1).max()
    small = tolerance(float64=1e-12, float32=1e-6) * float(sphere.radius)
    assert reach < float(sphere.radius) + small
    assert reach > float(sphere.radius) * (1 - 1e-3)  # the outline has some 2000 points only


@pytest.mark.parametrize("name", SHAPES)
def test_oriented_box_holds_its_shape_and_touches_it_on_six_sides(name, outlines, tolerance):
    box, points = oriented_box(SHAPES[name]), outlines[name]
    local = (points - np.asarray(box.pose.position, float)) @ np.asarray(
        box.pose.orientation.as_matrix(), float
    )
    half = np.asarray(box.half_extents, float)
    small = tolerance(float64=1e-12, float32=2e-6) * half.max()
    assert (np.abs(local) < half + small).all()
    assert largest(local.max(0) - half) < 2e-3 * half.max()
    assert largest(local.min(0) + half) < 2e-3 * half.max()


@pytest.mark.parametrize("name", SHAPES)
def test_axis_aligned_box_of_a_placed_shape_is_exact(name, outlines, pose, tolerance):
    """Against the outline in the six directions of the world as the shape sees them."""
    shape = SHAPES[name]
    matrix = np.asarray(pose.orientation.as_matrix(), float)
    axes = np.concatenate([matrix, -matrix]).astype(np.asarray(pose.position).dtype)
    reach = outline(shape, axes) @ matrix.T + np.asarray(pose.position, float)
    box = jax.jit(lambda pose: bounding_box(shape, pose), compiler_options=QUICK)(pose)
    small = tolerance(float64=1e-13, float32=2e-6) * 10
    assert np.asarray(box.high) == pytest.approx(np.diagonal(reach[:3]), abs=small)
    assert np.asarray(box.low) == pytest.approx(np.diagonal(reach[3:]), abs=small)
    placed = outlines[name] @ matrix.T + np.asarray(pose.position, float)
    assert (placed <= np.asarray(box.high, float) + small).all()
    assert (placed >= np.asarray(box.low, float) - small).all()


def test_smallest_ball_cannot_shrink():
    """Its centre lies in the hull of the points on its surface, which is what makes it the smallest."""
    random = np.random.default_rng(0)
    for count in (2, 3, 4, 5, 20, 300):
        for _ in range(20):
            points = random.normal(size=(count, 3)) * random.uniform(0.01, 1, 3) + random.normal(size=3)
            center, radius = smallest_ball(points)
            offset = points - center
            distance = np.linalg.norm(offset, axis=-1)
            assert distance.max() <= radius * (1 + 1e-12)
            on = offset[distance > radius * (1 - 1e-9)] / radius
            # No direction leads away from all of them: else the ball could move there and shrink.
            directions = np.concatenate([unit_vectors(4000), -on, -on.mean(0, keepdims=True)])
            assert (on @ directions.T).max(0).min() > -1e-6


def test_tight_box_of_a_turned_box_is_that_box_and_of_a_regular_tetrahedron_its_cube():
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    half = np.array([0.2, 0.5, 1.1])
    _, low, high = tight_box(samples.box(half)[0] @ turn.T + 5.0)
    assert np.sort(high - low) == pytest.approx(2 * half, rel=1e-12)
    _, low, high = tight_box(samples.box()[0][[0, 3, 5, 6]] @ turn.T)
    assert high - low == pytest.approx(np.ones(3), rel=1e-12)


def test_oriented_box_beats_principal_axes_and_the_axis_aligned_box():
    for seed in range(5):
        points = np.random.default_rng(seed).normal(size=(30, 3)) @ np.diag([1.0, 1.5, 2.0])
        _, low, high = tight_box(points)
        principal = np.linalg.eigh(np.cov(points.T))[1]
        assert np.prod(high - low) < min(
            np.ptp(points @ principal, axis=0).prod(), np.ptp(points, axis=0).prod()
        )


def test_bounds_of_a_mesh_are_those_of_its_hull(pose, tolerance):
    mesh = rb.TriangleMesh(*samples.torus())
    hull = mesh.convex_hull()
    rel = tolerance(float64=1e-13, float32=1e-6)
    for bound in (lambda s: bounding_sphere(s).radius, lambda s: oriented_box(s).half_extents,
                  lambda s: bounding_box(s, pose).low):  # fmt: skip
        assert np.asarray(bound(mesh)) == pytest.approx(np.asarray(bound(hull)), rel=rel)
    assert float(bounding_sphere(mesh).radius) == pytest.approx(1.4, rel=rel)


def test_composite_is_held_by_its_bounds(pose, dtype, tolerance):
    parts = [
        (rb.Sphere(0.3), rb.Pose(jnp.asarray([1.0, 0, 0], dtype), rb.Quaternion.identity(dtype))),
        (SHAPES["hull"], rb.Pose(jnp.asarray([0, 1.0, 0], dtype), pose.orientation)),
    ]
    composite = rb.Composite(parts)
    sphere, oriented = bounding_sphere(composite).moved(pose), oriented_box(composite).moved(pose)
    box = bounding_box(composite, pose)
    small = tolerance(float64=1e-12, float32=2e-5)
    for part, own in parts:
        points = np.asarray(jax.vmap(part.farthest)(jnp.asarray(unit_vectors(300), dtype)))
        points = own.position + jax.vmap(own.orientation.rotate)(jnp.asarray(points))
        points = np.asarray(pose.position + jax.vmap(pose.orientation.rotate)(points), float)
        assert (
            np.linalg.norm(points - np.asarray(sphere.center), axis=-1) < float(sphere.radius) + small
        ).all()
        local = (points - np.asarray(oriented.pose.position)) @ np.asarray(
            oriented.pose.orientation.as_matrix()
        )
        assert (np.abs(local) < np.asarray(oriented.half_extents) + small).all()
        assert (points < np.asarray(box.high) + small).all()
        assert (points > np.asarray(box.low) - small).all()


def test_gaps_are_signed_distances_along_the_best_axis(dtype):
    a = BoundingSphere(jnp.zeros(3, dtype), jnp.asarray(1.0, dtype))
    b = BoundingSphere(jnp.asarray([3.0, 4.0, 0.0], dtype), jnp.asarray(2.0, dtype))
    assert float(spheres_gap(a, b)) == pytest.approx(2.0)
    one = AxisAlignedBox(jnp.zeros(3, dtype), jnp.ones(3, dtype))
    assert (
        float(boxes_gap(one, AxisAlignedBox(one.low + jnp.asarray([0.9, 3.0, 0], dtype), one.high + 5)))
        == 2.0
    )
    assert float(boxes_gap(one, AxisAlignedBox(one.low + 0.75, one.high + 0.75))) == -0.25
    slope = jax.grad(lambda c: spheres_gap(a, BoundingSphere(c, b.radius)))(b.center)
    assert np.asarray(slope) == pytest.approx([0.6, 0.8, 0.0])
    assert np.isfinite(
        np.asarray(jax.grad(lambda c: spheres_gap(a, BoundingSphere(c, b.radius)))(a.center))
    ).all()


def test_axis_aligned_box_has_derivatives_in_shape_and_pose(pose, dtype, tolerance):
    """A larger box grows by |R| times the change of its half extents; a shift moves both ends."""
    matrix = np.abs(np.asarray(pose.orientation.as_matrix(), float))

    def high(half, position):
        return bounding_box(rb.Box(half), rb.Pose(position, pose.orientation)).high

    by_half, by_shift = jax.jit(jax.jacrev(high, argnums=(0, 1)), compiler_options=QUICK)(
        jnp.asarray([0.4, 0.5, 0.6], dtype), pose.position
    )
    small = tolerance(float64=1e-13, float32=1e-6)
    assert largest(by_half - matrix) < small
    assert largest(by_shift - np.eye(3)) < small


def test_what_has_no_bounds_says_so():
    with pytest.raises(WrongStructure, match="HalfSpace"):
        bounding_sphere(rb.HalfSpace((0, 0, 1), 0.0))

    def radius(points):
        return bounding_sphere(SHAPES["hull"].with_vertices(points)).radius

    with pytest.raises(WrongStructure, match="cannot be traced"):
        jax.grad(radius)(jnp.asarray(SHAPES["hull"].vertices))
