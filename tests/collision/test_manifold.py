"""Points of contact: the common outline of two faces, with the depth of each point, named so that it is found again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.collision.contact import Contact
from jaxrb.collision.manifold import manifold
from jaxrb.errors import WrongStructure

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SHAPES = {
    "box": lambda half: rb.Box(half),
    "hull": lambda half: rb.ConvexHull(CUBE * half),
}


def at(x, y, z, dtype, turn=(0.0, 0.0, 0.0)):
    return rb.Pose(jnp.asarray([x, y, z], dtype), rb.Quaternion.exp(jnp.asarray(turn, dtype)))


def standing(depth, dtype, x=0.0, y=0.0):
    """The contact of a box whose lower side stands on z = 0, sunk in by `depth`."""
    distance = jnp.asarray(-depth, dtype)
    point = jnp.asarray([x, y, 0.0], dtype)
    normal = jnp.asarray([0.0, 0.0, 1.0], dtype)
    return Contact(distance, normal, point, point + distance * normal, distance, distance)


def listed(found):
    valid = np.asarray(found.valid)
    return np.asarray(found.position, float)[valid], np.asarray(found.distance, float)[valid]


def ordered(points):
    return points[np.lexsort(np.round(points, 4).T)]


@pytest.fixture(scope="module")
def run():
    """Compiled once for each pair of kinds and capacity."""
    return jax.jit(manifold, static_argnames="capacity", compiler_options=QUICK)


@pytest.mark.parametrize("kind", SHAPES)
def test_box_on_a_box_touches_at_the_corners_of_what_they_share(kind, run, dtype, tolerance):
    """A small box hangs over the edge of a large one: two of its corners and two crossings of edges."""
    large, small = SHAPES[kind]((1.0, 1.0, 0.5)), SHAPES[kind]((0.4, 0.3, 0.2))
    pose = at(0.9, 0.0, 0.2 - 0.01, dtype)
    found = run(standing(0.01, dtype, x=0.75), large, at(0, 0, -0.5, dtype), small, pose)
    points, distances = listed(found)
    tol = tolerance(float64=1e-12, float32=1e-5)
    expected = np.array([[x, y, -0.005] for x in (0.5, 1.0) for y in (-0.3, 0.3)])
    assert ordered(points) == pytest.approx(ordered(expected), abs=tol)
    assert distances == pytest.approx(-0.01, abs=tol)
    assert np.asarray(found.normal) == pytest.approx([0, 0, 1])
    assert not found.overflow


@pytest.mark.parametrize("kind", SHAPES)
def test_equal_boxes_in_line_touch_at_four_corners_and_no_more(kind, run, dtype, tolerance):
    shape = SHAPES[kind]((0.5, 0.5, 0.5))
    found = run(
        standing(1e-3, dtype), shape, at(0, 0, -0.5, dtype), shape, at(0, 0, 0.499, dtype), capacity=8
    )
    points, _ = listed(found)
    expected = np.array([[x, y, -5e-4] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    assert ordered(points) == pytest.approx(ordered(expected), abs=tolerance(float64=1e-12, float32=1e-5))


@pytest.mark.parametrize("kind", SHAPES)
def test_box_turned_by_an_eighth_shares_an_octagon(kind, run, dtype, tolerance):
    """A cube turned about z by 45° on an equal one; with room for four, four well spread of the eight are kept."""
    shape = SHAPES[kind]((0.5, 0.5, 0.5))
    poses = at(0, 0, -0.5, dtype), at(0, 0, 0.499, dtype, (0, 0, np.pi / 4))
    points, distances = listed(run(standing(1e-3, dtype), shape, poses[0], shape, poses[1], capacity=8))
    radius, tol = 0.5 / np.cos(np.pi / 8), tolerance(float64=1e-12, float32=1e-5)
    assert len(points) == 8
    assert np.hypot(*points.T[:2]) == pytest.approx(radius, abs=tol)
    assert distances == pytest.approx(-1e-3, abs=tol)
    four, _ = listed(run(standing(1e-3, dtype), shape, poses[0], shape, poses[1], capacity=4))
    angles = np.sort(np.arctan2(four[:, 1], four[:, 0]))
    assert len(four) == 4
    assert np.diff(np.append(angles, angles[0] + 2 * np.pi)).max() < 0.76 * np.pi


@pytest.mark.parametrize("kind", SHAPES)
def test_tilted_box_on_a_plane_touches_with_its_lower_edge_unless_margin_allows(kind, run, dtype, tolerance):
    floor, shape, tilt = rb.HalfSpace((0.0, 0.0, 1.0), 0.0), SHAPES[kind]((0.5, 0.4, 0.3)), 0.02
    lower = 0.5 * np.sin(tilt) + 0.3 * np.cos(tilt)
    pose = at(0, 0, lower - 1e-3, dtype, (0, tilt, 0))
    still = at(0, 0, 0, dtype)
    contact = standing(1e-3, dtype)
    tol = tolerance(float64=1e-12, float32=1e-5)
    points, distances = listed(run(contact, floor, still, shape, pose))
    assert len(points) == 2
    assert distances == pytest.approx(-1e-3, abs=tol)
    assert np.sort(points[:, 1]) == pytest.approx([-0.4, 0.4], abs=tol)
    more = run(contact, floor, still, shape, pose, margin=jnp.asarray(0.05, dtype))
    assert np.sort(listed(more)[1]) == pytest.approx([-1e-3] * 2 + [np.sin(tilt) - 1e-3] * 2, abs=tol)
    swapped = run(contact.flipped(), shape, pose, floor, still)
    assert np.asarray(swapped.normal) == pytest.approx([0, 0, -1])
    assert listed(swapped)[0] == pytest.approx(points, abs=tol)


def test_capsule_on_a_box_and_on_a_plane_rests_on_two_points(run, dtype, tolerance):
    capsule, tol = rb.Capsule(0.1, 0.4), tolerance(float64=1e-12, float32=1e-5)
    pose = at(0, 0, 0.098, dtype, (0, np.pi / 2, 0))
    plane = rb.HalfSpace((0.0, 0.0, 1.0), 0.0)
    for ground, place in ((rb.Box((1.0, 1.0, 0.5)), at(0, 0, -0.5, dtype)), (plane, at(0, 0, 0, dtype))):
        points, distances = listed(run(standing(0.002, dtype), ground, place, capsule, pose))
        assert ordered(points) == pytest.approx(np.array([[-0.4, 0, -0.001], [0.4, 0, -0.001]]), abs=tol)
        assert distances == pytest.approx(-0.002, abs=tol)
        turned = run(standing(0.002, dtype).flipped(), capsule, pose, ground, place)
        assert ordered(listed(turned)[0]) == pytest.approx(ordered(points), abs=tol)


def test_crossing_edges_and_round_shapes_touch_in_one_point(run, dtype, tolerance):
    middle = jnp.asarray([1e3, 2.0, 0.5], dtype)
    normal = jnp.asarray([0.6, 0.0, 0.8], dtype)
    distance = jnp.asarray(-0.25, dtype)
    ends = [middle - 0.5 * distance * normal, middle + 0.5 * distance * normal]
    contact = Contact(distance, normal, *ends, distance, distance)
    box = rb.Box((0.5, 0.5, 0.5))
    place = rb.Pose(middle, rb.Quaternion.identity(dtype))
    for shape in (rb.Sphere(0.3), box):
        found = run(contact, shape, place, box, place)
        points, distances = listed(found)
        assert points == pytest.approx(np.asarray(middle, float)[None], rel=1e-6)
        assert distances == pytest.approx([-0.25], rel=1e-6)
    apart = run(Contact(-distance, normal, *ends, distance, distance), box, place, box, place)
    assert not np.asarray(apart.valid).any()


@pytest.mark.parametrize("kind", SHAPES)
def test_points_keep_their_names_while_a_box_slides_and_rocks(kind, run, dtype):
    large, small = SHAPES[kind]((1.0, 1.0, 0.5)), SHAPES[kind]((0.4, 0.3, 0.2))
    names = []
    for x, tilt in ((0.0, 1e-3), (0.05, -1e-3), (0.1, 2e-3)):
        pose = at(x, 0.02, 0.199, dtype, (tilt, tilt, 0.3))
        found = run(
            standing(2e-3, dtype, x=x),
            large,
            at(0, 0, -0.5, dtype),
            small,
            pose,
            margin=jnp.asarray(0.01, dtype),
        )
        assert np.asarray(found.valid).all()
        names.append(set(np.asarray(found.feature).tolist()))
        assert len(names[-1]) == 4
    assert names[0] == names[1] == names[2]


@pytest.mark.parametrize("kind", SHAPES)
def test_gap_within_the_margin_is_a_contact_to_come_and_beyond_it_is_none(kind, run, dtype, tolerance):
    large, small = SHAPES[kind]((1.0, 1.0, 0.5)), SHAPES[kind]((0.4, 0.3, 0.2))
    poses = at(0, 0, -0.5, dtype), at(0, 0, 0.21, dtype)
    for margin, count in ((0.02, 4), (0.005, 0)):
        found = run(
            standing(-0.01, dtype), large, poses[0], small, poses[1], margin=jnp.asarray(margin, dtype)
        )
        assert int(np.sum(found.valid)) == count
        assert listed(found)[1] == pytest.approx(0.01, abs=tolerance(float64=1e-12, float32=1e-5))
        assert (np.asarray(found.feature)[~np.asarray(found.valid)] == -1).all()


def test_faces_of_a_hull_cut_apart_by_round_off_are_one(run, dtype, tolerance):
    """Corners a few units in the last place off their planes: twelve triangles, and still four points of contact."""
    noise = tolerance(float64=1e-15, float32=3e-7) * np.random.default_rng(0).normal(size=(8, 3))
    rough = rb.ConvexHull(CUBE * (0.4, 0.3, 0.2) + noise)
    assert len(rough.faces) > 6
    pose = at(0, 0, 0.199, dtype)
    found = run(
        standing(1e-3, dtype), rb.Box((1.0, 1.0, 0.5)), at(0, 0, -0.5, dtype), rough, pose, capacity=8
    )
    points, _ = listed(found)
    expected = np.array([[x, y, -5e-4] for x in (-0.4, 0.4) for y in (-0.3, 0.3)])
    assert ordered(points) == pytest.approx(ordered(expected), abs=tolerance(float64=1e-12, float32=1e-5))


def test_depths_are_those_of_separation(dtype, tolerance):
    """With the nearest points found by the library, away from the origin: the deepest point is as deep as the pair."""
    floor, box = rb.HalfSpace((0.0, 0.0, 1.0), 0.0), rb.Box((0.4, 0.3, 0.2))
    still, pose = at(0, 0, 5.0, dtype), at(100.2, 0.1, 5.195, dtype, (0.01, 0.002, 0.4))

    def both(still, pose):
        contact = rb.separation(floor, still, box, pose)
        return contact, manifold(contact, floor, still, box, pose)

    contact, found = jax.jit(both, compiler_options=QUICK)(still, pose)
    points, distances = listed(found)
    tol = tolerance(float64=1e-12, float32=1e-5)
    assert distances.min() == pytest.approx(float(contact.distance), abs=tol)
    assert points[:, 2] == pytest.approx(5.0 + 0.5 * distances, abs=tol)


def test_batch_of_pairs_gives_what_each_gives_alone(run, dtype):
    large, small = rb.Box((1.0, 1.0, 0.5)), rb.Box((0.4, 0.3, 0.2))
    still, poses = at(0, 0, -0.5, dtype), [at(x, 0.0, 0.19, dtype, (0, 0, x)) for x in (0.0, 0.5, 0.9)]
    contact = standing(0.01, dtype)
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)
    many = jax.jit(
        jax.vmap(lambda pose: manifold(contact, large, still, small, pose)), compiler_options=QUICK
    )(batch)
    for i, pose in enumerate(poses):
        alone = run(contact, large, still, small, pose)
        order, own = np.argsort(np.asarray(many.feature)[i]), np.argsort(np.asarray(alone.feature))
        assert np.asarray(many.position)[i][order] == pytest.approx(np.asarray(alone.position)[own], abs=1e-5)


def test_capacity_below_one_is_refused(dtype):
    box, place = rb.Box((1.0, 1.0, 1.0)), at(0, 0, 0, dtype)
    with pytest.raises(WrongStructure, match="capacity is 0"):
        manifold(standing(0.0, dtype), box, place, box, place, capacity=0)
