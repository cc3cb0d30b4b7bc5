"""Tosses onto a table: friction and the metric scale of recordings made with known ones, in Python and by command."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.fit import Search, fit, fit_tosses, solid_on_table
from jaxrb.fit.predictions import recorded, side_by_side, toss_errors
from jaxrb.fit.tosses import TOSS_UNKNOWNS

TRUTH = {"friction": 0.25, "metric_scale": 0.03}
SEARCH = {"friction": Search(0.4, 0.2, 0.0, 1.0), "metric_scale": Search(0.0, 0.03, -0.1, 0.1)}
BALL = rb.Sphere(0.1)
SCENE = solid_on_table(BALL, 0.4)
ONLY_DOUBLE = "tosses are predicted in float64 whatever the flag; once is enough"


@pytest.fixture(scope="module")
def tosses() -> rb.Recording:
    """Six balls that drop a little, bounce never, and slide until they roll; lengths read 3 % too long."""
    if jnp.zeros(()).dtype != jnp.float64:
        pytest.skip(ONLY_DOUBLE)
    scene = SCENE({"friction": TRUTH["friction"]})
    random = np.random.default_rng(0)
    first = [
        scene.state(
            position=[(0, 0, 0.12)], velocity=random.uniform(-2, 2, (1, 3)) * [1, 1, 0],
            angular_velocity=random.uniform(-9, 9, (1, 3)),
        )
        for _ in range(6)
    ]  # fmt: skip
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *first)
    path = jax.jit(jax.vmap(lambda s: rb.rollout(scene, s, dt=0.005, steps=80, save_every=2).states))(stacked)
    metre = 1.0 + TRUTH["metric_scale"]
    return rb.Recording(
        [np.arange(41) / 100.0] * 6,
        position=list(metre * np.asarray(path.position[:, :, 0])),
        velocity=list(metre * np.asarray(path.velocity[:, :, 0])),
        orientation=list(np.asarray(path.orientation.as_quaternion_array()[:, :, 0])),
        angular_velocity=list(np.asarray(path.angular_velocity[:, :, 0])),
    )


def test_the_numbers_that_made_the_tosses_leave_no_error(tosses):
    place, angle = toss_errors(*recorded(tosses), SCENE, TRUTH, 2)
    assert place.max() < 1e-6
    assert angle.max() < 1e-6
    wrong = toss_errors(*recorded(tosses), SCENE, {"friction": 0.25, "metric_scale": 0.0}, 2)
    assert wrong[0].max() > 1e-3


def test_friction_and_metric_scale_are_found(tosses):
    said = []
    found = fit_tosses(
        tosses, SCENE, SEARCH, length=0.1, rounds=8, samples=24, substeps=2, progress=said.append
    )
    assert found.values["friction"] == pytest.approx(0.25, abs=0.02)
    assert found.values["metric_scale"] == pytest.approx(0.03, abs=0.005)
    assert all(1e-6 < error < 0.05 for error in found.standard_errors.values())
    assert found.runs == 8 * 24
    assert len(said) == 8
    assert "friction" in found.summary()
    again = fit_tosses(tosses, SCENE, SEARCH, length=0.1, rounds=8, samples=24, substeps=2)
    assert again.values == found.values


def test_the_command_finds_friction(tosses, tmp_path, capsys):
    file = rb.write_recording(tosses, tmp_path / "balls.npz")
    fit(file, tosses=("friction", "metric_scale"), radius=0.1, mass=0.4, rounds=2, json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["tosses"] == 6
    assert set(found["values"]) == {"friction", "metric_scale"}
    assert found["runs"] == 24
    with pytest.raises(rb.InvalidInput, match="'colour'"):
        fit(file, tosses=("colour",), radius=0.1)
    with pytest.raises(rb.InvalidInput, match="half-extents or radius"):
        fit(file, tosses=("friction",))
    with pytest.raises(rb.InvalidInput, match="leave it out"):
        fit(file, tosses=("friction",), radius=0.1, html=tmp_path / "page.html")
    with pytest.raises(rb.InvalidInput, match="not both"):
        fit(file, tosses=("restitution", "log10_stiffness"), radius=0.1)


def test_scenes_by_name_have_what_was_named():
    box = solid_on_table(rb.Box((0.1, 0.2, 0.3)), 2.0)
    scene = box({"friction": 0.3, "restitution": 0.1, "size": 2.0, "inertia": 0.5})
    body, contact = scene.bodies[0], scene.effects[1]
    np.testing.assert_allclose(body.shape.half_extents, [0.2, 0.4, 0.6])
    expected = 0.5 * 2.0 / 3.0 * np.array([0.4**2 + 0.6**2, 0.2**2 + 0.6**2, 0.2**2 + 0.4**2])
    np.testing.assert_allclose(np.diag(np.asarray(body.inertia.as_matrix())), expected, rtol=1e-6)
    assert float(contact.friction) == pytest.approx(0.3)
    compliant = box({"friction": 0.3, "log10_stiffness": 4.0}).effects[1]
    assert float(compliant.stiffness) == pytest.approx(1e4)
    assert all(where.least < where.middle < where.most for where, _ in TOSS_UNKNOWNS.values())


def test_recordings_without_a_first_state_are_refused():
    time = np.arange(5) / 100.0
    with pytest.raises(rb.InvalidInput, match="orientation is missing"):
        recorded(rb.Recording(time, position=np.zeros((5, 3))))
    still: dict = {
        "position": np.zeros((5, 3)),
        "velocity": np.zeros((5, 3)),
        "angular_velocity": np.zeros((5, 3)),
    }
    uneven = rb.Recording(time**2, orientation=np.tile([1.0, 0, 0, 0], (5, 1)), **still)
    with pytest.raises(rb.InvalidInput, match="one even rate"):
        recorded(uneven)
    with pytest.raises(rb.InvalidInput, match="0 numbers"):
        fit_tosses(
            (side_by_side({**still, "orientation": np.ones((5, 4))}, np.array([5])), 100.0),
            SCENE,
            {},
            length=0.1,
        )
