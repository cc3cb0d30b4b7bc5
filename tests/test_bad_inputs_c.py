"""C. Bad settings of runs: refused or warned of, with what, where, which value, and what to do.

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


SETTINGS = {
    "dt zero [35]": ({"dt": 0.0}, InvalidInput, r"dt is 0\.0 s, but must be positive and finite"),
    "dt negative [36]": ({"dt": -1e-3}, InvalidInput, r"dt is -0\.001 s"),
    "dt NaN [37]": ({"dt": np.nan}, InvalidInput, "dt is nan s"),
    "dt infinite [37]": ({"dt": np.inf}, InvalidInput, "dt is inf s"),
    "dt that float32 cannot hold [35]": ({"dt": 1e-60}, InvalidInput, "dt is 1e-60 s, too small .*float32"),
    "dt beyond float32 [37]": ({"dt": 1e60}, InvalidInput, "dt is 1e[+]60 s, too large .*float32"),
    "dt an array of words": ({"dt": np.asarray("1")}, WrongStructure, "is not a number"),
    "tolerance zero [43]": (
        {"tolerance": 0.0, "steps": 4},
        InvalidInput,
        "tolerance is 0.0.*between 0 and 1",
    ),
    "tolerance a word [43]": (
        {"tolerance": "x", "steps": 4},
        WrongStructure,
        "tolerance: 'x' is not a number",
    ),
    "no scene": ({"scene": None}, WrongStructure, r"NoneType is no Scene; write rb\.Scene"),
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
    if "float32" in case:
        state = scene.state(dtype=np.float32)
    scene = arguments.get("scene", scene)
    arguments = {name: value for name, value in arguments.items() if name != "scene"}
    start = time.process_time()
    with pytest.raises(error, match=message):
        rb.rollout(scene, state, **({"dt": 1e-3, "steps": 5} | arguments))
    if "tolerance" not in arguments:
        assert time.process_time() - start < 1.0


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


def test_solver_of_smooth_equations_refuses_contact():
    """[45]"""
    scene = rb.Scene(rb.Body.from_shape(rb.Sphere(0.1), 500.0), rb.RigidContact(rb.HalfSpace()))
    with pytest.raises(
        WrongStructure, match=r"RigidContact acts by impulses.*use rb\.solve_contact, or rb\.rollout"
    ):
        rb.solve(scene, scene.state(), t1=1.0)


LAWS = {
    "friction negative [47]": (
        {"friction": -0.1},
        InvalidInput,
        r"friction is -0\.1 1, but must not be negative",
    ),
    "restitution negative [47]": ({"restitution": -0.1}, InvalidInput, "restitution is -0.1 1"),
    "restitution above one [47]": (
        {"restitution": 1.1},
        InvalidInput,
        "restitution is 1.1 1, but must be at most",
    ),
    "friction NaN [47]": ({"friction": np.nan}, InvalidInput, "friction is nan 1, but must be finite"),
    "friction a word [47]": ({"friction": "rough"}, InvalidInput, "friction: 'rough' is not a real number"),
    "capacity a fraction": ({"capacity": 1.5}, WrongStructure, "capacity: 1.5 is not a whole number"),
    "capacity zero": ({"capacity": 0}, InvalidInput, "capacity is 0, but must be at least 1"),
    "tolerance one": ({"tolerance": 1.0}, InvalidInput, "tolerance is 1.0, but must lie between 0 and 1"),
    "tolerance a word": ({"tolerance": "x"}, WrongStructure, "tolerance: 'x' is not a number"),
}


@pytest.mark.parametrize("case", LAWS)
def test_bad_law_of_contact_is_refused(case):
    arguments, error, message = LAWS[case]
    with pytest.raises(error, match=rf"RigidContact\.{message}"):
        rb.RigidContact(**arguments)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_gravity_that_is_no_number_is_refused(value):
    """[46]"""
    with pytest.raises(InvalidInput, match=rf"UniformGravity\.acceleration is {value} m/s²"):
        rb.UniformGravity((0, 0, value))


def test_more_than_memory_is_refused_with_the_estimate(scene, state):
    """[50]"""
    with pytest.raises(LimitExceeded, match=r"replicate: 100000000000 bodies need \d+ GiB, more than 16 GiB"):
        rb.replicate(rb.Body(1.0, 1.0), 10**11)
    for call in (rb.rollout, rb.run):
        with pytest.raises(
            LimitExceeded, match=r"need \d+\.\d GiB, more than max_bytes = 0.1 GiB; raise save_every"
        ):
            call(scene, state, dt=1e-3, steps=10**7, max_bytes=2**27)


def test_step_lost_beside_the_time_is_warned_of(scene):
    late = scene.state(time=1e9, dtype=np.float32)
    with pytest.warns(JaxrbWarning, match=r"dt = 0\.001 s is lost beside the time 1e\+09 s in float32"):
        rb.rollout(scene, late, dt=1e-3, steps=1)
