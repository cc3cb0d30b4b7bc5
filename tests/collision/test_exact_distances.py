"""Distances and depths against exact arithmetic."""

import itertools
from fractions import Fraction

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pairs import at_origin, on_device, separations

import jaxrb as rb


@pytest.fixture(scope="module")
def polytopes(oracle, dtype):
    """1156 pairs of hulls with their exact answers, and which of them are exact in the type of this run."""
    data = dict(np.load(oracle / "collision" / "polytopes.npz"))
    split = [np.split(data[f"vertices_{k}"], data[f"offset_{k}"][1:-1]) for k in "ab"]
    shapes = [on_device(rb.stack_hulls([rb.ConvexHull(v) for v in points]), dtype) for points in split]
    pose = at_origin(dtype)
    contact = separations(shapes[0], pose, shapes[1], pose, (0, None, 0, None))
    data["largest"] = np.array([max(np.abs(a).max(), np.abs(b).max()) for a, b in zip(*split)])
    data["exact"] = np.array([all((v == v.astype(dtype)).all() for v in pair) for pair in zip(*split)])
    return split, data, contact


def test_polytopes_are_as_far_apart_or_as_deep_as_exact_arithmetic_says(polytopes, tolerance):
    _, data, contact = polytopes
    true, largest, exact = data["signed_distance"], data["largest"], data["exact"]
    assert exact.sum() > 200
    assert np.isfinite(contact.distance).all()
    error = np.abs(contact.distance - true) / largest
    assert error[exact].max() <= tolerance(float64=1e-13, float32=1e-6)
    told = np.abs(true) > tolerance(float64=1e-13, float32=1e-6) * largest
    assert (np.sign(contact.distance) == np.sign(true))[exact & told].all()


def test_normals_of_polytopes_are_exact_where_there_is_only_one(polytopes, tolerance):
    split, data, contact = polytopes
    eps = tolerance(float64=2.0**-52, float32=2.0**-23)
    error = np.linalg.norm(contact.normal - data["normal"], axis=1)
    # Where two shapes nearly touch at corners and edges, round-off of their coordinates alone turns the normal.
    gap = np.maximum(np.abs(data["signed_distance"]), 1e-300)
    allowed = tolerance(float64=1e-9, float32=1e-3) + 64 * eps * data["largest"] / gap
    # A centred pair has two ways out of the same length; and some others to within round-off.
    other = [(a @ n).max() - (b @ n).min() for a, b, n in zip(*split, contact.normal)]
    tie = np.abs(np.array(other) + data["signed_distance"]) <= 16 * eps * data["largest"]
    wrong = data["normal_unique"] & data["exact"] & (error > allowed)
    assert (wrong & ~tie).sum() == 0
    assert wrong.sum() <= 0.02 * len(wrong)


def test_witnesses_lie_on_both_shapes_and_as_far_apart_as_the_distance(polytopes, tolerance):
    split, data, contact = polytopes
    # Corners that nearly coincide decide between points as far apart as they are, and the distance cannot tell.
    small = tolerance(float64=5e-9, float32=1e-4) * data["largest"]
    between = contact.point_b - contact.point_a - contact.distance[:, None] * contact.normal
    off = np.abs(between).max(axis=1) / data["largest"]
    exact = data["exact"]
    assert np.quantile(off[exact], 0.98) <= tolerance(float64=1e-12, float32=1e-5)
    assert off[exact].max() <= tolerance(float64=5e-9, float32=1e-4)
    for i in np.nonzero(exact)[0]:
        a, b = split[0][i], split[1][i]
        for points, witness, n in (
            (a, contact.point_a[i], contact.normal[i]),
            (b, contact.point_b[i], -contact.normal[i]),
        ):
            assert abs((points @ n).max() - witness @ n) <= 4 * small[i]
            assert (witness <= points.max(axis=0) + small[i]).all()
            assert (witness >= points.min(axis=0) - small[i]).all()


def test_certificates_of_polytopes_hold_the_exact_distance_and_are_tight(polytopes, tolerance):
    _, data, contact = polytopes
    true, exact = data["signed_distance"], data["exact"]
    assert (contact.lower <= true)[exact].all()
    assert (true <= contact.upper)[exact].all()
    width = ((contact.upper - contact.lower) / data["largest"])[exact]
    assert width.max() <= tolerance(float64=1e-8, float32=1e-4)
    assert np.median(width) <= tolerance(float64=1e-13, float32=2e-5)


@pytest.mark.parametrize("round_b", [False, True], ids=["ellipsoids", "ellipsoid and sphere"])
def test_ellipsoids_are_as_far_apart_or_as_deep_as_fifty_digits_say(oracle, dtype, tolerance, round_b):
    data = np.load(oracle / "collision" / "ellipsoids.npz")
    chosen = (data["sphere_radius_b"] > 0) == round_b
    data = {name: data[name][chosen] for name in data}
    shape_b = rb.Sphere(data["sphere_radius_b"]) if round_b else rb.Ellipsoid(data["radii_b"])
    shapes = on_device((rb.Ellipsoid(data["radii_a"]), shape_b), dtype)
    pose_a = rb.Pose(np.zeros_like(data["center_b"]), rb.RotationMatrix(data["rotation_a"]))
    pose_b = rb.Pose(data["center_b"], rb.RotationMatrix(data["rotation_b"]))
    pose_a, pose_b = on_device((pose_a, pose_b), dtype)
    contact = separations(shapes[0], pose_a, shapes[1], pose_b)
    true = data["signed_distance"]
    assert np.abs(contact.distance - true).max() <= tolerance(float64=1e-13, float32=2e-5)
    assert (np.sign(contact.distance) == np.sign(true)).all()
    error = np.linalg.norm(contact.normal - data["normal"], axis=1)
    assert error.max() <= tolerance(float64=1e-9, float32=5e-2)
    assert (contact.lower <= true).all()
    slack = tolerance(float64=0.0, float32=1e-6)
    assert (true <= contact.upper + slack).all()


def subtract(a, b):
    return tuple(x - y for x, y in zip(a, b))


def product(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def inner(a, b):
    return sum(x * y for x, y in zip(a, b))


def exact_signed_square(a, b):
    """Signed square of the distance of two tetrahedra with whole coordinates, as a fraction.

    Overlapping tetrahedra part soonest along a normal of a face or the product of two edges; separated ones are nearest
    on a pair of sub-simplices, that is in their difference, whose corners' hull is searched face by face.
    """
    edges = [[subtract(p, q) for p, q in itertools.combinations(points, 2)] for points in (a, b)]
    axes = [product(*pair) for side in edges for pair in itertools.combinations(side, 2)]
    axes += [product(*pair) for pair in itertools.product(*edges)]
    depth = None
    for axis in {n for n in axes if any(n)} | {tuple(-x for x in n) for n in axes if any(n)}:
        reach = max(inner(axis, p) for p in a) - min(inner(axis, p) for p in b)
        if reach < 0:
            return nearest_square([subtract(p, q) for p in a for q in b])
        squared = Fraction(reach * reach, inner(axis, axis))
        depth = squared if depth is None else min(depth, squared)
    return -depth


def nearest_square(points):
    """Square of the distance of the origin from the hull of points, by all its corners, edges and triangles."""
    best = min(Fraction(inner(p, p)) for p in points)
    for p, q in itertools.combinations(points, 2):
        side = subtract(q, p)
        t = Fraction(-inner(p, side), inner(side, side)) if any(side) else Fraction(-1)
        if 0 < t < 1:
            best = min(best, inner(p, p) + t * inner(p, side))
    for p, q, r in itertools.combinations(points, 3):
        n = product(subtract(q, p), subtract(r, p))
        squared = inner(n, n)
        if squared and min(inner(product(x, y), n) for x, y in ((p, q), (q, r), (r, p))) >= 0:
            best = min(best, Fraction(inner(p, n) ** 2, squared))
    return best


@pytest.fixture(scope="module")
def of_tetrahedra(dtype):
    pose = at_origin(dtype)
    return jax.jit(lambda a, b: rb.separation(a, pose, b, pose))


corner = st.tuples(*[st.integers(-6, 6)] * 3)


@given(st.lists(corner, min_size=4, max_size=4), st.lists(corner, min_size=4, max_size=4))
@settings(max_examples=60, deadline=None)
def test_tetrahedra_with_whole_coordinates_against_rational_arithmetic(of_tetrahedra, dtype, tolerance, a, b):
    if any(
        inner(subtract(p[3], p[0]), product(subtract(p[1], p[0]), subtract(p[2], p[0]))) == 0 for p in (a, b)
    ):
        return  # flat: refused, see test_support.py
    hulls = on_device(rb.stack_hulls([rb.ConvexHull(np.array(p, float)) for p in (a, b)]), dtype)
    contact = of_tetrahedra(*(jax.tree.map(lambda x, k=k: x[k], hulls) for k in range(2)))
    square = exact_signed_square(a, b)
    true = float(np.sign(square)) * float(abs(square)) ** 0.5
    assert float(contact.distance) == pytest.approx(true, abs=tolerance(float64=1e-13, float32=2e-5))
    assert float(contact.lower) <= true + tolerance(float64=1e-15, float32=1e-6)
    assert true <= float(contact.upper) + tolerance(float64=1e-15, float32=1e-6)
