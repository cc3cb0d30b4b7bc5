"""Points of contact by closed forms: as deep as the exact distance, where they should be, named to be found again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pairs import at_origin, box_by_fifteen_axes, on_device, poses, turns
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.collision.touch import contact_points, slots
from jaxrb.errors import WrongStructure

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
FLOOR = rb.HalfSpace((0.2, -0.1, 1.0), 0.1)
STANDING = {
    "sphere": rb.Sphere(0.3),
    "capsule": rb.Capsule(0.2, 0.5),
    "box": rb.Box((0.4, 0.3, 0.2)),
    "cylinder": rb.Cylinder(0.3, 0.4),
    "cone": rb.Cone(0.3, 0.7),
    "ellipsoid": rb.Ellipsoid((0.2, 0.4, 0.6)),
    "hull": rb.ConvexHull(np.random.default_rng(1).normal(size=(20, 3))),
}
ROUND = {
    "spheres": (rb.Sphere(0.3), rb.Sphere(0.4)),
    "sphere and capsule": (rb.Sphere(0.3), rb.Capsule(0.2, 0.5)),
    "capsules": (rb.Capsule(0.2, 0.5), rb.Capsule(0.1, 0.7)),
    "box and sphere": (rb.Box((0.4, 0.3, 0.2)), rb.Sphere(0.3)),
    "box and capsule": (rb.Box((0.4, 0.3, 0.2)), rb.Capsule(0.15, 0.5)),
}
EVERY = {name: (FLOOR, shape) for name, shape in STANDING.items()} | ROUND
EVERY["boxes"] = (rb.Box((0.4, 0.3, 0.2)), rb.Box((0.3, 0.5, 0.1)))


def at(x, y, z, dtype, turn=(0.0, 0.0, 0.0)):
    return rb.Pose(jnp.asarray([x, y, z], dtype), rb.Quaternion.exp(jnp.asarray(turn, dtype)))


def places(seed, count, dtype, spread=0.6):
    generator = np.random.default_rng(seed)
    one, other = (
        poses(spread * generator.normal(size=(count, 3)), turns(generator, count), dtype) for _ in "ab"
    )
    return one, other


def host(found):
    return jax.tree.map(lambda x: np.asarray(x, float if x.dtype.kind == "f" else None), found)


def place(x):
    """A pose from seven numbers."""
    return rb.Pose(x[:3], rb.Quaternion(x[3:]).normalise())


def fifteen(a, b, position_a, quaternion_a, position_b, quaternion_b):
    """The answer of the fifteen axes for two boxes at many places."""
    turned = [
        np.asarray(rb.Quaternion(jnp.asarray(q)).as_matrix(), float) for q in (quaternion_a, quaternion_b)
    ]
    places = [np.asarray(p, float) for p in (position_a, position_b)]
    halves = [np.broadcast_to(s.half_extents, places[0].shape) for s in (a, b)]
    return box_by_fifteen_axes(halves[0], turned[0], places[0], halves[1], turned[1], places[1])


def deepest(found):
    return np.where(found.valid, found.distance, np.inf).min(axis=-1)


def listed(found):
    """Points and distances of one pair, in order of x, then y."""
    points, distances = found.position[found.valid], found.distance[found.valid]
    order = np.lexsort(np.round(points, 4).T[::-1])
    return points[order], distances[order]


@pytest.fixture(scope="module")
def many():
    """Compiled once for each pair of kinds: a batch of pairs of two shapes."""
    batched = jax.vmap(contact_points, in_axes=(None, 0, None, 0))
    compiled = jax.jit(batched, compiler_options=QUICK)
    return lambda *pair: host(compiled(*pair))


@pytest.fixture(scope="module")
def boxes(dtype):
    """Compiled once: two boxes at places given as numbers of the host, each with sizes of its own."""
    compiled = jax.jit(jax.vmap(contact_points), compiler_options=QUICK)

    def touching(*pairs):
        count = 16
        assert len(pairs) <= count
        filled = [*pairs, *[pairs[-1]] * (count - len(pairs))]
        batch = [
            jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v, dtype) for v in x]), *column)
            for column in zip(*filled)
        ]
        found = host(compiled(*batch))
        return [jax.tree.map(lambda x, k=k: x[k], found) for k in range(len(pairs))]

    return touching


@pytest.mark.parametrize("name", STANDING | ROUND)
def test_deepest_point_is_as_far_as_the_exact_distance(name, many, dtype, tolerance):
    """Against `separation`, apart and overlapping; the nearest point lies midway between those of the surfaces."""
    a, b = EVERY[name]
    pose_a, pose_b = places(2, 64, dtype)
    found = many(a, pose_a, b, pose_b)
    exact = host(
        jax.jit(jax.vmap(rb.separation, (None, 0, None, 0)), compiler_options=QUICK)(
            *on_device((a, pose_a, b, pose_b), dtype)
        )
    )
    assert (exact.distance > 0).any()
    assert (exact.distance < 0).any()
    tol = tolerance(float64=1e-12, float32=1e-5)
    assert np.abs(deepest(found) - exact.distance).max() <= tol
    assert np.abs(found.normal - exact.normal).max() <= 30 * tol
    first = np.where(found.valid, found.distance, np.inf).argmin(axis=1)
    middle = 0.5 * (exact.point_a + exact.point_b)
    assert np.abs(found.position[np.arange(64), first] - middle).max() <= 100 * tol
    assert found.valid.shape[1] == slots(a, b) == slots(b, a)


def test_boxes_that_overlap_are_as_deep_as_their_fifteen_axes_say(many, dtype, tolerance):
    """Exactly so for most; a face is preferred to a better axis by no more than its share. Apart they are no nearer."""
    a, b = EVERY["boxes"]
    pose_a, pose_b = places(3, 2000, dtype, spread=0.3)
    found = many(a, pose_a, b, pose_b)
    numbers = (v for pose in (pose_a, pose_b) for v in (pose.position, pose.orientation.wxyz))
    exact = fifteen(a, b, *numbers)
    slack = 2e-5 * (a.half_extents.sum() + b.half_extents.sum())
    error = deepest(found) - exact
    inside = exact < 0
    assert inside.sum() > 500
    assert np.quantile(np.abs(error[inside]), 0.98) <= tolerance(float64=1e-12, float32=2e-6)
    assert np.abs(error[inside]).max() <= 2 * slack
    assert error.min() >= -2 * slack
    assert found.valid[:, 0].all()


def test_box_on_a_box_touches_at_the_corners_of_what_they_share(boxes, dtype, tolerance):
    """Standing within the other's face, over its edge, equal and in line, turned by an eighth, tilted by a hair."""
    large, small, cube = rb.Box((1.0, 1.0, 0.5)), rb.Box((0.4, 0.3, 0.2)), rb.Box((0.5, 0.5, 0.5))
    below = at(0, 0, -0.5, dtype)
    found = boxes(
        (large, below, small, at(0.1, 0.0, 0.19, dtype)),
        (large, below, small, at(0.9, 0.0, 0.19, dtype)),
        (cube, below, cube, at(0, 0, 0.49, dtype)),
        (cube, below, cube, at(0, 0, 0.51, dtype, (1e-9, -1e-9, 1e-9))),
        (cube, below, cube, at(0, 0, 0.49, dtype, (0, 0, np.pi / 4))),
        (small, at(0.1, 0.0, 0.19, dtype), large, below),
    )
    tol = tolerance(float64=1e-12, float32=1e-6)
    for k, xs, ys in (
        (0, (-0.3, 0.5), 0.3),
        (1, (0.5, 1.0), 0.3),
        (2, (-0.5, 0.5), 0.5),
        (5, (-0.3, 0.5), 0.3),
    ):
        points, distances = listed(found[k])
        assert points == pytest.approx(np.array([[x, y, -0.005] for x in xs for y in (-ys, ys)]), abs=tol)
        assert distances == pytest.approx(-0.01, abs=tol)
        assert found[k].normal == pytest.approx([0, 0, -1.0 if k == 5 else 1.0])
    points, distances = listed(found[3])
    assert points == pytest.approx(
        np.array([[x, y, 0.005] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]), abs=3e-9 + tol
    )
    assert distances == pytest.approx(0.01, abs=2e-9 + tol)
    points, _ = listed(found[4])
    assert np.hypot(*points.T[:2]) == pytest.approx(0.5 / np.cos(np.pi / 8), abs=tol)
    angles = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    assert np.diff(np.append(angles, angles[0] + 2 * np.pi)).max() < 0.76 * np.pi


@pytest.mark.parametrize(
    "sizes", [((0.1, 0.1, 0.1), (0.1, 0.1, 0.1)), ((0.5, 0.25, 0.5), (0.25, 0.25, 0.125))]
)
def test_boxes_whose_sides_lie_in_line_touch_at_the_corners_of_what_they_share(sizes, many, dtype, tolerance):
    """Shifted along one side or two, by hairs or by much, on each of the six faces and after each quarter turn: a side
    that lies in the other's side is neither entered nor left by it."""
    one, other = np.array(sizes)
    shifts = np.array([-1.0, -0.9, -0.1, -1e-7, 0.0, 1e-7, 0.1, 0.9, 1.0])
    cases = np.array(np.meshgrid(range(3), (-1, 1), (-0.01, 0.02), shifts, shifts, range(4))).reshape(6, -1).T
    axis, side, gap, one_shift, two_shift, quarters = cases.T
    axis, quarters, count = axis.astype(int), quarters.astype(int), len(cases)
    rows = np.arange(count)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    # As many quarter turns about the axis of the faces: odd ones exchange the half edges along the others.
    half = np.broadcast_to(other, (count, 3)).copy()
    odd = quarters % 2 == 1
    half[rows[odd], first[odd]], half[rows[odd], second[odd]] = other[second[odd]], other[first[odd]]
    room = one + half
    centre = np.zeros((count, 3))
    centre[rows, first] = one_shift * (one[first] - half[rows, first] + 0.9 * half[rows, first])
    centre[rows, second] = two_shift * (one[second] - half[rows, second] + 0.9 * half[rows, second])
    centre[rows, axis] = side * (room[rows, axis] + gap)
    turn = np.array([[1, 0, 0, 0], [1, 0, 0, 1], [0, 0, 0, 1], [-1, 0, 0, 1]]) / np.sqrt([[1], [2], [1], [2]])
    quaternions = np.zeros((count, 4))
    quaternions[:, 0], quaternions[rows, 1 + axis] = turn[quarters, 0], turn[quarters, 3]
    poses_a = poses(np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1)), dtype)
    found = many(rb.Box(one), poses_a, rb.Box(other), poses(centre, quaternions, dtype))
    low, high = np.maximum(-one, centre - half), np.minimum(one, centre + half)
    corners = np.stack([np.where(np.array(pick), high, low) for pick in np.ndindex(2, 2, 2)], axis=1)
    middle = side * one[axis] + 0.5 * side * gap
    np.put_along_axis(corners, np.repeat(axis, 8).reshape(count, 8, 1), middle[:, None, None], axis=2)
    assert found.valid.all()
    tol = tolerance(float64=1e-12, float32=2e-7) + 3e-4 * one.max() * (np.abs(cases[:, 3:5]) == 1e-7).any(
        axis=1
    )
    assert (np.abs(found.distance - gap[:, None]).max(axis=1) <= tol).all()
    away = np.abs(found.position[:, :, None] - corners[:, None]).max(axis=-1)
    assert (away.min(axis=1).max(axis=1) <= tol).all()
    assert (away.min(axis=2).max(axis=1) <= tol).all()


@pytest.mark.parametrize("gap", [-0.03, 0.0, 0.4])
def test_crossed_edges_touch_in_one_point_midway(gap, boxes, dtype, tolerance):
    """Two cubes, each standing on an edge, the edges at right angles one above the other, away from the origin."""
    cube, high = rb.Box((0.5, 0.5, 0.5)), 0.5 * np.sqrt(2)
    lower = at(100.0, 7.0, -high, dtype, (np.pi / 4, 0, 0))
    upper = at(100.1, 7.2, high + gap, dtype, (0, np.pi / 4, 0))
    (found, turned) = boxes((cube, lower, cube, upper), (cube, upper, cube, lower))
    tol = tolerance(float64=1e-12, float32=2e-5)
    for one, sign in ((found, 1.0), (turned, -1.0)):
        points, distances = listed(one)
        assert points == pytest.approx(np.array([[100.1, 7.0, 0.5 * gap]]), abs=tol)
        assert distances == pytest.approx([gap], abs=tol)
        assert one.normal == pytest.approx([0, 0, sign], abs=tol)


def test_boxes_apart_by_corner_and_side_know_their_distance(boxes, dtype, tolerance):
    """A cube that stands on its corner far above a plate; and one beside it, where no side faces a corner."""
    plate, cube = rb.Box((1.0, 1.0, 0.1)), rb.Box((0.2, 0.2, 0.2))
    tip = np.arctan(np.sqrt(2)) * np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    above, beside = at(0.3, 0.2, 0.9, dtype, tip), at(1.4, 1.5, 0.5, dtype)
    over, aside = boxes((plate, at(0, 0, 0, dtype), cube, above), (plate, at(0, 0, 0, dtype), cube, beside))
    tol = tolerance(float64=1e-12, float32=1e-6)
    assert deepest(over) == pytest.approx(0.8 - 0.2 * np.sqrt(3), abs=tol)
    assert over.normal == pytest.approx([0, 0, 1])
    # 0.2, 0.3 and 0.2 apart along the three axes: the largest is a lower bound.
    assert np.sum(aside.valid) == 1
    assert deepest(aside) == pytest.approx(0.3, abs=tol)


def test_points_keep_their_names_while_boxes_slide_and_rock(boxes, dtype):
    """Also equal boxes in line, whose corners fall on each other's edges and tremble about them."""
    large, small, cube = rb.Box((1.0, 1.0, 0.5)), rb.Box((0.4, 0.3, 0.2)), rb.Box((0.5, 0.5, 0.5))
    below, moves = at(0, 0, -0.5, dtype), ((0.0, 1e-5), (3e-5, -1e-5), (-2e-5, 2e-5))
    found = boxes(
        *((large, below, small, at(0.8 + x, 0.02, 0.199, dtype, (t, t, 0.3))) for x, t in moves),
        *((cube, below, cube, at(x, -x, 0.499, dtype, (t, -t, t))) for x, t in moves),
        (cube, below, cube, at(0, 0, 0.499, dtype)),
    )
    for group in (found[:3], found[3:]):
        names = [set(one.feature.tolist()) for one in group]
        assert all(len(name) == 4 for name in names)
        assert all(name == names[0] for name in names)


def test_standing_bodies_have_their_points_where_they_can_carry(dtype, tolerance):
    """A coin upright, on its side and leaning; a box on a face; a hull on a face of four corners with more above."""
    floor, still, tol = rb.HalfSpace(), at_origin(dtype), tolerance(float64=1e-12, float32=1e-6)
    touch = jax.jit(contact_points, compiler_options=QUICK)
    coin = rb.Cylinder(0.5, 0.1)

    def low(shape, pose):
        found = host(touch(floor, still, shape, pose))
        near = found.valid & (found.distance < 1e-3)
        return found.position[near], found.feature[near]

    points, _ = low(coin, at(3, 0, 0.1, dtype))
    assert len(points) == 3
    assert np.hypot(points[:, 0] - 3, points[:, 1]) == pytest.approx(0.5, abs=tol)
    assert points.mean(axis=0) == pytest.approx([3, 0, 0], abs=tol)
    # Upright but for round-off: the points do not run round the rim.
    tremble = 4 * float(jnp.finfo(dtype).eps)
    for tilt in ((tremble, 0, 0), (0, -tremble, 0), (-tremble, tremble, 0)):
        assert low(coin, at(3, 0, 0.1, dtype, tilt))[0] == pytest.approx(points, abs=tol)
    points, names = low(coin, at(3, 0, 0.5, dtype, (np.pi / 2, 0, 0)))
    assert np.sort(points[:, 1]) == pytest.approx([-0.1, 0.1], abs=tol)
    assert set(low(coin, at(3, 0, 0.5, dtype, (np.pi / 2 + 1e-4, 0, 0)))[1]) == set(names)
    assert set(low(coin, at(3, 0, 0.5, dtype, (np.pi / 2 - 1e-4, 0, 0)))[1]) == set(names)
    assert len(low(coin, at(3, 0, 0.5 * np.sin(0.4) + 0.1 * np.cos(0.4), dtype, (0.4, 0, 0)))[0]) == 1
    assert len(low(rb.Cone(0.5, 0.8), at(0, 0, 0, dtype))[0]) == 3
    half = np.array([0.4, 0.3, 0.2])
    house = rb.ConvexHull(np.vstack([CUBE * half, [[0.1, 0.05, 0.3]]]))
    for shape in (rb.Box(half), house):
        points, _ = low(shape, at(0, 0, 0.2, dtype, (0, 0, 0.0)))
        assert points[np.lexsort(np.round(points, 4).T[::-1])] == pytest.approx(
            np.array([[x, y, 0] for x in (-0.4, 0.4) for y in (-0.3, 0.3)]), abs=tol
        )


def test_capsules_side_by_side_rest_on_both_ends(dtype, tolerance):
    tol = tolerance(float64=1e-12, float32=1e-6)
    touch = jax.jit(contact_points, compiler_options=QUICK)
    long, short = rb.Capsule(0.1, 0.5), rb.Capsule(0.2, 0.4)
    lying = (0, np.pi / 2, 0)
    found = host(touch(long, at(0, 0, 0, dtype, lying), short, at(0.3, 0, 0.29, dtype, lying)))
    points, distances = listed(found)
    assert points == pytest.approx(np.array([[-0.1, 0, 0.095], [0.5, 0, 0.095]]), abs=tol)
    assert distances == pytest.approx(-0.01, abs=tol)
    crossed = host(touch(long, at(0, 0, 0, dtype, lying), short, at(0.3, 0, 0.31, dtype, (np.pi / 2, 0, 0))))
    assert listed(crossed)[0] == pytest.approx(np.array([[0.3, 0, 0.105]]), abs=tol)
    plate = rb.Box((0.5, 1.0, 0.5))
    found = host(touch(short, at(0.3, 0, 0.69, dtype, lying), plate, at(0, 0, 0, dtype)))
    points, distances = listed(found)
    assert points == pytest.approx(np.array([[-0.1, 0, 0.495], [0.5, 0, 0.495]]), abs=tol)
    assert distances == pytest.approx(-0.01, abs=tol)
    assert found.normal == pytest.approx([0, 0, -1], abs=tol)


@pytest.mark.parametrize("name", ["box", "cylinder", "hull", *ROUND, "boxes"])
def test_answer_turns_with_the_pair_and_flips_with_its_order(name, many, dtype, tolerance):
    """The same rigid motion of both shapes moves the points; of unlike kinds (b, a) is (a, b), its normal turned."""
    a, b = EVERY[name]
    pose_a, pose_b = places(5, 64, dtype, spread=0.4)
    turn, shift = (
        rb.Quaternion(jnp.asarray(turns(np.random.default_rng(6), 1)[0], dtype)),
        np.array([1.0, -2, 3]),
    )

    def moved(pose):
        return rb.Pose(turn.rotate(pose.position) + shift, jax.vmap(lambda q: turn @ q)(pose.orientation))

    here, there = many(a, pose_a, b, pose_b), many(a, moved(pose_a), b, moved(pose_b))
    tol = tolerance(float64=1e-11, float32=1e-4)
    same = (here.valid == there.valid).all(axis=1) & (here.feature == there.feature).all(axis=1)
    assert same.mean() > 0.95
    matrix = np.asarray(turn.as_matrix(), float)
    assert np.abs(here.normal @ matrix.T - there.normal)[same].max() <= tol
    expected = np.where(here.valid[..., None], here.position @ matrix.T + shift, 0.0)
    assert np.abs(expected - there.position)[same].max() <= tol
    assert np.abs(here.distance - there.distance)[same].max() <= tol
    if name in ("box", "sphere and capsule", "box and sphere"):
        back = host(
            jax.jit(jax.vmap(contact_points, (0, 0, None, 0)), compiler_options=QUICK)(
                jax.tree.map(lambda x: jnp.broadcast_to(x, (64, *np.shape(x))), b), pose_b, a, pose_a
            )
        )
        assert (back.normal == -here.normal).all()
        assert (back.position == here.position).all()


@pytest.mark.parametrize("name", EVERY)
def test_derivatives_are_finite_at_the_unsafe_places_and_distances_follow_translations(
    name, dtype, tolerance
):
    """In one place, in line, touching exactly, a hair away; and the deepest distance obeys d = n · (dp_b − dp_a)."""
    a, b = EVERY[name]
    generator = np.random.default_rng(7)
    special = np.tile(np.array([0.0, 0, 0, 1, 0, 0, 0]), (8, 2))
    special[1, 7], special[2, 8], special[3, 9], special[4, 9] = 1e-12, 0.3, 0.4, 0.7
    special[5, 7:10] = 0.4, 0.3, 0.2
    special[6, 10:12] = np.sqrt(0.5)
    special[7, 7:10] = 3.0, 3.0, 3.0
    generic = np.hstack([0.2 * generator.normal(size=(56, 3)), turns(generator, 56)])
    generic = np.hstack([generic, np.roll(generic, 1, axis=0)])
    x = jnp.asarray(np.vstack([special, generic]), dtype)

    def touching(x):
        found = contact_points(a, place(x[:7]), b, place(x[7:]))
        return (found.distance, found.position, found.normal), found.valid

    def answers(x):
        found, pull, valid = jax.vjp(touching, x, has_aux=True)
        distance, position, normal = found
        nearest = jnp.argmin(jnp.where(valid, distance, jnp.inf))
        one = (jax.nn.one_hot(nearest, len(distance), dtype=x.dtype), jnp.zeros_like(position), 0 * normal)
        every = jax.tree.map(jnp.ones_like, found)
        rows = jax.vmap(lambda *cotangents: pull(cotangents)[0])(
            *(jnp.stack(parts) for parts in zip(one, every))
        )
        return rows, distance[nearest], normal

    def both(x):
        along = jnp.linspace(-1.0, 1.0, 14).astype(x.dtype)
        return jax.jvp(answers, (x,), (along,))

    # Not compiled as one: the derivatives of two boxes are compiled in 30 s, and done one by one in 3.
    found, bend = jax.vmap(both)(x)
    for part in jax.tree.leaves((found, bend)):
        assert np.isfinite(part).all()
    rows, distance, normal = (np.asarray(v, float) for v in found)
    follows = rows[:, 0]
    plain = np.arange(64) >= 8
    if name == "boxes":
        # Not where the nearest point is a corner of the face below: it slides along the leaning face above.
        plain &= np.abs(distance - fifteen(a, b, x[:, :3], x[:, 3:7], x[:, 7:10], x[:, 10:])) < 1e-6
        assert plain.sum() > 20
    tol = tolerance(float64=1e-10, float32=1e-4)
    assert np.abs(follows[:, 7:10] - normal)[plain].max() <= tol
    assert np.abs(follows[:, :3] + normal)[plain].max() <= tol


def test_parts_stand_each_on_its_own(dtype, tolerance):
    """A table on four legs: each leg has its points on the floor, with names of its own; on a box the nearest leg's."""
    leg = rb.Box((0.05, 0.05, 0.4))
    legs = [(leg, rb.Pose(np.array([x, y, 0.0]), rb.Quaternion.identity())) for x in (-1, 1) for y in (-1, 1)]
    table, still = rb.Composite(legs), at_origin(dtype)
    touch = jax.jit(contact_points, compiler_options=QUICK)
    found = host(touch(rb.HalfSpace(), still, table, at(0, 0, 0.39, dtype)))
    assert slots(rb.HalfSpace(), table) == len(found.valid) == 16
    assert found.valid.all()
    assert len(set(found.feature.tolist())) == 16
    assert found.distance == pytest.approx(-0.01, abs=tolerance(float64=1e-12, float32=1e-6))
    ground = rb.Box((3.0, 3.0, 0.5))
    ground, two = rb.Box((3.0, 3.0, 0.5)), rb.Composite(legs[1:3])
    leaning = at(0, 0, 0.39, dtype, (0.02, 0.02, 0))
    found = host(touch(two, leaning, ground, at(0, 0, -0.5, dtype)))
    assert slots(two, ground) == len(found.valid) == 4
    assert found.position[found.valid][:, :2].mean(axis=0) == pytest.approx([1, -1], abs=0.05)
    assert (found.feature[found.valid] % 2 == 1).all()


def test_pairs_without_a_form_of_their_own_are_searched(dtype, tolerance):
    hull, box = rb.ConvexHull(CUBE * 0.5), rb.Box((1.0, 1.0, 0.5))
    touch = jax.jit(contact_points, compiler_options=QUICK)
    found = host(touch(box, at(0, 0, -0.5, dtype), hull, at(0.2, 0, 0.52, dtype)))
    assert slots(box, hull) == len(found.valid) == 4
    points, distances = listed(found)
    tol = tolerance(float64=1e-12, float32=1e-5)
    assert points == pytest.approx(
        np.array([[x, y, 0.01] for x in (-0.3, 0.7) for y in (-0.5, 0.5)]), abs=tol
    )
    assert distances == pytest.approx(0.02, abs=tol)


def test_what_is_no_pair_is_refused(dtype):
    still = at_origin(dtype)
    with pytest.raises(WrongStructure, match="two half-spaces"):
        contact_points(rb.HalfSpace(), still, rb.HalfSpace(), still)
    with pytest.raises(WrongStructure, match="a is given as Sphere with float"):
        contact_points(rb.Sphere(1.0), 0.0, rb.Sphere(1.0), still)
