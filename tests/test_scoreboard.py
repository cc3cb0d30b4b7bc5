"""The scoreboard's parameters lead to the end values that its sources publish; its figures are those that are known."""

import jax
import numpy as np
import pytest
from conftest import ORACLE

from jaxrb.accuracy.reference import closed_form, errors, reference
from jaxrb.bench import peers, simbenchmark, tosses
from jaxrb.bench.flight_rows import _box_judge, _jaxrb, _mujoco, rotated
from jaxrb.bench.published import (
    BOUNCING,
    ELASTIC_666,
    GAZEBO_BOX_END,
    GAZEBO_BOXES,
    INELASTIC_666,
    RIGID_BODY_END,
    ROLLING,
    TUMBLING_BRICK_END,
)
from jaxrb.bench.rigid_body_problem import MOMENTS, SCALES, exact_end, problem
from jaxrb.bench.scoreboard import ROWS, rows_of
from jaxrb.errors import UnknownName
from jaxrb.fit.predictions import recorded, side_by_side, toss_errors
from jaxrb.io import read_recording
from jaxrb.scene.contact_library import slab_with_balls, spheres_216
from jaxrb.scene.library import gazebo_boxes, tumbling_brick
from jaxrb.scene.scene import energy

# Everything is judged in float64, whatever the run's precision: these are statements about published numbers.
LAST_DIGIT = 1e-8


@pytest.fixture(scope="module")
def ends():
    with jax.enable_x64(True):
        examples = {e.name: e for e in (tumbling_brick(), gazebo_boxes(), problem())}
        return {name: (e, reference(e.scene, e.state(), e.duration)) for name, e in examples.items()}


def test_tumbling_brick_ends_where_nasa_says(ends):
    _, found = ends["tumbling_brick"]
    assert found.uncertainty.attitude < 1e-12
    omega = np.rad2deg(np.asarray(found.state.angular_velocity))[0]
    np.testing.assert_allclose(omega, TUMBLING_BRICK_END["angular_velocity_deg_s"], atol=LAST_DIGIT)
    assert _same_rotation(found.state, TUMBLING_BRICK_END["orientation"])


def test_gazebo_box_ends_where_its_exact_motion_does(ends):
    example, found = ends["gazebo_boxes"]
    omega = np.asarray(found.state.angular_velocity)[0]
    np.testing.assert_allclose(omega, GAZEBO_BOX_END["angular_velocity"], atol=LAST_DIGIT)
    assert _same_rotation(found.state, GAZEBO_BOX_END["orientation"])
    thrown = np.array(example.start["velocity"]) * 10.0 + np.array([0.0, 0.0, -0.5 * 9.8 * 100.0])
    np.testing.assert_allclose(np.asarray(found.state.position)[0], thrown, rtol=1e-14)
    with jax.enable_x64(True):
        assert float(energy(example.scene, example.state())) == pytest.approx(
            GAZEBO_BOX_END["energy_at_start"],
            abs=5e-6,  # carried over with rounded moments
        )


def test_rigid_body_problem_is_a_body_that_exists(ends):
    """The literature's equations by SciPy, and the engine on a physical body with scaled rates, agree."""
    assert MOMENTS[0] + MOMENTS[1] > MOMENTS[2]
    _, found = ends["rigid_body_problem"]
    by_engine = np.asarray(found.state.angular_velocity)[0] / SCALES
    np.testing.assert_allclose(by_engine, exact_end(), atol=1e-11)
    np.testing.assert_allclose(by_engine, RIGID_BODY_END, atol=LAST_DIGIT)


def test_two_references_agree_and_a_wrong_one_does_not(ends):
    """The uncertainty is no formality: the same check on a state that is 1e-6 rad off reports 1e-6."""
    example, found = ends["tumbling_brick"]
    with jax.enable_x64(True):
        later = closed_form(example.scene, example.state(), example.duration + 1e-6)
        rate = np.linalg.norm(np.asarray(found.state.angular_velocity))
        assert errors(example.scene, later, found.state).attitude == pytest.approx(1e-6 * rate, rel=1e-5)


def test_first_order_errs_as_ode_and_bullet_publish():
    """Semi-implicit Euler is what those engines do: position, momentum and energy errors must be theirs."""
    example = gazebo_boxes()
    judge = _box_judge(example, 9.8)
    with jax.enable_x64(True):
        (row,) = _jaxrb(example, judge, (1e-3,), ("SemiImplicitEuler",))
    ode = next(p.figures for p in GAZEBO_BOXES if p.who == "ODE" and p.setting == "dt 1e-3")
    for name, published in ode.items():
        assert row[name] == pytest.approx(published, rel=0.02), name


def test_judge_of_boxes_finds_planted_errors():
    example = gazebo_boxes()
    judge = _box_judge(example, 9.8)
    times = np.linspace(0.0, 1.0, 11)
    throw, omega = np.array(example.start["velocity"]), np.tile(example.start["angular_velocity"], (11, 1))
    right = throw * times[:, None] + 0.5 * np.array([0.0, 0.0, -9.8]) * times[:, None] ** 2
    velocity = throw + np.array([0.0, 0.0, -9.8]) * times[:, None]
    level = np.tile([1.0, 0.0, 0.0, 0.0], (11, 1))
    assert max(judge(times, right, level, velocity, omega).values()) < 1e-13
    wrong = right.copy()
    wrong[5] += [0.0, 0.03, 0.04]
    assert judge(times, wrong, level, velocity, omega)["position_m"] == pytest.approx(0.05)
    turned = level.copy()
    turned[3] = [np.cos(0.05), 0.0, 0.0, np.sin(0.05)]  # 0.1 rad about z, nearly perpendicular to L
    assert judge(times, right, turned, velocity, omega)["angular_momentum"] == pytest.approx(0.1, rel=1e-3)


def test_rotation_of_the_host_is_the_engines():
    wxyz = np.array([[0.5, 0.5, -0.5, 0.5]])
    np.testing.assert_allclose(rotated(wxyz, np.array([[1.0, 2.0, 3.0]])), [[-2.0, -3.0, 1.0]], atol=1e-15)


def test_mujoco_row_shows_its_known_figures():
    pytest.importorskip("mujoco")
    example = tumbling_brick()
    moments = np.asarray(example.scene.bodies[0].inertia.moments)

    def judge(times, position, orientation, velocity, omega):
        turning = 0.5 * omega**2 @ moments
        return {"energy": float(np.abs(turning / turning[0] - 1.0).max())}

    rows = {row["who"].split()[-1]: row for row in _mujoco(example, judge, (0.01,), gravity=0.0)}
    assert rows["Euler"]["energy"] == pytest.approx(9.4e-3, rel=0.02)
    assert rows["RK4"]["energy"] < 1e-11


def test_missing_mujoco_is_said(monkeypatch):
    monkeypatch.setattr(peers, "mujoco_version", lambda: None)
    (row,) = _mujoco(tumbling_brick(), None, (0.01,), gravity=0.0)
    assert "pip install" in row["setting"]


def test_unknown_row_lists_the_rows():
    with pytest.raises(UnknownName, match="B-simple"):
        rows_of("Z")
    assert [row.name for row in rows_of(None)] == list(ROWS)


def test_rows_c_and_d_mean_all_of_theirs():
    names = ["C-bouncing", "C-rolling", "C-666", "C-666-elastic", "C-bouncing-events", "C-666-elastic-events"]
    assert [row.name for row in rows_of("c")] == names
    assert [row.name for row in rows_of("d")] == ["D-bounce", "D-exchange", "D-control"]
    assert [row.name for row in rows_of("B")] == ["B"]


def test_goals_are_raisims_at_the_same_step():
    assert simbenchmark._raisim(BOUNCING, "energy_j2", 1e-3) == 1.86e-2
    assert simbenchmark._raisim(BOUNCING, "energy_j2", 1e-2) is None
    assert simbenchmark._raisim(ELASTIC_666, "energy_j2", 1e-2) == 5.2e6
    assert simbenchmark._raisim(INELASTIC_666, "overlap_m2", 1e-3) == 1.35e-4
    assert {p.entry()["setting"] for p in ROLLING} == {"y, dt 1e-3", "oblique, dt 1e-3"}


def test_overlap_finds_planted_ones():
    position = np.asarray(spheres_216().start["position"])
    assert simbenchmark._overlap_of(position) == 0.0
    position[0, 2] = 0.1 - 0.003
    assert simbenchmark._overlap_of(position) == pytest.approx(0.003**2)
    position[1] = position[0] + [0.196, 0.0, 0.005]
    deep = 0.2 - np.hypot(0.196, 0.005)
    assert simbenchmark._overlap_of(position) == pytest.approx(0.003**2 + deep**2)


def test_balls_roll_on_the_slab_with_two_sevenths_of_its_acceleration():
    """SimBenchmark's rolling over its first 20 ms, oblique: the cone is round, so nothing sticks."""
    with jax.enable_x64(True):
        example = slab_with_balls((0.5, 0.75**0.5))
        path, _, _ = simbenchmark._Program(example, 1e-3, 0.02)(example.state())
        assert path.status.ok
        slab, ball = simbenchmark.rolling_errors(path, np.array([0.5, 0.75**0.5]))
        wrong, _ = simbenchmark.rolling_errors(path, np.array([0.0, 1.0]))
    assert slab + ball < simbenchmark.ROLLING_GOAL
    assert wrong > 1e-6


def test_tosses_of_a_real_cube_are_predicted(monkeypatch):
    """Every second recording, with the numbers that the others gave; without friction it slides off."""
    monkeypatch.chdir(ORACLE.parent.parent if ORACLE.is_dir() else "/")
    file = tosses.recordings()
    if file is None:
        pytest.skip("the recorded tosses (shared/data/cube_tosses next to the repository) are not here")
    every, rate = recorded(read_recording(file))
    kept = every.some(np.arange(1, 150, 2))
    numbers = {"friction": 0.18, "restitution": 0.09, "metric_scale": -0.03, "size": 1.0, "inertia": 1.5}
    found = tosses._figures(*toss_errors(kept, rate, tosses.scene_of, numbers))
    assert found["position_mm"] < tosses.GOAL_MM
    assert found["attitude_deg"] < tosses.GOAL_DEG
    slippery = tosses._figures(*toss_errors(kept, rate, tosses.scene_of, numbers | {"friction": 0.05}))
    assert slippery["position_mm"] > 3 * tosses.GOAL_MM


def test_shorter_tosses_are_filled_up_with_their_last_frame():
    rows = np.arange(5.0)
    parts = {"position": 3, "orientation": 4, "velocity": 3, "angular_velocity": 3}
    columns = {k: np.tile(rows[:, None], (1, n)) for k, n in parts.items()}
    read = side_by_side(columns, np.array([2, 3]))
    np.testing.assert_array_equal(read.position[..., 0], [[0, 1, 1], [2, 3, 4]])
    np.testing.assert_array_equal(read.there, [[True, True, False], [True, True, True]])


def _same_rotation(state, wxyz):
    found = np.asarray(state.orientation.as_quaternion_array())[0]
    return min(np.abs(found - wxyz).max(), np.abs(found + np.array(wxyz)).max()) < LAST_DIGIT
