"""The hierarchy of boxes and what is found with it: the same as by looking at every pair, or an overflow said aloud."""

import jax
import jax.numpy as jnp
import mesh_samples as samples
import numpy as np
import pytest
from rotation_samples import QUICK, largest

import jaxrb as rb
from jaxrb.collision.mesh_pairs import MeshTree, meeting_triangles, mesh_distance
from jaxrb.collision.triangles import closest_points, triangles_meet
from jaxrb.errors import InvalidInput, LimitExceeded, WrongStructure
from jaxrb.geometry.hierarchy import hierarchy_of

LANES = 1024


def typed(tree, dtype):
    """Numbers in the type of the run, so that a first call and a later one are one program."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype if x.dtype.kind == "f" else x.dtype), tree)


def poses(dtype, count=8):
    """Poses of the second mesh from deep inside the first to far away."""
    random = np.random.default_rng(0)
    offsets = np.linspace(0.0, 2.6, count)[:, None] * samples_direction(random, count)
    turns = random.normal(size=(count, 3))
    return rb.Pose(jnp.asarray(offsets, dtype), jax.vmap(rb.Quaternion.exp)(jnp.asarray(turns, dtype)))


def samples_direction(random, count):
    v = random.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def trees(dtype):
    """A sphere and a ring, of numbers of triangles that are no powers of two."""
    sphere, ring = rb.TriangleMesh(*samples.sphere(2)), rb.TriangleMesh(*samples.torus(around=18, across=9))
    return typed((MeshTree.of(sphere), MeshTree.of(ring)), dtype)


@pytest.fixture(scope="module")
def start(dtype):
    return rb.Pose(
        jnp.asarray([0.1, -0.2, 0.3], dtype), rb.Quaternion.exp(jnp.asarray([0.5, 0.4, -0.3], dtype))
    )


@pytest.fixture(scope="module")
def brute(trees, start):
    """Every pair of triangles: whether it meets, and its squared distance; `brute(pose)` → (n, m), (n, m)."""
    first, second = trees
    numbers = np.stack(np.unravel_index(np.arange(320 * 324), (320, 324)))
    blocks = jnp.asarray(np.pad(numbers, ((0, 0), (0, -numbers.shape[1] % LANES))).reshape(2, -1, LANES))

    def of(pose):
        # In the frame of the first mesh, as the hierarchy does it.
        rotation = (start.orientation.inverse() @ pose.orientation).as_matrix()
        offset = start.orientation.unrotate(pose.position - start.position)
        one = first.mesh.corners()
        other = jnp.einsum("...j,ij->...i", second.mesh.corners(), rotation, precision="highest") + offset

        def block(pair):
            a, b = (t.reshape(-1, 9)[i].T.reshape(3, 3, -1) for t, i in zip((one, other), pair))
            return triangles_meet(a, b), closest_points(a, b).squared

        return jax.tree.map(lambda x: x.ravel()[: 320 * 324], jax.lax.map(block, jnp.moveaxis(blocks, 1, 0)))

    return jax.jit(of, compiler_options=QUICK)


@pytest.fixture(scope="module")
def meeting(trees, start):
    return jax.jit(
        lambda pose: meeting_triangles(trees[0], start, trees[1], pose, capacity=4096), compiler_options=QUICK
    )


@pytest.fixture(scope="module")
def distance(trees, start):
    return jax.jit(lambda pose: mesh_distance(trees[0], start, trees[1], pose), compiler_options=QUICK)


def one_of(batch, i):
    return jax.tree.map(lambda x: x[i], batch)


def test_meeting_triangles_are_those_of_brute_force(meeting, brute, dtype):
    counts = []
    for i in range(8):
        pose = one_of(poses(dtype), i)
        found = meeting(pose)
        expected = np.flatnonzero(np.asarray(brute(pose)[0]))
        pairs = np.asarray(found.first[: int(found.count)]) * 324 + np.asarray(
            found.second[: int(found.count)]
        )
        assert np.array_equal(np.sort(pairs), expected)
        assert not found.overflow
        assert (np.asarray(found.first[int(found.count) :]) == -1).all()
        assert float(found.saved) > 0.8
        counts.append(len(pairs))
    assert max(counts) > 100
    assert min(counts) == 0  # the farthest poses are apart


def test_distance_of_meshes_is_that_of_brute_force(distance, brute, dtype, tolerance):
    small = tolerance(float64=1e-13, float32=3e-6)
    apart = 0
    for i in range(8):
        pose = one_of(poses(dtype), i)
        found, (meet, squared) = distance(pose), brute(pose)
        expected = 0.0 if np.asarray(meet).any() else np.sqrt(np.asarray(squared).min())
        assert float(found.distance) == pytest.approx(expected, abs=small)
        gap = np.asarray(found.point_b) - np.asarray(found.point_a)
        assert np.linalg.norm(gap) == pytest.approx(expected, abs=small)
        assert not found.overflow
        apart += expected > 0
    assert 2 <= apart <= 6


@pytest.fixture(scope="module")
def slope(trees, start):
    """`slope(pose, u)`: the gradient of the distance in the position of the second mesh, and its rate along u."""

    def along(pose, u):
        def of(position):
            return mesh_distance(trees[0], start, trees[1], rb.Pose(position, pose.orientation)).distance

        return jax.jvp(jax.grad(of), (pose.position,), (u,))

    return jax.jit(along, compiler_options=QUICK)


def test_distance_has_first_and_second_derivatives_in_the_poses(distance, slope, dtype, tolerance):
    """∂d/∂p is the unit vector between the nearest points; the Hessian is symmetric and is felt only across it."""
    largest_bend = 0.0
    for i in (4, 5, 6, 7):
        pose = one_of(poses(dtype), i)
        found = distance(pose)
        if float(found.distance) < 0.02:
            continue
        normal = np.asarray(found.point_b - found.point_a, np.float64) / float(found.distance)
        directions = np.linalg.svd(normal[None])[2]
        first = np.asarray(slope(pose, pose.position)[0])
        bend = np.stack([slope(pose, jnp.asarray(u, dtype))[1] for u in directions]) @ directions.T
        small = tolerance(float64=1e-12, float32=1e-4) / float(found.distance)
        assert largest(first - normal) < small
        assert largest(bend - bend.T) < small
        assert largest(bend[0]) < small
        step = tolerance(float64=1e-6, float32=1e-2)
        for k in (1, 2):
            shift = jnp.asarray(step * directions[k], dtype)
            ahead, behind = (
                np.asarray(slope(rb.Pose(pose.position + s * shift, pose.orientation), shift)[0])
                for s in (1, -1)
            )
            rate = (ahead - behind) / (2 * step) @ directions.T
            assert rate == pytest.approx(bend[k], abs=tolerance(float64=1e-6, float32=0.05))
        largest_bend = max(largest_bend, largest(bend))
    assert largest_bend > 0.1  # a corner above a face has none; an edge beside an edge has


def test_meeting_meshes_have_finite_derivatives(slope, dtype):
    for i in (0, 3):
        pose = one_of(poses(dtype), i)
        assert np.isfinite(np.asarray(slope(pose, pose.position))).all()


def test_too_small_a_capacity_is_said_aloud(trees, start, dtype):
    pose = one_of(poses(dtype), 1)
    few = jax.jit(
        lambda pose: meeting_triangles(trees[0], start, trees[1], pose, capacity=64), compiler_options=QUICK
    )(pose)
    assert bool(few.overflow)
    assert int(few.count) == 64
    with pytest.raises(LimitExceeded, match="more than capacity=64"):
        few.raise_if_overflowed()


def test_batch_of_poses_gives_what_each_gives_alone(trees, start, meeting, dtype):
    batch = one_of(poses(dtype), slice(2, 5))
    found = jax.jit(jax.vmap(lambda pose: meeting_triangles(trees[0], start, trees[1], pose, capacity=4096)))(
        batch
    )
    for i in range(3):
        alone = meeting(one_of(batch, i))
        count = int(alone.count)
        assert int(found.count[i]) == count
        both = ((found.first[i], found.second[i]), (alone.first, alone.second))
        pairs = [{*zip(np.asarray(a)[:count].tolist(), np.asarray(b)[:count].tolist())} for a, b in both]
        assert pairs[0] == pairs[1]


def test_refitted_tree_bounds_its_moved_triangles(trees):
    """Each box holds its children's boxes, each leaf its triangle; as built and after the vertices moved."""
    ring = trees[1]
    bent = ring.mesh.vertices * (1.0 + 0.3 * ring.mesh.vertices[:, :1])
    for tree in (ring, ring.refitted(bent)):
        family = np.asarray(tree.hierarchy.family, np.float64).reshape(-1, 2, 2, 3)
        items = np.asarray(tree.hierarchy.items)
        leaves = len(items)
        corners = np.asarray(tree.mesh.corners(), np.float64)
        own = family[leaves:, 0][items >= 0]
        slack = 1e-6
        assert (np.abs(corners[items[items >= 0]] - own[:, None, 0]) <= own[:, None, 1] + slack).all()
        for node in range(2, leaves):
            center, half = family[node // 2, node % 2]
            inner = family[node]
            assert (np.abs(inner[:, 0] - center) + inner[:, 1] <= half + slack).all()
        assert np.array_equal(np.sort(items[items >= 0]), np.arange(len(corners)))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 64, 65])
def test_trees_of_any_number_of_boxes_hold_each_once(count):
    low = np.random.default_rng(count).normal(size=(count, 3))
    tree = hierarchy_of(low, low + 0.1)
    assert np.array_equal(np.sort(tree.items[tree.items >= 0]), np.arange(count))
    assert tree.leaves == len(tree.items) < 2 * count
    assert tree.family.shape == (2 * tree.leaves, 12)


def test_boxes_that_are_none_are_refused():
    with pytest.raises(InvalidInput, match="box 1"):
        hierarchy_of([[0.0, 0, 0], [1, 0, 0]], [[1.0, 1, 1], [0, 1, 1]])
    with pytest.raises(InvalidInput, match="box 0"):
        hierarchy_of([[np.nan, 0, 0]], [[1.0, 1, 1]])
    with pytest.raises(WrongStructure, match="at least 1"):
        hierarchy_of(np.empty((0, 3)), np.empty((0, 3)))


def crosses(p, q, triangle):
    """Whether segment p q meets a triangle in exact whole numbers; None where it lies in its plane."""
    a, b, c = triangle

    def volume(u, v, w, x):
        return int(np.dot(v - u, np.cross(w - u, x - u)))

    above, below = volume(a, b, c, p), volume(a, b, c, q)
    if above == 0 and below == 0:
        return None
    if above * below > 0:
        return False
    sides = [volume(p, q, u, v) for u, v in ((a, b), (b, c), (c, a))]
    return min(sides) >= 0 or max(sides) <= 0


def test_triangles_meet_where_an_edge_of_one_crosses_the_other(dtype):
    """Whole-number corners in a small cube: many pairs touch in a point or share an edge; both answers are exact."""
    random = np.random.default_rng(0)
    corners = random.integers(0, 4, (6000, 2, 3, 3))
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    corners = corners[(np.abs(normals).sum(-1) > 0).all(-1)]
    lanes = jnp.asarray(np.moveaxis(corners, 0, -1), dtype)
    found = np.asarray(jax.jit(triangles_meet)(lanes[0], lanes[1]))
    decided = 0
    for (a, b), meet in zip(corners, found):
        tests = [crosses(t[i], t[(i + 1) % 3], other) for t, other in ((a, b), (b, a)) for i in range(3)]
        if None in tests and not any(tests):
            continue  # of triangles with an edge in the other's plane the next test speaks
        assert any(tests) == bool(meet), (a, b)
        decided += 1
    assert decided > 3000
    assert 0.2 < found.mean() < 0.8


@pytest.mark.parametrize(
    ("move", "meet"),
    [
        ((0, 0), True),
        ((0.3, 0.3), True),
        ((1, 0), True),
        ((1.01, 0), False),
        ((0.6, 0.6), False),
        ((-0.2, 0.5), True),
    ],
)
def test_triangles_in_one_plane_meet_where_they_overlap(move, meet, dtype):
    plane = np.array([[0, 0, 1.0], [1, 0, 1.0], [0, 1, 1.0]])
    moved = plane + np.array([*move, 0])
    for axes in (np.eye(3), np.eye(3)[[2, 0, 1]]):
        a, b = (jnp.asarray(t @ axes, dtype)[..., None] for t in (plane, moved))
        assert bool(triangles_meet(a, b)[0]) == meet
