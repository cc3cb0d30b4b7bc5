"""Work and precision where bodies touch: closed forms, points, words."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.accuracy import contact_tosses
from jaxrb.accuracy.contact_report import summary
from jaxrb.accuracy.contact_scenes import bouncing_ball, cases_of, sliding_block
from jaxrb.accuracy.contact_work_precision import ContactPoint, ContactWorkPrecision, contact_work_precision


def test_closed_forms_keep_to_their_laws():
    times = np.linspace(0.0, 5.0, 5001)
    place, _ = bouncing_ball().exact(times)
    height = place[:, 0, 2] - 0.1
    assert height.min() > -1e-12
    # Between impacts the ball falls freely.
    bend = np.diff(height, 2) / np.diff(times)[0] ** 2
    assert np.median(np.abs(bend[:3000] + 9.81)) < 1e-5
    slid, _ = sliding_block().exact(np.asarray([0.0, 10.0]))
    assert slid[1, 0, 0] == pytest.approx(4.0 / (2 * 0.3 * 9.81))


def test_solve_contact_arrives_with_fewer_steps(dtype):
    if dtype == jnp.float32:
        pytest.skip("the command measures in float64, whatever the precision of the run")
    (found,) = contact_work_precision(["bouncing_ball"], quick=True)
    own = {p.setting: p for p in found.points if p.who == "solve_contact"}
    fixed = [p for p in found.points if p.who == "rollout"]
    assert own["tolerance 1e-06"].error < 1e-10
    assert own["tolerance 1e-06"].steps < fixed[-1].steps / 10
    assert fixed[0].error > 100 * fixed[-1].error
    json.dumps(found.as_dict())
    assert "solve_contact" in summary([found])


def test_times_at_equal_error_compare_like_with_like():
    points = (
        ContactPoint("s", "solve_contact", "a", 1e-3, 1.0, 1), ContactPoint("s", "solve_contact", "b", 1e-6, 2.0, 1),
        ContactPoint("s", "rollout", "c", 1e-4, 4.0, 1), ContactPoint("s", "MuJoCo", "d", 1e-9, 1.0, 1),
    )  # fmt: skip
    rows = ContactWorkPrecision("s", "scene", "closed form", 1e-14, points).at_equal_error()
    assert [(row["solve_contact"], row["time over theirs"]) for row in rows] == [
        ("b", 0.5),
        ("does not arrive", None),
    ]


def test_unknown_scenes_are_refused_with_the_nearest():
    with pytest.raises(rb.UnknownName, match="cube_toss"):
        cases_of(["cube_tos"])


def test_shares_of_certificates_within_a_factor_of_ten(monkeypatch, capsys):
    """Where the truth is known to less than a fifth of the error, and of all tosses."""
    numbers = [  # error, estimate, sum of steps, how well the truth is known, and of fixed steps: error, estimate
        (1e-5, 2e-5, 1e-3, 1e-7, 1e-2, 2e-2),
        (1e-5, 2e-7, 3e-5, 1e-7, 1e-2, 5e-4),
        (1e-6, 1e-3, 1e-6, 5e-7, 3e-2, 1.0),
        (1e-4, 9e-4, 2e-4, 1e-7, 1e-2, 1e-2),
    ]
    found = [contact_tosses.Toss(0.5, 0.2, *row) for row in numbers]
    wanted = {
        "tosses": 4,
        "truth known": 3,
        "second run": pytest.approx(2 / 3),
        "second run, all": 0.5,
        "sum of steps": pytest.approx(2 / 3),
        "fixed steps, all": 0.5,
        "median error": pytest.approx(1e-5),
        "median error of fixed steps": pytest.approx(1e-2),
    }
    assert contact_tosses.shares(found) == wanted
    monkeypatch.setattr(contact_tosses, "tosses", lambda count: iter(found[:count]))
    contact_tosses.main(count=4, json=True)
    told = json.loads(capsys.readouterr().out)
    assert {name: told[name] for name in wanted} == wanted
    assert told["each"][2]["fixed_estimate"] == 1.0
    contact_tosses.main(count=4)
    assert "truth known                  3\n" in capsys.readouterr().out
