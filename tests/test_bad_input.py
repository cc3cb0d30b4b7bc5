"""Bad bodies and settings of runs: refused or warned of, with what, where, which value, and what to do.

The numbers in brackets are those of the project's list of bad inputs.
"""

import time

import jax
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import (
    InvalidInput,
    JaxrbError,
    JaxrbWarning,
    LimitExceeded,
    RunFailed,
    UnknownName,
    WrongStructure,
)


@pytest.fixture(scope="module")
def scene():
    """Two boxes without effects."""
    return rb.Scene(rb.replicate(rb.Body.from_shape(rb.Box((0.1, 0.05, 0.02)), density=700.0), 2))


@pytest.fixture(scope="module")
def state(scene):
    return scene.state(angular_velocity=(1.0, 2.0, 3.0))


MASSES = {0.0: "positive", -1.0: "positive", np.nan: "finite", np.inf: "finite"}


@pytest.mark.parametrize("mass", MASSES)
def test_bad_mass_is_refused_with_the_mend(mass):
    """[21, 22, 23]; inertias [25-29] and the range [24] are in body/test_validity.py."""
    with pytest.raises(
        InvalidInput, match=rf"Body\.mass is .*{mass}.* kg, but must be {MASSES[mass]}.*fix what never moves"
    ):
        rb.Body(mass, 1.0)


@pytest.mark.parametrize("density", [0.0, -700.0, np.nan, np.inf])
def test_bad_density_is_refused(density):
    """[34]"""
    with pytest.raises(InvalidInput, match=f"density is {density} kg/m³"):
        rb.Body.from_shape(rb.Sphere(0.1), density=density)


SETTINGS = {
    "dt zero [35]": ({"dt": 0.0}, InvalidInput, r"dt is 0\.0 s, but must be positive and finite"),
    "dt negative [36]": ({"dt": -1e-3}, InvalidInput, r"dt is -0\.001 s"),
    "dt NaN [37]": ({"dt": np.nan}, InvalidInput, "dt is nan s"),
    "dt infinite [37]": ({"dt": np.inf}, InvalidInput, "dt is inf s"),
    "dt a list": ({"dt": [1e-3, 1e-3]}, WrongStructure, r"dt: shape \(2,\); give one number"),
    "dt a word": ({"dt": "fast"}, WrongStructure, "dt: 'fast' is not a number"),
    "steps negative [39]": ({"steps": -1}, InvalidInput, "steps is -1, but must be at least 0"),
    "steps a fraction": ({"steps": 10.5}, WrongStructure, "steps: 10.5 is not a whole number"),
    "save_every zero": ({"save_every": 0}, InvalidInput, "save_every is 0, but must be at least 1"),
    "steps beyond memory [41]": (
        {"steps": 10**10},
        LimitExceeded,
        r"10000000001 saved states of \d+ bytes need \d+\.\d GiB.*save_every or max_bytes",
    ),
    "steps beyond counting [41]": (
        {"steps": 10**10, "save_every": 10**9},
        InvalidInput,
        "continue from path.final",
    ),
    "method misspelt [42]": (
        {"method": "RungeKuta4"},
        UnknownName,
        "did you mean RungeKutta4.*There are .*VelocityVerlet",
    ),
    "method unheard of [42]": (
        {"method": "xyzzy"},
        UnknownName,
        "'xyzzy' is not known; There are ExplicitEuler",
    ),
    "method a class [42]": ({"method": rb.RungeKutta4}, WrongStructure, r"write RungeKutta4\(\)"),
    "method a number [42]": ({"method": 4}, WrongStructure, "4 is no method"),
    "on_error": ({"on_error": "ignore"}, WrongStructure, "'raise' or 'flag'"),
    "torque of wrong shape": (
        {"torque": np.zeros(4)},
        WrongStructure,
        r"torque: shape \(4,\); give \(2, 3\) \[N m\].*\(5, 2, 3\)",
    ),
    "torque NaN": ({"torque": (np.nan, 0, 0)}, InvalidInput, "torque: a number is not finite"),
}


@pytest.mark.parametrize("case", SETTINGS)
def test_bad_setting_is_refused_before_anything_starts(scene, state, case):
    arguments, error, message = SETTINGS[case]
    start = time.perf_counter()
    with pytest.raises(error, match=message):
        rb.rollout(scene, state, **({"dt": 1e-3, "steps": 5} | arguments))
    assert time.perf_counter() - start < 1.0


@pytest.mark.parametrize("name", ["rtol", "atol"])
@pytest.mark.parametrize("value", [0.0, -1e-6, 1.0, np.nan, np.inf])
def test_bad_tolerance_is_refused(scene, state, name, value):
    """[43]"""
    with pytest.raises(InvalidInput, match=f"{name} is {value}.*between 0 and 1"):
        rb.solve(scene, state, t1=1.0, **{name: value})


def test_no_steps_give_back_the_initial_state(scene, state):
    """[40]"""
    path = rb.rollout(scene, state, dt=1e-3, steps=0)
    assert np.asarray(path.times).tolist() == [0.0]
    assert bool(path.status.ok)
    for one, other in zip(jax.tree.leaves(path.final), jax.tree.leaves(state), strict=True):
        assert np.array_equal(one, other)


def test_step_that_turns_a_body_by_more_than_a_quarter_turn_is_warned_of(scene):
    """[11]"""
    fast = scene.state(angular_velocity=[(0, 0, 1.0), (0, 0, 200.0)])
    with pytest.warns(
        JaxrbWarning, match="turns body 1 by 2.00 rad a step.*a dt of 0.0005 s would resolve it"
    ):
        rb.rollout(scene, fast, dt=1e-2, steps=1)


@pytest.mark.parametrize(
    "effect", [rb.SpringDamper(4e6), rb.SpringDamper(1.0, damping=1e3), rb.LinearDrag(1e3)]
)
def test_step_beyond_stability_is_warned_of_with_the_step_that_is_not(effect):
    """[38, 48]"""
    scene = rb.Scene(rb.Body(1.0, 1.0), effect)
    with pytest.warns(
        JaxrbWarning, match=rf"beyond the stability of RungeKutta4 for {type(effect).__name__}.*below 0\.00"
    ):
        rb.rollout(scene, scene.state(), dt=1e-2, steps=1)
    rb.rollout(scene, scene.state(), dt=1e-4, steps=1)


def test_every_error_is_one_of_ours_and_of_python():
    for error, builtin in ((InvalidInput, ValueError), (WrongStructure, TypeError), (UnknownName, LookupError),
                           (LimitExceeded, MemoryError), (RunFailed, ArithmeticError)):  # fmt: skip
        assert issubclass(error, JaxrbError)
        assert issubclass(error, builtin)
