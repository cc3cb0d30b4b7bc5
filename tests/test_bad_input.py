"""Bad states, bodies, settings and effects: refused, warned of or flagged, each with what, where, which value, what to do.

The numbers in brackets are those of the project's list of bad inputs.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbError, JaxrbWarning, LimitExceeded, RunFailed, UnknownName, WrongStructure
from jaxrb.scene.status import NOT_A_ROTATION, NOT_FINITE


@pytest.fixture(scope="module")
def scene():
    """Two boxes without effects."""
    return rb.Scene(rb.replicate(rb.Body.from_shape(rb.Box((0.1, 0.05, 0.02)), density=700.0), 2))


@pytest.fixture(scope="module")
def state(scene):
    return scene.state(angular_velocity=(1.0, 2.0, 3.0))


GOOD = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
MIRROR = [[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]]
STATES = {
    "NaN position [1]": ({"position": [GOOD[0], [0, np.nan, 1]]}, InvalidInput, r"state\.position of body 1 is .*nan.* m, but must be finite"),
    "infinite position [2]": ({"position": (0, 0, np.inf)}, InvalidInput, r"state\.position is .*inf.* m.*finite"),
    "NaN quaternion [3]": ({"orientation": (np.nan, 0, 0, 0)}, InvalidInput, r"state\.orientation.*nan"),
    "zero quaternion [4]": ({"orientation": (0, 0, 0, 0)}, InvalidInput, r"state\.orientation.*norm.*by 1:.*\[0\.0, 0\.0, 0\.0, 0\.0\].*normalise"),
    "long quaternion of body 1 [6]": ({"orientation": [[1, 0, 0, 0], [1.1, 0, 0, 0]]}, InvalidInput, r"of body 1: the norm.*by 0\.1.*1\.1.*normalise"),
    "skew matrix [8]": ({"orientation": [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]}, InvalidInput, r"RᵀR differs from 1 by 0\.1.*no rotation"),
    "reflection [9]": ({"orientation": [np.eye(3).tolist(), MIRROR]}, InvalidInput, "determinant of the matrix of body 1 is negative.*reflection.*sign of one axis"),
    "NaN velocity [10]": ({"velocity": (np.nan, 0, 0)}, InvalidInput, r"state\.velocity is .*nan.* m/s"),
    "NaN spin [10]": ({"angular_velocity": [(0, 0, 0), (0, np.nan, 0)]}, InvalidInput, r"state\.angular_velocity of body 1 is .*nan.* rad/s"),
    "too large for float32 [14]": ({"position": (1e39, 0, 0), "dtype": np.float32}, InvalidInput, r"state\.position is .*1e\+39.* m, too large for float32.*float64 or larger units"),
    "wrong number of bodies [15]": ({"position": [GOOD[0]] * 3}, WrongStructure, r"state\.position: shape \(3, 3\); give \(2, 3\), or \(3,\)"),
    "wrong number of components [15]": ({"velocity": (1.0, 2.0)}, WrongStructure, r"state\.velocity: shape \(2,\)"),
    "three numbers for a quaternion [15]": ({"orientation": (0, 0, 1)}, WrongStructure, r"state\.orientation: shape \(3,\).*wxyz"),
    "wrong number of orientations [15]": ({"orientation": [[1.0, 0, 0, 0]] * 5}, WrongStructure, r"shape \(5, 4\) for 2 bodies"),
    "words": ({"position": "here"}, InvalidInput, r"state\.position: 'here' is not a real number"),
    "complex numbers": ({"velocity": (1j, 0, 0)}, InvalidInput, "is not a real number"),
    "ragged rows": ({"position": [[0, 0, 0], [0, 0]]}, InvalidInput, "is not a real number"),
    "NaN time": ({"time": np.nan}, InvalidInput, r"state\.time is .*nan.* s"),
    "integer type": ({"dtype": np.int32}, WrongStructure, "int32 is not a floating type"),
    "no representation": ({"rotation": "quaternion"}, WrongStructure, "Quaternion, RotationMatrix or EulerAngles"),
}  # fmt: skip


@pytest.mark.parametrize("case", STATES)
def test_bad_state_is_refused(scene, case):
    arguments, error, message = STATES[case]
    with pytest.raises(error, match=message):
        scene.state(**arguments)


@pytest.mark.parametrize("body", [0, 1])
def test_nearly_unit_orientation_is_normalised_with_a_warning(scene, body):
    """[5]"""
    wxyz = np.tile([0.6, 0.0, 0.8, 0.0], (2, 1))
    wxyz[body] *= 1.0005
    with pytest.warns(JaxrbWarning, match=f"of body {body}: the norm.*by 0.0005; it was normalised"):
        found = scene.state(orientation=wxyz.tolist())
    assert np.linalg.norm(found.orientation.wxyz, axis=-1) == pytest.approx(1.0, abs=3e-7)
    with pytest.warns(JaxrbWarning, match="RᵀR differs from 1 by 0.0004; it was normalised"):
        found = scene.state(orientation=(1.0002 * np.eye(3)).tolist(), rotation=rb.RotationMatrix)
    assert np.asarray(found.orientation.matrix[0]) == pytest.approx(np.eye(3), abs=3e-7)


def test_quaternion_rounded_to_seven_digits_is_exact_as_far_as_its_owner_knows(scene):
    scene.state(orientation=(0.7071068, 0.0, 0.7071068, 0.0))


@pytest.mark.parametrize("renormalise", [True, False])
def test_orientation_that_is_no_rotation_when_a_run_starts_is_flagged(scene, state, renormalise):
    """A state changed by hand; a method that renormalises would hide it. [7]"""
    bent = jax.tree.map(lambda x: x.at[1].mul(1.01), state.orientation)
    bad = rb.scene.scene.State(state.position, bent, state.velocity, state.angular_velocity, state.time)
    method = rb.RungeKutta4(renormalise=renormalise)
    if not renormalise:  # then the drift of the representation is what the user wants to see
        assert bool(rb.rollout(scene, bad, dt=1e-3, steps=2, method=method).status.ok)
        return
    with pytest.raises(RunFailed, match="body 1: the orientation is no rotation any more.*on_error='flag'"):
        rb.rollout(scene, bad, dt=1e-3, steps=2, method=method)
    path = rb.rollout(scene, bad, dt=1e-3, steps=2, method=method, on_error="flag")
    assert np.asarray(path.status.reason).tolist() == [0, NOT_A_ROTATION]
    assert np.asarray(path.status.first_bad_step).tolist() == [-1, 0]


def test_run_that_leaves_the_finite_numbers_says_which_body_and_step(scene, state):
    fast = scene.state(angular_velocity=[(0.0, 0.0, 0.0), (1e30, 2e30, 3e30)])
    with pytest.warns(JaxrbWarning, match="turns body 1"):
        path = rb.rollout(scene, fast, dt=0.1, steps=20, on_error="flag")
    assert np.asarray(path.status.reason).tolist() == [0, NOT_FINITE]
    step = int(path.status.first_bad_step[1])
    assert np.isfinite(np.asarray(path.states.orientation.wxyz[:step])).all()
    assert not np.isfinite(np.asarray(path.states.angular_velocity[step, 1])).all()
    with pytest.raises(RunFailed, match=f"body 1: the state is not finite.*first at step {step}"):
        path.raise_if_bad()


def test_integers_are_used_with_a_warning(scene, dtype):
    """[16]"""
    with pytest.warns(JaxrbWarning, match="int64 was given.*floating"):
        found = scene.state(position=np.asarray([1, 2, 3]))
    assert found.dtype == dtype
    assert np.asarray(found.position[1]).tolist() == [1, 2, 3]
    assert scene.state(position=(1, 2, 3)).dtype == dtype  # Python numbers are no array of integers


def test_double_precision_without_x64_is_rounded_with_a_warning(scene, dtype):
    """[17]"""
    position = np.zeros((2, 3), np.float64)
    if dtype == jnp.float64:
        assert scene.state(position=position).dtype == jnp.float64
        return
    with pytest.warns(JaxrbWarning, match="float64 were given.*float32 is used.*JAX_ENABLE_X64=1"):
        assert scene.state(position=position).dtype == jnp.float32
    with pytest.warns(JaxrbWarning, match="float64 was asked for.*JAX_ENABLE_X64=1"):
        scene.state(dtype=np.float64)


def test_state_of_another_scene_is_refused(scene, state):
    """[20]"""
    alone = rb.Scene(rb.Body(1.0, 1.0))
    with pytest.raises(WrongStructure, match=r"positions \(2, 3\) do not fit a scene of 1 bodies.*scene\.state"):
        rb.step(alone, state)
    with pytest.raises(WrongStructure, match=r"looks like a batch of worlds: use jax\.vmap"):
        rb.rollout(scene, jax.tree.map(lambda x: x[None], state), dt=1e-3, steps=1)
    with pytest.raises(WrongStructure, match="ndarray is no State"):
        rb.rollout(scene, np.zeros(3), dt=1e-3, steps=1)


MASSES = {0.0: "positive", -1.0: "positive", np.nan: "finite", np.inf: "finite"}


@pytest.mark.parametrize("mass", MASSES)
def test_bad_mass_is_refused_with_the_mend(mass):
    """[21, 22, 23]; inertias [25-29] and the range [24] are in body/test_validity.py."""
    with pytest.raises(InvalidInput, match=rf"Body\.mass is .*{mass}.* kg, but must be {MASSES[mass]}.*fix what never moves"):
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
    "steps beyond memory [41]": ({"steps": 10**10}, LimitExceeded, r"10000000001 saved states of \d+ bytes need \d+\.\d GiB.*save_every or max_bytes"),
    "steps beyond counting [41]": ({"steps": 10**10, "save_every": 10**9}, InvalidInput, "continue from path.final"),
    "method misspelt [42]": ({"method": "RungeKuta4"}, UnknownName, "did you mean RungeKutta4.*There are .*VelocityVerlet"),
    "method unheard of [42]": ({"method": "xyzzy"}, UnknownName, "'xyzzy' is not known; There are ExplicitEuler"),
    "method a class [42]": ({"method": rb.RungeKutta4}, WrongStructure, r"write RungeKutta4\(\)"),
    "method a number [42]": ({"method": 4}, WrongStructure, "4 is no method"),
    "on_error": ({"on_error": "ignore"}, WrongStructure, "'raise' or 'flag'"),
    "torque of wrong shape": ({"torque": np.zeros(4)}, WrongStructure, r"torque: shape \(4,\); give \(2, 3\) \[N m\].*\(5, 2, 3\)"),
    "torque NaN": ({"torque": (np.nan, 0, 0)}, InvalidInput, "torque: a number is not finite"),
}  # fmt: skip


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
    with pytest.warns(JaxrbWarning, match="turns body 1 by 2.00 rad a step.*a dt of 0.0005 s would resolve it"):
        rb.rollout(scene, fast, dt=1e-2, steps=1)


@pytest.mark.parametrize("effect", [rb.SpringDamper(4e6), rb.SpringDamper(1.0, damping=1e3), rb.LinearDrag(1e3)])
def test_step_beyond_stability_is_warned_of_with_the_step_that_is_not(effect):
    """[38, 48]"""
    scene = rb.Scene(rb.Body(1.0, 1.0), effect)
    with pytest.warns(JaxrbWarning, match=rf"beyond the stability of RungeKutta4 for {type(effect).__name__}.*below 0\.00"):
        rb.rollout(scene, scene.state(), dt=1e-2, steps=1)
    rb.rollout(scene, scene.state(), dt=1e-4, steps=1)


def test_every_error_is_one_of_ours_and_of_python():
    for error, builtin in ((InvalidInput, ValueError), (WrongStructure, TypeError), (UnknownName, LookupError),
                           (LimitExceeded, MemoryError), (RunFailed, ArithmeticError)):  # fmt: skip
        assert issubclass(error, JaxrbError)
        assert issubclass(error, builtin)
