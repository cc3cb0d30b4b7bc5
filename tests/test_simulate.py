"""Scenes with contact, by name, and `jaxrb simulate`: what it runs, sums up, and draws."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, RunFailed, UnknownName
from jaxrb.scene.contact_library import CONTACT_SCENES, block_on_incline
from jaxrb.scene.example import Example
from jaxrb.scene.library import SCENES, example_of
from jaxrb.simulate import SAVES, arrays, near_divisor, run
from jaxrb.view.side_view import outlines, side_of
from jaxrb.view.simulation_figure import simulation_figure

# Those that a second or two of compilation will do for; the crowded ones are run by the scoreboard.
SMALL = {"bouncing_ball": 1.0, "tippe_top": 0.3, "cube_toss": 0.4}


def built(name):
    if name == "arch":
        pytest.importorskip("scipy")
    return example_of(name)


@pytest.fixture(scope="module")
def slide():
    return run(block_on_incline(), duration=0.5)


@pytest.mark.parametrize("name", list(CONTACT_SCENES))
def test_scenes_with_contact_start_in_every_representation(name, dtype):
    example = built(name)
    assert example.name == name
    for rotation in (rb.Quaternion, rb.RotationMatrix):
        state = example.state(rotation)
        assert state.dtype == dtype
        assert state.position.shape == (example.scene.count, 3)
    steps = example.duration / example.dt
    assert steps == pytest.approx(round(steps))
    assert any(isinstance(effect, rb.RigidContact) for effect in example.scene.effects)


def test_scenes_with_contact_are_not_among_those_with_known_answers():
    assert not set(SCENES) & set(CONTACT_SCENES)
    with pytest.raises(UnknownName, match="did you mean stack_of_10"):
        example_of("stack-of-ten")


@pytest.mark.parametrize("name", list(SMALL))
def test_energy_of_a_passive_scene_never_rises(name, tolerance):
    path, facts = run(example_of(name), duration=SMALL[name])
    energy = np.asarray(path.diagnostics.energy, float)
    scale = np.abs(energy).max()
    # In float32 the top's largest rise is chance: 4e-5 to 5e-4 of its 7 mJ from nine starts within a thousandth.
    assert np.diff(energy).max() < tolerance(float64=1e-6, float32=1e-3) * scale
    assert facts["friction_work_j"] <= 1e-6 * scale
    assert facts["poor_steps"] == 0
    if name == "bouncing_ball":  # friction of its first blow acts on its radius, and no gap is added to that
        speed = float(path.final.velocity[0, 0])
        assert speed == pytest.approx(5 / 7, rel=tolerance(float64=1e-9, float32=1e-4))


def test_block_slides_down_the_incline_as_coulomb_says(slide, tolerance):
    path, facts = slide
    assert np.diff(np.asarray(path.diagnostics.energy, float)).max() <= 0.0
    angle = np.deg2rad(20.0)
    pulled = 9.81 * (np.sin(angle) - 0.3 * np.cos(angle))
    speed = np.linalg.norm(np.asarray(path.final.velocity, float)[0])
    assert speed == pytest.approx(pulled * 0.5, rel=tolerance(float64=1e-8, float32=1e-4))
    # No sliding against the weight is lost: E₀ − E is the work of friction, to first order in the step.
    lost = facts["energy_at_end_j"] - facts["energy_at_start_j"]
    assert facts["friction_work_j"] == pytest.approx(lost, rel=2e-2)


def test_stretches_are_one_run(slide, tolerance):
    """The bar's stretches change nothing: states, times and the report are those of one rollout."""
    path, facts = slide
    example = block_on_incline()
    steps = facts["steps"]
    whole = rb.rollout(
        example.scene,
        example.state(),
        dt=example.dt,
        steps=steps,
        save_every=near_divisor(steps, steps / SAVES),
    )
    near = {"rtol": 0, "atol": tolerance(float64=1e-8, float32=1e-4)}
    np.testing.assert_allclose(path.times, whole.times, **near)
    np.testing.assert_allclose(path.states.position, whole.states.position, **near)
    np.testing.assert_allclose(path.final.velocity, whole.final.velocity, **near)
    np.testing.assert_allclose(path.contact.friction_work, whole.contact.friction_work, **near)
    np.testing.assert_array_equal(path.contact.steps, whole.contact.steps)
    assert path.contact.overflow[-1] == -1


def test_saves_end_with_the_run():
    for steps, last in ((1, 1), (7, 7), (1000, 5), (1200, 6), (10_000, 50), (1009, 5)):
        assert near_divisor(steps, steps / SAVES) <= last
    path, facts = run(block_on_incline(), dt=5e-3, duration=1009 * 5e-3 / 8)
    assert path.times[-1] == path.final.time == pytest.approx(facts["steps"] * 5e-3)


def test_failure_is_told_by_the_step_of_the_whole_run():
    """A ball is lost in the 53rd step of 100, which is one of the later stretches."""

    def lost(body, state, parameters):
        return rb.Wrench(jnp.where(state.time > 0.515, jnp.nan, 0.0) + 0.0 * state.position)

    scene = rb.Scene(rb.Body.from_shape(rb.Sphere(0.1), 500.0), rb.CustomForce(lost))
    with pytest.raises(RunFailed, match=r"body 0.*step 53"):
        run(Example("lost", "a ball", scene, {}, 1.0, 1e-2), method="ExplicitEuler")


def test_saved_arrays_have_one_row_a_save(slide):
    path, facts = slide
    saved = arrays(path)
    assert {len(value) for value in saved.values()} == {len(path.times)}
    assert saved["orientation_wxyz"].shape == (len(path.times), 1, 4)
    assert saved["contact_friction_work"][-1] == pytest.approx(facts["friction_work_j"])


def test_scenes_without_contact_run_too():
    _, facts = run(example_of("thrown_brick"), representation="matrix", method="VelocityVerlet")
    assert facts["final_time_s"] == pytest.approx(1.5)
    assert "friction_work_j" not in facts


def test_a_wrong_duration_is_refused():
    with pytest.raises(InvalidInput, match="duration"):
        run(block_on_incline(), duration=-1.0)


def test_outline_is_the_shape_from_the_side():
    example = block_on_incline()
    (outline,) = outlines(example.scene, example.state())
    c, s = np.cos(np.deg2rad(20.0)), np.sin(np.deg2rad(20.0))
    np.testing.assert_allclose(np.ptp(outline, axis=0), (0.2 * c + 0.1 * s, 0.2 * s + 0.1 * c), rtol=1e-5)


def test_outline_lies_about_the_middle_of_the_shape_not_of_the_mass():
    example = example_of("tippe_top")
    (outline,) = outlines(example.scene, example.state())
    assert outline[:, 1].min() == pytest.approx(0.0, abs=5e-5)  # 96 directions do not meet the lowest point
    assert outline[:, 1].max() == pytest.approx(0.03, abs=5e-5)


def test_side_is_the_one_from_which_more_is_seen():
    example = block_on_incline()
    state = example.state()
    moved = dataclasses.replace(state, position=state.position + jnp.array([0.0, 2.0, 0.0]))
    along_y = jax.tree.map(lambda *leaves: jnp.stack(leaves), state, moved)
    assert side_of(example.scene, along_y) == 1
    assert side_of(example.scene, state) == 0


def test_figure_shows_heights_energy_and_bodies(slide):
    pytest.importorskip("matplotlib")
    figure = simulation_figure(slide[0], block_on_incline())
    assert len(figure.axes) == 3
