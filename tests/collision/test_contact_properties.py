"""What a contact must be whatever the shapes: covariant, antisymmetric, certified, finite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pairs import box_by_fifteen_axes, on_device, poses, separations, turns

import jaxrb as rb


def hulls(seed, corners=12):
    generator = np.random.default_rng(seed)
    return rb.ConvexHull(generator.normal(size=(corners, 3)))


SHAPES = {
    "box": rb.Box((0.5, 0.6, 0.9)),
    "hull": hulls(1),
    "ellipsoid": rb.Ellipsoid((0.4, 0.7, 1.1)),
    "capsule": rb.Capsule(0.3, 0.8),
    "sphere": rb.Sphere(0.6),
    "plane": rb.HalfSpace((0.1, 0.2, 1.0), -0.3),
}
PAIRS = [("box", "box"), ("hull", "capsule"), ("ellipsoid", "box"), ("capsule", "capsule"), ("plane", "hull")]


@pytest.fixture(scope="module", params=PAIRS, ids="-".join)
def pair(request, dtype):
    """Both orders of a pair, compiled once each, and 200 random places from deep inside to well apart."""
    shape_a, shape_b = (on_device(SHAPES[name], dtype) for name in request.param)
    forward = jax.jit(jax.vmap(lambda a, b: rb.separation(shape_a, a, shape_b, b)))
    backward = jax.jit(jax.vmap(lambda a, b: rb.separation(shape_b, b, shape_a, a)))
    generator = np.random.default_rng(7)
    positions = generator.normal(size=(2, 200, 3)) * 0.8
    quaternions = turns(generator, 200), turns(generator, 200)
    return forward, backward, positions, quaternions, "ellipsoid" in request.param


def test_the_answer_moves_with_the_pair(pair, dtype, tolerance):
    forward, _, positions, (qa, qb), _ = pair
    # Whole metres, so that the shift itself is exact in either type.
    far = np.array([8192.0, -4096.0, 6144.0]) * tolerance(float64=1.0, float32=2.0**-10)
    places = [np.asarray(p, dtype) for p in positions]
    places = [((p * 64).round() / 64) for p in places]
    before = forward(poses(places[0], qa, dtype), poses(places[1], qb, dtype))
    after = forward(poses(places[0] + far, qa, dtype), poses(places[1] + far, qb, dtype))
    small = tolerance(float64=1e-10, float32=1e-5)
    assert np.abs(after.distance - before.distance).max() <= small
    assert np.abs(after.normal - before.normal).max() <= small
    assert np.abs(after.point_a - before.point_a - far).max() <= tolerance(float64=1e-10, float32=1e-5)


def test_exchanging_the_shapes_flips_the_normal_bit_by_bit(pair, dtype):
    forward, backward, positions, (qa, qb), _ = pair
    at = poses(positions[0], qa, dtype), poses(positions[1], qb, dtype)
    one, other = forward(*at), backward(*at)
    np.testing.assert_array_equal(one.normal, -other.normal)
    np.testing.assert_array_equal(one.distance, other.distance)
    np.testing.assert_array_equal(one.point_a, other.point_b)


def test_moving_b_out_by_the_depth_makes_the_shapes_touch(pair, dtype, tolerance):
    forward, _, positions, (qa, qb), smooth = pair
    contact = forward(poses(positions[0], qa, dtype), poses(positions[1], qb, dtype))
    moved = positions[1] - np.asarray(contact.distance)[:, None] * np.asarray(contact.normal)
    touching = forward(poses(positions[0], qa, dtype), poses(moved, qb, dtype))
    left = np.abs(np.asarray(touching.distance))
    # Of smooth shapes deep inside each other the way out is not always followed to its end (see `separation`).
    assert np.quantile(left, 0.99) <= tolerance(float64=1e-9, float32=2e-4)
    assert left.max() <= (1e-3 if smooth else tolerance(float64=1e-9, float32=2e-5))


def test_witnesses_and_certificate_agree_with_the_distance(pair, dtype, tolerance):
    forward, _, positions, (qa, qb), smooth = pair
    c = forward(poses(positions[0], qa, dtype), poses(positions[1], qb, dtype))
    between = c.point_b - c.point_a - c.distance[:, None] * c.normal
    off = np.abs(np.asarray(between)).max(axis=1)
    assert np.quantile(off, 0.99) <= tolerance(float64=1e-7, float32=1e-3)
    assert off.max() <= (2e-2 if smooth else tolerance(float64=1e-8, float32=2e-4))
    assert jnp.abs(jnp.linalg.norm(c.normal, axis=1) - 1).max() <= tolerance(float64=1e-14, float32=1e-6)
    assert bool((c.lower <= c.distance).all())
    assert bool((c.distance <= c.upper).all())


def degenerate_boxes(count):
    """Random, aligned, equal, concentric, touching, barely turned and very flat boxes."""
    generator = np.random.default_rng(11)
    half = generator.uniform(0.2, 1.0, size=(2, count, 3))
    q = np.stack([turns(generator, count), turns(generator, count)])
    p = generator.normal(size=(2, count, 3)) * 0.8
    kind = np.arange(count) % 8
    q[:, kind == 1] = [1.0, 0.0, 0.0, 0.0]
    q[1, kind == 2], half[1, kind == 2] = q[0, kind == 2], half[0, kind == 2]
    p[1, kind == 3] = p[0, kind == 3]
    touching = kind == 4
    q[:, touching] = [1.0, 0.0, 0.0, 0.0]
    p[1, touching] = p[0, touching] + (half[0] + half[1])[touching] * [1.0, 0.0, 0.0]
    q[1, kind == 5] = q[0, kind == 5] + 1e-9 * generator.normal(size=(count, 4))[kind == 5]
    half[0, kind == 6] *= [1.0, 1.0, 1e-4]
    same = kind == 7
    half[1, same], q[1, same], p[1, same] = half[0, same], q[0, same], p[0, same]
    return half, q / np.linalg.norm(q, axis=-1, keepdims=True), p


def test_the_certificate_is_never_false_in_a_hundred_thousand_queries(dtype, tolerance):
    half, q, p = (np.asarray(x, dtype).astype(float) for x in degenerate_boxes(100_000))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    boxes = [on_device(rb.Box(h), dtype) for h in half]
    contact = separations(boxes[0], poses(p[0], q[0], dtype), boxes[1], poses(p[1], q[1], dtype))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(contact))
    with jax.enable_x64(True):
        matrices = [np.asarray(rb.Quaternion(jnp.asarray(x)).as_matrix()) for x in q]
    axes = box_by_fifteen_axes(half[0], matrices[0], p[0], half[1], matrices[1], p[1])
    # The poses themselves are known to round-off only.
    slack = tolerance(float64=1e-14, float32=2e-6)
    deep = axes < 0
    assert deep.mean() > 0.3
    assert (contact.lower - axes)[deep].max() <= slack
    assert (axes - contact.upper)[deep].max() <= slack
    assert np.abs(contact.distance - axes)[deep].max() <= tolerance(float64=1e-13, float32=1e-5)
    assert (axes - contact.upper).max() <= slack
    apart = np.linalg.norm(contact.point_b - contact.point_a, axis=1)
    assert (contact.lower - apart)[~deep].max() <= slack


def test_permuted_vertices_change_nothing(dtype, tolerance):
    generator = np.random.default_rng(5)
    points = generator.normal(size=(40, 15, 3))
    orders = [generator.permutation(15) for _ in points]
    shapes = rb.stack_hulls([rb.ConvexHull(p) for p in points])
    mixed = rb.stack_hulls([rb.ConvexHull(p[order]) for p, order in zip(points, orders)])
    other = on_device(SHAPES["hull"], dtype)
    at = (
        poses(np.zeros((40, 3)), turns(generator, 40), dtype),
        poses(generator.normal(size=(40, 3)), turns(generator, 40), dtype),
    )
    run = jax.jit(jax.vmap(lambda s, a, b: rb.separation(s, a, other, b)))
    width = max(shapes.edges.shape[1], mixed.edges.shape[1])
    assert width == shapes.edges.shape[1] == mixed.edges.shape[1]
    one, two = run(on_device(shapes, dtype), *at), run(on_device(mixed, dtype), *at)
    assert jnp.abs(one.distance - two.distance).max() <= tolerance(float64=1e-13, float32=5e-6)


def test_a_composite_is_its_nearest_part(dtype):
    pose = rb.Pose.identity(dtype)
    aside = rb.Pose(jnp.asarray([2.0, 0, 0], dtype), rb.Quaternion.identity(dtype))
    dumbbell = rb.Composite(((rb.Sphere(0.5), pose), (rb.Sphere(0.5), aside)))
    ball = rb.Pose(jnp.asarray([4.0, 0, 0], dtype), rb.Quaternion.identity(dtype))
    contact = rb.separation(dumbbell, pose, rb.Sphere(0.25), ball)
    assert float(contact.distance) == pytest.approx(1.25, abs=1e-6)
    np.testing.assert_allclose(contact.point_a, [2.5, 0, 0], atol=1e-6)


def test_what_is_no_pair_is_refused(dtype):
    pose = rb.Pose.identity(dtype)
    with pytest.raises(rb.WrongStructure, match="two half-spaces"):
        rb.separation(rb.HalfSpace(), pose, rb.HalfSpace(), pose)
    with pytest.raises(rb.WrongStructure, match="Pose"):
        rb.separation(rb.Sphere(1.0), (0, 0, 0), rb.Sphere(1.0), pose)
