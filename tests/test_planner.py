"""The planner: its pick meets the tolerance, against a reference that it has not seen, and is near the cheapest."""

import dataclasses
import json
import math

import jax
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.accuracy import plan_cache
from jaxrb.accuracy.pilot import COARSEST_TURN, Trial, fewest_steps, first_steps, observed_order, predicted
from jaxrb.accuracy.planner import plan
from jaxrb.accuracy.reference import Errors, errors, reference
from jaxrb.bench.planner import rows, share_within
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.integrators import METHODS as METHODS_BY_NAME
from jaxrb.scene.library import example_of

METHODS = ("RungeKutta4", "VelocityVerlet", "SemiImplicitEuler")


@pytest.fixture(scope="module")
def top():
    return dataclasses.replace(example_of("heavy_top"), duration=3.0)


@pytest.fixture(scope="module")
def answer(top):
    with jax.enable_x64(True):
        return reference(top.scene, top.state(dtype="float64"), top.duration)


@pytest.mark.parametrize("tolerance_exponent", [-2, -4])
def test_pick_meets_its_tolerance(top, answer, tolerance_exponent):
    """In either precision; the planner's own judge is another computation than the reference here."""
    wanted = 10.0**tolerance_exponent
    picked = plan(top.scene, top.state(), top.duration, wanted, methods=METHODS)
    path = rb.rollout(top.scene, top.state(), dt=picked.dt, steps=picked.steps, method=picked.method)
    assert errors(top.scene, path.final, answer.state).attitude <= 1.1 * wanted
    assert picked.verified_error <= wanted
    assert picked.dt * picked.steps == pytest.approx(top.duration)


def test_pick_wastes_few_steps(top, answer):
    """With 20 % fewer steps the tolerance is missed."""
    with jax.enable_x64(True):
        state = top.state()
        picked = plan(top.scene, state, top.duration, 1e-6, methods=("RungeKutta4",))
        fewer = int(0.8 * picked.steps)
        path = rb.rollout(top.scene, state, dt=top.duration / fewer, steps=fewer, method=picked.method)
    assert errors(top.scene, path.final, answer.state).attitude > 1e-6


def test_evidence_shows_the_order_and_foretells_the_error(top):
    with jax.enable_x64(True):
        picked = plan(top.scene, top.state(), top.duration, 1e-6, methods=METHODS)
    runge_kutta = next(e for e in picked.evidence if e.method == "RungeKutta4")
    assert runge_kutta.observed_order == pytest.approx(4, abs=0.4)
    assert runge_kutta.predicted_error == pytest.approx(runge_kutta.verified_error, rel=0.3)
    assert runge_kutta.seconds_per_step > 0
    by_constant = runge_kutta.error_constant * picked.dt**4
    assert by_constant == pytest.approx(picked.verified_error, rel=1e-6)
    euler = next(e for e in picked.evidence if e.method == "SemiImplicitEuler")
    assert "too low an order" in euler.note
    assert "RungeKutta4" in picked.summary()
    assert json.loads(json.dumps(picked.as_dict()))["steps"] == picked.steps


def test_tolerance_below_round_off_is_refused(top):
    with pytest.raises(InvalidInput, match="cannot be verified"):
        plan(top.scene, top.state(), top.duration, 1e-15, methods=METHODS)
    if top.state().dtype == np.float32:
        with pytest.raises(InvalidInput, match="use float64"):
            plan(top.scene, top.state(), top.duration, 1e-9, methods=METHODS)


@pytest.mark.parametrize("t1", [0.0, -1.0, np.nan])
def test_end_before_the_start_is_refused(top, t1):
    with pytest.raises(InvalidInput, match="later"):
        plan(top.scene, top.state(), t1, 1e-3)


def test_plan_does_not_run_while_traced(top):
    with pytest.raises(WrongStructure, match="outside"):
        jax.jit(lambda s: plan(top.scene, s, 1.0, 1e-3).steps)(top.state())


class Law:
    """A pilot of known error: C stepsᵖ over the tolerance, nothing below a floor, no number below `stable` steps."""

    def __init__(self, top, constant, order, floor=0.0, stable=0):
        self.scene, self.state, self.duration = top.scene, top.state(), top.duration
        self.constant, self.order, self.floor, self.stable = constant, order, floor, stable

    def trial(self, method, steps):
        excess = self.constant / steps**self.order + self.floor if steps >= self.stable else math.inf
        return Trial(steps, Errors(1e-3 * excess, 0.0, 0.0), excess)


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("needed", [40, 1000, 300_000])
def test_search_finds_the_fewest_steps(top, order, needed):
    method = {1: rb.ExplicitEuler(), 2: rb.VelocityVerlet(), 4: rb.RungeKutta4()}[order]
    trials, good = fewest_steps(Law(top, float(needed) ** order, order), method, 1e9)
    assert needed <= good.steps <= 1.15 * needed
    assert len(trials) <= 8


def test_search_gives_up_at_a_floor(top):
    trials, good = fewest_steps(Law(top, 1e6, 2, floor=3.0), rb.VelocityVerlet(), 1e9)
    assert good is None
    assert max(t.steps for t in trials) < 1e7


def test_search_of_a_method_that_overflows_below_some_steps_ends_near_them(top):
    trials, good = fewest_steps(Law(top, 10.0, 2, stable=5000), rb.VelocityVerlet(), 1e9)
    assert 5000 <= good.steps <= 1.3 * 5000
    assert any(math.isinf(t.excess) for t in trials)


def test_search_of_a_method_without_error_takes_steps_of_a_quarter_turn_at_most(top):
    _, good = fewest_steps(Law(top, 0.0, 2), rb.VelocityVerlet(), 1e9)
    assert good.steps == first_steps(top.scene, top.state(), rb.VelocityVerlet(), top.duration, COARSEST_TURN)


def test_one_trial_shows_no_order():
    trial = Trial(100, Errors(0, 0, 0), 2.0)
    assert observed_order([trial]) is None
    assert observed_order([trial, trial]) is None
    assert observed_order([trial, Trial(200, Errors(0, 0, 0), math.inf)]) is None


def test_what_no_method_reaches_or_works_on_is_refused(top, monkeypatch):
    monkeypatch.setattr("jaxrb.accuracy.planner.MOST_STEPS", 8)
    with pytest.raises(InvalidInput, match=r"no method meets the tolerance 0\.0001 in float"):
        plan(top.scene, top.state(), top.duration, 1e-4, methods="VelocityVerlet")
    angles = top.state(rotation=rb.EulerAngles)
    with pytest.raises(WrongStructure, match=r"none of \('ImplicitMidpoint',\) works on Euler angles"):
        plan(top.scene, angles, top.duration, 1e-2, methods=("ImplicitMidpoint",))


def test_a_folder_for_plans_that_cannot_be_written_is_told(top, tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(InvalidInput, match=r"cache folder .*taken: .*name one that you can write"):
        plan(top.scene, top.state(), top.duration, 3.1e-3, methods=("RungeKutta4",), cache=tmp_path / "taken")


def test_prediction_follows_the_order():
    trials = [Trial(100, Errors(0, 0, 0), 16.0), Trial(200, Errors(0, 0, 0), 1.1)]
    assert predicted(trials, 200, 4) == pytest.approx(1.0)


def test_plans_are_kept(top, tmp_path, monkeypatch):
    """In memory; in a folder when asked, private, for the same numbers only; a damaged file counts as none."""
    state, folder = top.state(), tmp_path / "plans"
    settings = {"methods": ("RungeKutta4",), "cache": folder}
    first = plan(top.scene, state, top.duration, 3e-3, **settings)
    assert plan(top.scene, state, top.duration, 3e-3, **settings) is first
    (file,) = folder.iterdir()
    assert folder.stat().st_mode & 0o077 == 0
    monkeypatch.setattr(plan_cache, "_KNOWN", {})
    again = plan(top.scene, state, top.duration, 3e-3, **settings)
    assert again.as_dict() == first.as_dict()
    moved = jax.tree.map(lambda leaf: leaf * 1.01, top.scene)
    assert plan(moved, state, top.duration, 3e-3, **settings).steps
    assert len(list(folder.iterdir())) == 2
    monkeypatch.setattr(plan_cache, "_KNOWN", {})
    file.write_text("{")
    assert plan(top.scene, state, top.duration, 3e-3, **settings).steps == first.steps


def test_picks_are_near_the_best(dtype, monkeypatch):
    """One scene of the grid that `jaxrb bench --planner` runs whole; few methods, as compiling is what takes long."""
    if dtype == np.float32:
        pytest.skip("times are compared once")
    few = {name: METHODS_BY_NAME[name] for name in METHODS}
    monkeypatch.setattr("jaxrb.accuracy.work_precision.METHODS", few)
    found = list(rows(("tumbling_brick",), (1e-3, 1e-6)))
    assert share_within(found, 2.0) == 1.0, found


def test_a_run_to_a_stated_tolerance_chooses_its_own_step(top, answer):
    with jax.enable_x64(True):
        path = rb.rollout(
            top.scene, top.state(), t1=top.duration, tolerance=1e-5, saves=6, method="RungeKutta4"
        )
    assert errors(top.scene, path.final, answer.state).attitude <= 1.1e-5
    assert path.times.shape == (7,)
    np.testing.assert_allclose(path.times, np.linspace(0, top.duration, 7), atol=1e-12)
    assert path.certificate is not None
    assert float(path.certificate.tolerance) == 1e-5
    assert float(path.certificate.attitude_error[0]) < 2e-5


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"dt": 1e-3}, "given dt"),
        ({}, "give dt and steps"),
        ({"t1": 1.0}, "tolerance"),
        ({"dt": 1e-3, "steps": 5, "t1": 1.0}, "given dt, steps, t1"),
        ({"t1": 1.0, "tolerance": 1e-3, "torque": (0, 0, 1)}, "PrescribedTorque"),
        ({"t1": 1.0, "tolerance": 1e-3, "save_every": 10}, "saves"),
        ({"t1": 1.0, "tolerance": 2.0}, "between 0 and 1"),
    ],
)
def test_half_stated_runs_are_refused(top, given, named):
    with pytest.raises(rb.JaxrbError, match=named):
        rb.rollout(top.scene, top.state(), **given)


def test_a_planned_run_cannot_be_traced(top):
    with pytest.raises(WrongStructure, match="plan outside"):
        jax.jit(lambda state: rb.rollout(top.scene, state, t1=1.0, tolerance=1e-3).final)(top.state())
