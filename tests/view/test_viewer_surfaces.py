"""Pictures of shapes have the shapes' volume, lie where they are, and are wound outwards."""

import numpy as np
import pytest
from viewer_scenes import solids, tetrahedron

import jaxrb as rb
from jaxrb.geometry import bounding_box
from jaxrb.view.viewer_scene import add_bounds, bodies_of, obstacles_of
from jaxrb.view.viewer_surfaces import creased, matrix_of, parts_of, product

try:
    import scipy
except ImportError:
    scipy = None
SOLIDS = solids(scipy is not None)


def volume(points, triangles):
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6.0


@pytest.mark.parametrize("name", list(SOLIDS))
def test_surface_encloses_the_shapes_volume_and_fills_its_box(name):
    shape = SOLIDS[name]
    parts = parts_of(shape)
    total = sum(volume(part.points(), part.surface.triangles) for part in parts)
    assert total == pytest.approx(float(shape.mass_properties(1.0).mass), rel=0.015)
    points = np.concatenate([part.points() for part in parts])
    box = bounding_box(shape)
    size = np.ptp([box.low, box.high], axis=0).max()
    np.testing.assert_allclose(points.min(axis=0), box.low, atol=0.004 * size)
    np.testing.assert_allclose(points.max(axis=0), box.high, atol=0.004 * size)


@pytest.mark.parametrize("name", list(SOLIDS))
def test_normals_are_unit_and_outward(name):
    for part in parts_of(SOLIDS[name]):
        normals, faces = part.surface.normals, part.surface.triangles
        np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-5)
        a, b, c = (part.surface.vertices[faces[:, i]] for i in range(3))
        own = np.cross(b - a, c - a)
        own = own / np.linalg.norm(own, axis=-1, keepdims=True)
        assert np.einsum("ti,tki->tk", own, normals[faces]).min() > 0.6


def test_sharp_edges_are_split_and_gentle_ones_smooth():
    assert len(creased(*tetrahedron()).vertices) == 12  # three at each of four corners
    nearly_flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.1]])
    assert len(creased(nearly_flat, np.array([[0, 1, 2], [1, 3, 2]])).vertices) == 4


def test_product_of_quaternions_is_that_of_matrices():
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, 4))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    np.testing.assert_allclose(matrix_of(product(a, b)), matrix_of(a) @ matrix_of(b), atol=1e-14)
    np.testing.assert_allclose(matrix_of(a), rb.Quaternion(a).as_matrix(), atol=1e-6)


def test_shape_lies_about_its_own_middle_not_that_of_mass():
    cone = rb.Body.from_shape(rb.Cone(0.2, 0.4), 500.0)
    (seen,) = bodies_of(rb.Scene(cone))
    heights = seen.parts[0].points()[:, 2]
    np.testing.assert_allclose([heights.min(), heights.max()], [-0.1, 0.3], atol=1e-6)


def test_body_without_a_shape_is_the_box_of_its_inertia():
    box = rb.Box((0.1, 0.2, 0.3))
    made = rb.Body.from_shape(box, 700.0)
    (seen,) = bodies_of(rb.Scene(rb.Body(made.mass, made.inertia)))
    np.testing.assert_allclose(
        np.abs(seen.parts[0].points()).max(axis=0), np.asarray(box.half_extents), rtol=1e-5
    )
    assert "no shape" in seen.note
    (point,) = bodies_of(rb.Scene(rb.Body.point(1.0)))
    assert "small ball" in point.note


def test_bodies_of_an_axis_are_named_and_drawn_one_by_one():
    crowd = rb.Scene(
        (rb.replicate(rb.Body.from_shape(rb.Sphere(0.1), 1.0, "ball"), 3), rb.Body(1.0, 1.0, name="top"))
    )
    seen = bodies_of(crowd)
    assert [one.name for one in seen] == ["ball 0", "ball 1", "ball 2", "top"]
    assert seen[0].parts[0].surface is seen[2].parts[0].surface


def test_bounding_volumes_hold_the_picture():
    given = {
        name: shape for name, shape in SOLIDS.items() if scipy or name not in ("mesh", "composite", "hull")
    }
    seen = bodies_of(rb.Scene(tuple(rb.Body.from_shape(shape, 500.0, name) for name, shape in given.items())))
    assert add_bounds(seen) == ""
    for one in seen:
        points = np.concatenate([part.points() for part in one.parts])
        away = np.linalg.norm(points - one.ball[:3], axis=-1)
        assert 0.9 * one.ball[3] < away.max() < one.ball[3] * (1 + 1e-5)
        inside = np.abs((points - one.box[:3]) @ matrix_of(one.box[3:7]))
        assert (inside < one.box[7:] * (1 + 1e-4) + 1e-6).all()


def test_what_stands_still_is_there_once():
    turned = rb.Pose(
        np.array([0.0, 0.0, 2.0]), rb.Quaternion(np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]))
    )
    floor = rb.HalfSpace(offset=0.5)
    touch = (rb.RigidContact((floor, (floor, turned))), rb.CompliantContact(floor, stiffness=1.0))
    seen = obstacles_of(rb.Scene(rb.Body.from_shape(rb.Sphere(0.1), 1.0), touch))
    assert len(seen) == 2
    np.testing.assert_allclose(seen[0].plane, [0, 0, 1, 0.5], atol=1e-6)
    np.testing.assert_allclose(seen[1].plane, [1, 0, 0, 0.5], atol=1e-6)
