"""The race of engines, short, with what is installed here; and the exponents of growth."""

import importlib.util
import math

import jax
import numpy as np
import pytest

from jaxrb.bench import engines, growth, ratios

pytestmark = pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"), reason="processes of their own: run once, with the float64 suite"
)


@pytest.fixture(scope="module")
def race():
    named = tuple(name for name in ("mujoco",) if importlib.util.find_spec(name))
    return list(engines.rows(2, ("jaxrb", *named, "no_such_engine"), 16, ("free",)))


def test_every_engine_is_measured_or_said_to_be_missing(race):
    for row in race:
        if row["engine"] == "no_such_engine":
            assert "not installed" in row["note"]
            continue
        assert row["body-steps/CPU s"] > 0
        assert 0 < row["least"] <= row["jaxrb/peer"] <= row["most"]
        assert row["peak [MB]"] > 10


def test_both_arrive_at_the_exact_attitude(race):
    ran = [row for row in race if row["engine"] != "no_such_engine"]
    for row in ran:
        assert 0 < row["error"] < 1e-6  # RK4, 0.01 s, 2 s
    assert ran[0]["engine"] == "jaxrb"
    assert ran[0]["gradient/run"] > 0


def test_overlap_is_that_of_the_lowest_corner():
    turn = np.array([np.cos(np.pi / 8), np.sin(np.pi / 8), 0.0, 0.0])  # 45 degrees about x
    end = np.array([[0.0, 0.0, 0.5, *turn], [0.0, 0.0, 0.35 * np.sqrt(0.5) - 2e-3, *turn]])
    assert engines._error({"half": [0.1, 0.15, 0.2]}, end, None) == pytest.approx(2.0)


def test_exponents_are_those_of_what_was_made():
    sizes = (10, 100, 1000)
    assert growth.exponent(sizes, [3e-6 * n**1.25 for n in sizes]) == pytest.approx(1.25)
    seconds = np.outer([1.0, 1.1, 0.9], np.asarray(sizes, float) ** 1.5)
    *_, last = growth._rows("squares", sizes, seconds, [8 * n for n in sizes], "a step")
    assert last["exponent"] == pytest.approx(1.5)
    found = growth.foretold(last, 4000)
    assert found["time"] == pytest.approx(1e3 * 4000**1.5)
    assert found["memory [MB]"] == pytest.approx(1e-6 * 8 * 4000)


def test_a_case_runs_and_says_its_memory():
    steps = 20
    case = growth.Case("bodies", (4, 16), growth._single(growth._free, steps), lambda n: steps)
    few, many = growth.measured(case, 2)
    assert few["exponent"] is None
    assert math.isfinite(many["exponent"])
    assert many["from"] <= many["exponent"] <= many["to"]
    assert many["memory [MB]"] >= 1e-6 * 16 * 13 * 8  # the states that it is given


def test_ratios_are_judged_by_their_median_and_missing_peers_are_named():
    kept, missed = (
        ratios._kept("a run", "a peer", [0.4, 0.5, 3.0], 0.5),
        ratios._kept("a run", "it", [0.6], 0.5),
    )
    assert (kept["time over its"], kept["least"], kept["most"], kept["verdict"]) == (0.5, 0.4, 3.0, "kept")
    assert missed["verdict"] == "missed"
    assert ratios._missing("a run", "a peer", "not installed").keys() == kept.keys()
