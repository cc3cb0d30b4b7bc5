"""Every hard case in the precision of the run; and the judge must be able to say no."""

import dataclasses
import warnings

import numpy as np
import pytest

from jaxrb.errors import InvalidInput, JaxrbWarning, UnknownName
from jaxrb.hard import CASES, Case, Measured, cases_named, judge

ANY = {"float64": 1.0, "float32": 1.0}


def case(run, **changes):
    """A case with a limit of one."""
    return Case("made up", "nothing", "figure", ANY, run, **changes)


@pytest.mark.parametrize("hard_case", CASES, ids=lambda c: c.name)
def test_stays_stable(hard_case):
    verdict = judge(hard_case)
    assert verdict.passed, verdict.reason


def test_names_are_unique_and_limits_known_in_both_precisions():
    assert len({c.name for c in CASES}) == len(CASES)
    for c in CASES:
        assert {*c.limit} == {"float64", "float32"}


def warned():
    warnings.warn("something odd", JaxrbWarning, stacklevel=1)
    return Measured(0.0)


def refused():
    raise InvalidInput("no")


REPORTED = {
    "a figure beyond its limit": (case(lambda: Measured(1.1)), "beyond the limit"),
    "an infinite figure": (case(lambda: Measured(np.inf)), "beyond the limit"),
    "NaN": (case(lambda: Measured(np.nan)), "NaN"),
    "a gradient with NaN": (case(lambda: Measured(0.0, [np.ones(3), np.asarray([1, np.nan])])), "not finite"),
    "an infinite gradient": (case(lambda: Measured(0.0, np.inf)), "not finite"),
    "a wrong gradient": (
        case(lambda: Measured(0.0, np.ones(3), 1.5), gradient_limit=ANY), "gradient is off by 1.5"
    ),
    "a gradient error of NaN": (
        case(lambda: Measured(0.0, np.ones(3), np.nan), gradient_limit=ANY), "gradient is off by nan"
    ),
    "a gradient that is missing": (case(lambda: Measured(0.0), gradient_limit=ANY), "gradient is off by None"),
    "a run that should have been flagged": (case(lambda: Measured(0.0), ends="flagged"), "'flagged' is right"),
    "a run that should not have been": (case(lambda: Measured(0.0, status="flagged")), "'ok' is right"),
    "an input that was refused": (case(refused), "'InvalidInput'"),
    "a warning that is missing": (case(lambda: Measured(0.0), warns="coarse"), "no warning says 'coarse'"),
    "a warning nobody expected": (case(warned), "unexpected warning: something odd"),
}  # fmt: skip


@pytest.mark.parametrize("name", REPORTED)
def test_failure_is_reported(name):
    made_up, reason = REPORTED[name]
    verdict = judge(made_up)
    assert not verdict.passed
    assert reason in verdict.reason


def test_what_is_right_passes():
    assert judge(case(lambda: Measured(0.5, np.ones(3), 0.5), gradient_limit=ANY)).passed
    assert judge(case(refused, ends="InvalidInput")).passed
    assert judge(case(warned, warns="odd")).passed


@pytest.mark.parametrize("name", ["needle of inertia 1e-6", "spring of zero length", "deep inside"])
def test_a_real_case_fails_where_its_limit_is_out_of_reach(name):
    (hard_case,) = cases_named(name)
    verdict = judge(dataclasses.replace(hard_case, limit={"float64": -1.0, "float32": -1.0}))
    assert not verdict.passed
    assert verdict.figure >= 0


def test_a_name_that_does_not_exist_is_refused_with_the_nearest():
    with pytest.raises(UnknownName, match="on the separatrix"):
        cases_named("on the seperatrix")
