"""The commands that measure: kills, the cost of safety, the same bits, and hard cases in other engines.

JAXRB_LONG=1 compares with the hashes that are kept, too.
"""

import json
import os
import sys

import numpy as np
import pytest

from jaxrb.errors import InvalidInput
from jaxrb.hard import cases_named, contact_peers, kills, peer_engines, safety_costs, same_bits
from jaxrb.hard import command as commands
from jaxrb.hard.contact_peers import Flight, figure
from jaxrb.integrators.semi_implicit import SemiImplicitEuler


def test_a_killed_run_loses_nothing(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["kills", "--kills", "2"])
    kills.main()
    found = json.loads(capsys.readouterr().out)
    assert found["lost_steps"] == 0
    assert found["same_bits"]
    assert found["steps"] >= 50
    monkeypatch.setattr(kills, "kills", lambda *_: found | {"same_bits": False})
    with pytest.raises(SystemExit):
        kills.main()


def test_cost_of_safety_is_measured_and_judged(monkeypatch, capsys):
    free = lambda: safety_costs.free_bodies(2, SemiImplicitEuler(), 50)  # noqa: E731
    monkeypatch.setattr(safety_costs, "scenes", lambda: [("two", free)])
    (row,) = safety_costs.guard(rounds=2)
    assert row["low"] <= row["share"] <= row["high"] < 1
    rows = list(safety_costs.files(rounds=1, seconds=0.2))
    assert [0 < row["share"] < 1 for row in rows] == [True] * 4  # two scenes, processor and clock
    monkeypatch.setattr(safety_costs, "guard", lambda: [row | {"share": 0.2, "limit": 0.1}])
    monkeypatch.setattr(safety_costs, "files", lambda seconds: [])
    monkeypatch.setattr(sys, "argv", ["safety_costs"])
    with pytest.raises(SystemExit):
        safety_costs.main()
    assert "20.00 %" in capsys.readouterr().out


def test_bits_are_compared_among_processes_and_with_those_kept(monkeypatch, tmp_path, capsys):
    said = [{"a": "1", "b": "2"}, {"a": "1", "b": "3"}]
    monkeypatch.setattr(same_bits, "KEPT", tmp_path / "kept.json")
    with pytest.raises(InvalidInput, match="install jaxrb again"):
        same_bits.kept()
    same_bits.KEPT.write_text("{}")
    monkeypatch.setattr(same_bits, "in_fresh_processes", lambda names, count: said)
    monkeypatch.setattr(sys, "argv", ["same_bits"])
    with pytest.raises(SystemExit):
        same_bits.main()
    found = json.loads(capsys.readouterr().out)
    assert (found["differing"], found["changed_since_kept"]) == (["b"], None)
    said[1]["b"] = "2"
    monkeypatch.setattr(sys, "argv", ["same_bits", "--write"])
    same_bits.main()
    assert same_bits.changed({"a": "1", "b": "4", "new": "5"}) == ["b"]


@pytest.mark.skipif(os.environ.get("JAXRB_LONG") != "1", reason="JAXRB_LONG=1 compares bits with those kept")
def test_bits_of_scenes_are_those_that_are_kept():
    found = same_bits.ends(same_bits.QUICKEST)
    changed = same_bits.changed(found)
    if changed is None:
        pytest.skip(f"none are kept for {same_bits.place()}")
    assert not changed, "if the change is meant: python -m jaxrb.hard.same_bits --write"


STILL = np.zeros((3, 2, 13))
STILL[..., 2:4] = 1.0
PILE = Flight("boxes", [1.0, 2.0], [0.1] * 3, [(0, 0, 0.1), (0, 0, 0.3)])


@pytest.mark.parametrize("what", ["drift", "speed", "rest", "sink", "energy"])
def test_figures_of_other_engines_are_what_they_say(what):
    states = STILL.copy()
    states[:, :, 2] = (0.1, 0.3)
    assert figure(PILE, what, states) == pytest.approx(0.0, abs=1e-12)
    states[1, 1, 7:10] = (3.0, 0.0, 4.0)  # m/s, on the way
    states[2, 1, 2] = 0.25  # 5 cm into the other at the end
    states[2, 0, 7] = 2.0
    # The heavier box has 25 J on the way; the rise is told of what there is: 9.81 · 0.7 J, and its fastest speed.
    exact = {"drift": 0.05, "speed": 5.0, "rest": 2.0, "sink": 0.05, "energy": 25.0 / (9.81 * 0.7 + 12.5)}[
        what
    ]
    assert figure(PILE, what, states) == pytest.approx(exact)
    states[2, 0] = np.nan
    assert np.isnan(figure(PILE, "rest", states))


def test_mujoco_flies_the_hard_cases():
    pytest.importorskip("mujoco")
    assert cases_named("mass ratio 1e6 in a stack")[0].peer() > 0.01  # its light box goes through the floor
    (rattleback,) = cases_named("rattleback")
    (states,) = peer_engines.in_mujoco([rattleback.flight.plain()])
    assert states.shape == (peer_engines.SAVES + 1, 1, 13)
    assert rattleback.of_peer(states) < 0.1


def test_an_engine_that_is_not_there_is_said(monkeypatch):
    monkeypatch.setattr(contact_peers.peer_engines, "__file__", "nowhere.py")
    assert contact_peers.flown("mjx", [PILE]).startswith("not measured: ")


def test_table_has_a_column_for_each_engine(monkeypatch, capsys):
    def flown(engine, flights):
        if engine == "brax":
            return "not measured: no module named brax"
        return [None if flight.kind == "ellipsoid" else STILL for flight in flights]

    monkeypatch.setattr(commands, "flown", flown)
    monkeypatch.setattr(commands, "judge", lambda case: commands.Verdict(
        case.name, "float64", 0.0, 1.0, "ok", True, None, None, True, "", ""))  # fmt: skip
    monkeypatch.setattr(commands, "mujoco_version", lambda: None)
    commands.hard_cases(only="mass ratio 1e6 in a stack", peers=True)
    shown = capsys.readouterr().out
    assert "MJX" in shown
    assert "no module named brax" in shown
    commands.hard_cases(only="box on box", peers=True, json=True)
    found = json.loads(capsys.readouterr().out)["cases"]
    assert found[0]["mjx"] == 0.0
