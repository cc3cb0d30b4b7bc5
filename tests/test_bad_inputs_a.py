"""A. Bad states: refused, warned of or flagged, with what, which body, which value, and what to do.

The numbers in brackets are those of the project's list of bad inputs, 1 to 98, letters A to G, a file a letter.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbWarning, RunFailed, WrongStructure
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
    "NaN position [1]": (
        {"position": [GOOD[0], [0, np.nan, 1]]},
        InvalidInput,
        r"state\.position of body 1 is .*nan.* m, but must be finite",
    ),
    "infinite position [2]": (
        {"position": (0, 0, np.inf)},
        InvalidInput,
        r"state\.position is .*inf.* m.*finite",
    ),
    "NaN quaternion [3]": ({"orientation": (np.nan, 0, 0, 0)}, InvalidInput, r"state\.orientation.*nan"),
    "zero quaternion [4]": (
        {"orientation": (0, 0, 0, 0)},
        InvalidInput,
        r"state\.orientation.*norm.*by 1:.*\[0\.0, 0\.0, 0\.0, 0\.0\].*normalise",
    ),
    "long quaternion of body 1 [6]": (
        {"orientation": [[1, 0, 0, 0], [1.1, 0, 0, 0]]},
        InvalidInput,
        r"of body 1: the norm.*by 0\.1.*1\.1.*normalise",
    ),
    "skew matrix [8]": (
        {"orientation": [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]},
        InvalidInput,
        r"RᵀR differs from 1 by 0\.1.*no rotation",
    ),
    "reflection [9]": (
        {"orientation": [np.eye(3).tolist(), MIRROR]},
        InvalidInput,
        "determinant of the matrix of body 1 is negative.*reflection.*sign of one axis",
    ),
    "NaN velocity [10]": ({"velocity": (np.nan, 0, 0)}, InvalidInput, r"state\.velocity is .*nan.* m/s"),
    "NaN spin [10]": (
        {"angular_velocity": [(0, 0, 0), (0, np.nan, 0)]},
        InvalidInput,
        r"state\.angular_velocity of body 1 is .*nan.* rad/s",
    ),
    "too large for float32 [14]": (
        {"position": (1e39, 0, 0), "dtype": np.float32},
        InvalidInput,
        r"state\.position is .*1e\+39.* m, too large for float32.*float64 or larger units",
    ),
    "wrong number of bodies [15]": (
        {"position": [GOOD[0]] * 3},
        WrongStructure,
        r"state\.position: shape \(3, 3\); give \(2, 3\), or \(3,\)",
    ),
    "wrong number of components [15]": (
        {"velocity": (1.0, 2.0)},
        WrongStructure,
        r"state\.velocity: shape \(2,\)",
    ),
    "three numbers for a quaternion [15]": (
        {"orientation": (0, 0, 1)},
        WrongStructure,
        r"state\.orientation: shape \(3,\).*wxyz",
    ),
    "wrong number of orientations [15]": (
        {"orientation": [[1.0, 0, 0, 0]] * 5},
        WrongStructure,
        r"shape \(5, 4\) for 2 bodies",
    ),
    "words": ({"position": "here"}, InvalidInput, r"state\.position: 'here' is not a real number"),
    "complex numbers": ({"velocity": (1j, 0, 0)}, InvalidInput, "is not a real number"),
    "ragged rows": ({"position": [[0, 0, 0], [0, 0]]}, InvalidInput, "is not a real number"),
    "NaN time": ({"time": np.nan}, InvalidInput, r"state\.time is .*nan.* s"),
    "numbers of True and False [16]": (
        {"position": jnp.asarray([True, False, True])},
        InvalidInput,
        r"state\.position: an array of bool is none of real numbers",
    ),
    "complex array [16]": (
        {"velocity": jnp.asarray([1j, 0, 0])},
        InvalidInput,
        r"state\.velocity: an array of complex\d+ is none",
    ),
    "time too large for float32 [14]": (
        {"time": 1e39, "dtype": np.float32},
        InvalidInput,
        r"state\.time is 1e\+39 s, too large for float32",
    ),
    "a time a body": ({"time": [0.0, 1.0]}, WrongStructure, r"state\.time: shape \(2,\); give one number"),
    "half precision [16]": (
        {"dtype": np.float16},
        WrongStructure,
        "float16 is not a floating type of a run; use float32 or float64",
    ),
    "type that does not exist [16]": ({"dtype": "float99"}, WrongStructure, "'float99' is no type"),
    "integer type": ({"dtype": np.int32}, WrongStructure, "int32 is not a floating type"),
    "no representation": (
        {"rotation": "quaternion"},
        WrongStructure,
        "Quaternion, RotationMatrix or EulerAngles",
    ),
}


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
    with pytest.raises(RunFailed, match=r"body 1: the orientation is no rotation any more.*on_error='flag'"):
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


def test_orientation_that_collapses_in_the_very_last_step_is_flagged(dtype):
    """The square of its length overflows, the projection makes it zero, and no later step would turn that into NaN."""
    scene = rb.Scene(rb.Body(1.0, 1.0))
    fast = scene.state(angular_velocity=(1e150 if dtype == jnp.float64 else 1e10, 0.0, 0.0))
    with pytest.warns(JaxrbWarning, match="turns body 0"):
        path = rb.rollout(scene, fast, dt=1e20, steps=1, method=rb.ExplicitEuler(), on_error="flag")
    assert not np.asarray(path.final.orientation.wxyz).any()
    assert np.asarray(path.status.reason).tolist() == [NOT_A_ROTATION]
    assert np.asarray(path.status.first_bad_step).tolist() == [1]


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
    with pytest.raises(
        WrongStructure, match=r"positions \(2, 3\) do not fit a scene of 1 bodies.*scene\.state"
    ):
        rb.step(alone, state)
    with pytest.raises(WrongStructure, match=r"looks like a batch of worlds: use jax\.vmap"):
        rb.rollout(scene, jax.tree.map(lambda x: x[None], state), dt=1e-3, steps=1)
    with pytest.raises(WrongStructure, match="ndarray is no State"):
        rb.rollout(scene, np.zeros(3), dt=1e-3, steps=1)


def test_half_precision_is_used_as_single_with_a_warning(scene, dtype):
    """[16]"""
    with pytest.warns(JaxrbWarning, match="array of float16 was given; a run needs float32"):
        assert scene.state(position=np.zeros(3, np.float16)).dtype == jnp.float32


def test_spin_of_1e8_is_warned_of_and_what_it_does_to_the_energy_is_known(tolerance):
    """[12] Steps of 1e5 rad: nothing of the attitude is right, and the run says so in one way or another."""
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 3.0)))
    state = scene.state(angular_velocity=(1e8, 1e8, 0.0))
    with pytest.warns(JaxrbWarning, match="turns body 0 by 1.4142.*e.05 rad a step|turns body 0 by 141421"):
        path = rb.rollout(scene, state, dt=1e-3, steps=20, on_error="flag")
    assert int(path.status.reason[0]) == NOT_FINITE
    with pytest.warns(JaxrbWarning, match="turns body 0"):
        kept = rb.rollout(scene, state, dt=1e-3, steps=20, method="ThreeAxisSplitting", on_error="flag")
    energy = np.asarray(kept.diagnostics.energy, float)
    if bool(kept.status.ok):  # within the energies that the momentum allows
        assert energy.max() <= 3.1 * energy[0]
    # The closed form has all its digits.
    exact = rb.free_flight(scene, state, 1.0)
    assert float(rb.energy(scene, exact)) == pytest.approx(
        energy[0], rel=tolerance(float64=1e-12, float32=1e-5)
    )
