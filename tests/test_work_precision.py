"""Work and precision: references that check themselves, points that show each method's order, scenes by name."""

import dataclasses
import json

import jax
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.accuracy.reference import closed_form, errors, extrapolated, reference
from jaxrb.accuracy.work_precision import (
    Point,
    measure,
    measure_closed_form,
    pareto,
    step_counts,
    work_precision,
)
from jaxrb.errors import InvalidInput, RunFailed, UnknownName, WrongStructure
from jaxrb.integrators import METHODS
from jaxrb.scene import Path
from jaxrb.scene.library import SCENES, example_of

# A reference is a float64 number in every run; what a test does to it must be so too.
IN_FLOAT64 = jax.enable_x64(True)


@pytest.fixture(scope="module")
def top():
    example = example_of("heavy_top")
    with jax.enable_x64(True):
        return dataclasses.replace(example, duration=4.0)


@pytest.fixture(scope="module")
def answer(top):
    with jax.enable_x64(True):
        return reference(top.scene, top.state(), top.duration)


def test_reference_of_a_top_agrees_with_itself(answer):
    assert answer.uncertainty.attitude < 1e-11
    assert answer.uncertainty.energy < 1e-13
    assert "Dopri8" in answer.how


@IN_FLOAT64
def test_extrapolation_removes_the_error_of_order_four(answer):
    coarse, fine = (
        dataclasses.replace(answer.state, position=answer.state.position + e) for e in (16e-3, 1e-3)
    )
    np.testing.assert_allclose(extrapolated(coarse, fine).position, answer.state.position, atol=1e-15)


@pytest.mark.parametrize(("method", "order"), [(rb.RungeKutta4(), 4), (rb.ImplicitMidpoint(), 2)])
def test_points_show_the_design_order(top, answer, method, order):
    with jax.enable_x64(True):
        state = top.state()
        counts = [8 * n for n in step_counts(top.scene, state, method, top.duration, 2)]
        coarse, fine = measure(top.scene, state, answer.state, method, top.duration, counts, 1)
    seen = np.log(coarse.attitude_error_rad / fine.attitude_error_rad) / np.log(4.0)
    assert seen == pytest.approx(order, abs=0.35)
    assert fine.seconds_per_step > 0
    assert fine.memory_bytes > 0
    assert fine.compile_seconds > 0


def test_single_precision_stops_at_its_round_off(top, answer):
    with jax.enable_x64(True):
        state = top.state(dtype="float32")
        (point,) = measure(top.scene, state, answer.state, rb.RungeKutta4(), top.duration, (2000,), 1)
    assert point.precision == "float32"
    assert 1e-8 < point.attitude_error_rad < 1e-4


@IN_FLOAT64
def test_state_that_is_not_finite_has_no_small_error(top, answer):
    """A run beyond stability ends in NaN, whose angle could read as zero."""
    broken = jax.tree.map(lambda leaf: leaf * np.nan, answer.state)
    assert errors(top.scene, broken, answer.state).attitude == np.inf
    collapsed = dataclasses.replace(
        answer.state, orientation=jax.tree.map(np.zeros_like, answer.state.orientation)
    )
    assert errors(top.scene, collapsed, answer.state).attitude == np.inf


@IN_FLOAT64
def test_error_of_attitude_position_and_energy_are_what_was_planted(top, answer):
    turn = rb.Quaternion.exp(np.array([0.0, 3e-4, 4e-4]))
    planted = dataclasses.replace(
        answer.state, orientation=answer.state.orientation @ turn, position=answer.state.position + 0.1
    )
    off = errors(top.scene, planted, answer.state)
    assert off.attitude == pytest.approx(5e-4, rel=1e-6)
    assert off.position == pytest.approx(0.1 * np.sqrt(3), rel=1e-6)


def test_closed_form_serves_free_bodies_only(top, answer):
    assert measure_closed_form(top.scene, top.state(), answer.state, top.duration) == []


def test_front_keeps_what_nothing_cheaper_matches():
    def point(seconds, error):
        return Point("m", "quaternion", 1, 1.0, error, seconds, 0.0)

    points = [point(1.0, 1e-2), point(2.0, 1e-1), point(3.0, 1e-6), point(4.0, 1e-9), point(5.0, 1e-12)]
    assert pareto(points) == {0, 2, 3, 4}
    assert pareto(points, known=1e-9) == {0, 2, 3}  # an error below what is known does not count as smaller


def test_work_precision_marks_what_it_cannot_know(top, monkeypatch):
    few = {name: METHODS[name] for name in ("RungeKutta4", "ImplicitMidpoint")}
    monkeypatch.setattr("jaxrb.accuracy.work_precision.METHODS", few)
    found = work_precision(top, precisions=("float64",), levels=1)
    assert {p.method for p in found.points} >= {"RungeKutta4", "ImplicitMidpoint"}
    assert any(p.on_front for p in found.points)
    known = found.reference.uncertainty.attitude
    assert all(p.beyond_reference == (p.attitude_error_rad < known) for p in found.points)
    plain = json.loads(json.dumps(found.as_dict()))
    assert plain["points"][0]["seconds_per_step"] * plain["points"][0]["steps"] == pytest.approx(
        plain["points"][0]["run_seconds"]
    )


def test_closed_form_of_bodies_that_fall_and_of_no_others(tolerance):
    scene = rb.Scene(rb.Body(2.0, (1.0, 2.0, 2.5)), rb.UniformGravity((0.0, 3.0, -10.0)))
    state = scene.state(position=(1.0, 0.0, 5.0), velocity=(4.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 0.5))
    end = closed_form(scene, state, 2.0)
    near = {"atol": tolerance(float64=1e-14, float32=1e-5)}
    np.testing.assert_allclose(end.position[0], [9.0, 6.0, -15.0], **near)
    np.testing.assert_allclose(end.velocity[0], [4.0, 6.0, -20.0], **near)
    np.testing.assert_allclose(end.orientation.log()[0], [0.0, 0.0, 1.0], **near)
    dragged = rb.Scene(scene.bodies, (*scene.effects, rb.LinearDrag(0.1)))
    assert closed_form(dragged, state, 2.0) is None


@IN_FLOAT64
def test_references_that_disagree_are_refused(top, answer, monkeypatch):
    """Chaos, or a wrong reference: where two computations differ there is no answer."""
    wrong = Path(answer.state.time[None], answer.state, top.state(dtype=answer.state.dtype), None, top.scene)
    monkeypatch.setattr("jaxrb.accuracy.reference.solve", lambda *a, **k: wrong)
    with pytest.raises(RunFailed, match="shorten"):
        reference(top.scene, top.state(), top.duration)


@pytest.mark.parametrize("name", list(SCENES))
def test_scenes_start_in_every_representation(name, dtype):
    example = example_of(name)
    for rotation in (rb.Quaternion, rb.RotationMatrix, rb.EulerAngles):
        state = example.state(rotation)
        assert state.dtype == dtype
        assert state.position.shape == (example.scene.count, 3)
    assert example.duration > 0


def test_unknown_scene_suggests_the_nearest():
    with pytest.raises(UnknownName, match="did you mean heavy_top"):
        example_of("heavytop")


SCRIPT = """
import jaxrb as rb
scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 2.5)), rb.LinearDrag(0.1))
state = scene.state(angular_velocity=(0, 3, 0.2), velocity=(1, 0, 0), rotation=rb.RotationMatrix)
"""


def test_scene_of_a_users_file(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(SCRIPT + "duration = 2.0\n")
    example = example_of(str(file))
    assert example.duration == 2.0
    np.testing.assert_allclose(np.asarray(example.state().velocity), [[1.0, 0.0, 0.0]])
    assert isinstance(example.state(rb.RotationMatrix).orientation, rb.RotationMatrix)


@pytest.mark.parametrize(
    ("text", "kind", "match"),
    [
        (SCRIPT, WrongStructure, "defines no duration"),
        (SCRIPT + "duration = -1.0", InvalidInput, "positive"),
        ("scene = 3", WrongStructure, "defines scene as int"),
        ("1 / 0", InvalidInput, "ZeroDivisionError"),
    ],
)
def test_file_that_defines_no_scene_is_explained(tmp_path, text, kind, match):
    file = tmp_path / "mine.py"
    file.write_text(text)
    with pytest.raises(kind, match=match):
        example_of(str(file))
    with pytest.raises(InvalidInput, match="no such file"):
        example_of("nowhere.py")
