"""Points and forces of contact, from a run to a file to a page."""

import json

import numpy as np
import pytest
from viewer_scenes import path_of, resting_tower

import jaxrb as rb
from jaxrb.cli import main
from jaxrb.errors import InvalidInput
from jaxrb.view.viewer_contacts import SavedContacts, contacts_of
from jaxrb.view.viewer_record import record_of, record_of_arrays
from jaxrb.view.viewer_scene import bodies_of, obstacles_of


@pytest.fixture(scope="module")
def tower():
    return resting_tower()


@pytest.fixture(scope="module")
def found(tower):
    return contacts_of(tower.scene, tower.states)


def test_forces_of_contact_bear_the_weight(found, tower, tolerance):
    """The floor bears both balls, the lower one the upper, where they touch."""
    weight = float(tower.scene.bodies[0].mass[0]) * 9.80665
    np.testing.assert_array_equal(found.first, [0, 2, 4, 6])
    np.testing.assert_array_equal(found.pair, [[0, -1], [1, 0]] * 3)
    exact = tolerance(float64=1e-6, float32=2e-3)
    np.testing.assert_allclose(found.force[::2], [[0, 0, 2 * weight]] * 3, atol=exact * weight)
    np.testing.assert_allclose(found.force[1::2], [[0, 0, weight]] * 3, atol=exact * weight)
    np.testing.assert_allclose(found.point, [[0, 0, 0], [0, 0, 0.2]] * 3, atol=1e-6)


def test_forces_among_a_crowd_are_found_too(tower, tolerance):
    rules = (
        rb.RigidContact(rb.HalfSpace(), friction=0.5, solver="sparse"),
        rb.RigidContact(friction=0.5, solver="sparse"),
    )
    scene = rb.Scene(tower.scene.bodies, (rb.UniformGravity(), *rules))
    found = contacts_of(scene, tower.states)
    weight = float(tower.scene.bodies[0].mass[0]) * 9.80665
    where = {tuple(pair): force for pair, force in zip(found.pair[:2].tolist(), found.force[:2], strict=True)}
    assert set(where) == {(0, -1), (1, 0)}
    exact = tolerance(float64=5e-4, float32=1e-2)  # the tolerance of a crowd's solve, a few times
    assert abs(where[0, -1][2] / weight - 2.0) < exact
    assert abs(where[1, 0][2] / weight - 1.0) < exact


def test_a_scene_without_contact_has_none():
    scene = rb.Scene(rb.Body(1.0, 1.0), rb.UniformGravity())
    path = path_of(scene, saves=3)
    assert contacts_of(path.scene, path.states) is None


def test_a_page_holds_them_where_they_are_asked_for(tower, found):
    record = record_of(tower, forces=True)
    told = record.header["contacts"]
    assert told["point"]["shape"] == [6, 3]
    at = told["force"]["at"]
    held = np.frombuffer(bytes(record.numbers[at : at + 4 * 18]), "<f4").reshape(6, 3)
    np.testing.assert_array_equal(held, found.force.astype(np.float32))
    without = record_of(tower)
    assert without.header["contacts"] is None


def test_a_file_carries_them_to_the_page(found, tower, tmp_path, capsys):
    """`jaxrb simulate --save`, `jaxrb view`: a block that slides; friction is against the motion."""
    file = tmp_path / "run.npz"
    main(["simulate", "block_on_incline", "--duration", "0.05", "--save", str(file), "--json"])
    told = json.loads(capsys.readouterr().out)
    with np.load(file) as arrays:
        saved = SavedContacts.of_arrays(str(file), arrays, len(arrays["time"]))
    assert saved is not None
    assert told["most_points"] == 4
    np.testing.assert_array_equal(np.diff(saved.first), 4)
    main(["view", str(file), "--scene", "block_on_incline", "--out", str(tmp_path / "run.html"), "--json"])
    assert (tmp_path / "run.html").is_file()


def test_arrays_of_contact_that_do_not_fit_are_refused(found, tower):
    scene = tower.scene
    arrays = {
        "time": np.asarray(tower.times),
        "position": np.asarray(tower.states.position),
        "orientation_wxyz": np.asarray(tower.states.orientation.wxyz),
    }
    record = record_of_arrays(arrays | found.arrays(), bodies_of(scene), obstacles_of(scene), "run")
    assert record.header["contacts"]["point"]["shape"] == [6, 3]
    for changes, message in (
        ({"touch_point": found.point[:5]}, r"points of contact \(5, 3\), forces \(6, 3\)"),
        ({"touch_first": found.first[::-1]}, "do not fit 3 saved states"),
        ({"touch_force": None}, "holds no 'touch_force' beside the others"),
    ):
        bad = {k: v for k, v in (arrays | found.arrays() | changes).items() if v is not None}
        with pytest.raises(InvalidInput, match=message):
            record_of_arrays(bad, bodies_of(scene), obstacles_of(scene), "run")
