"""The twelve sequences of Euler and Cardan angles: against SciPy, at their limits, and where they lock."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import largest, rotation_vectors, unit_vectors
from scipy.spatial.transform import Rotation as Scipy

from jaxrb import EulerAngles, Quaternion
from jaxrb.errors import WrongStructure
from jaxrb.math.euler_angles import SEQUENCES


def lock_angles(sequence: str) -> tuple[float, float]:
    """The middle angles at which the first and third axis align."""
    return (0.0, np.pi) if sequence[0] == sequence[2] else (np.pi / 2, -np.pi / 2)


@pytest.fixture(scope="module")
def converted(dtype):
    """Angles (k, 3) in each sequence of the sampled rotations."""
    q = Quaternion.exp(rotation_vectors(dtype))
    return jax.jit(lambda q: {s: EulerAngles.from_rotation(q, s).angles for s in SEQUENCES})(q)


def test_there_are_twelve_sequences():
    assert len(set(SEQUENCES)) == 12


def test_default_is_yaw_pitch_roll(dtype, tolerance):
    """R = R_z(α) R_y(β) R_x(γ) about moving axes."""
    angles = np.asarray([0.4, -0.3, 1.1], dtype)
    expected = Scipy.from_euler("ZYX", angles).as_matrix()
    assert largest(EulerAngles(angles).as_matrix() - expected) < tolerance(float64=1e-15, float32=3e-7)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_angles_give_the_matrix_of_scipy(dtype, tolerance, converted, sequence):
    angles = np.concatenate([converted[sequence], np.random.default_rng(0).uniform(-7, 7, (40, 3))]).astype(
        dtype
    )
    expected = Scipy.from_euler(sequence.upper(), angles.astype(np.float64)).as_matrix()
    found = jax.jit(lambda a: EulerAngles(a, sequence).as_matrix())(angles)
    assert largest(found - expected) < tolerance(float64=3e-15, float32=2e-6)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_converted_angles_lie_in_their_ranges(converted, sequence):
    outer, middle, inner = np.asarray(converted[sequence], np.float64).T
    half_turn = np.pi + 1e-6
    assert np.abs(outer).max() <= half_turn
    assert np.abs(inner).max() <= half_turn
    low, high = (0, np.pi) if sequence[0] == sequence[2] else (-np.pi / 2, np.pi / 2)
    assert low - 1e-6 <= middle.min()
    assert middle.max() <= high + 1e-6


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_angles_come_back_from_the_rotation(dtype, tolerance, sequence):
    low, high = (0.05, 3.09) if sequence[0] == sequence[2] else (-1.52, 1.52)
    draw = np.random.default_rng(1)
    outer = draw.uniform(-3.1, 3.1, (100, 2))
    angles = np.stack([outer[:, 0], draw.uniform(low, high, 100), outer[:, 1]], -1).astype(dtype)
    back = jax.jit(lambda a: EulerAngles.from_rotation(EulerAngles(a, sequence), sequence).angles)(angles)
    assert largest(back - angles) < tolerance(float64=2e-14, float32=1e-5)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_gimbal_lock_keeps_the_rotation_and_sets_the_third_angle_to_zero(dtype, tolerance, sequence):
    small = tolerance(float64=3e-15, float32=2e-6)
    outer = np.random.default_rng(2).uniform(-3, 3, (20, 2))
    found = jax.jit(lambda a: EulerAngles.from_rotation(EulerAngles(a, sequence), sequence))
    for beta in lock_angles(sequence):
        angles = np.stack([outer[:, 0], np.full(20, beta), outer[:, 1]], -1).astype(dtype)
        back = found(angles)
        assert largest(back.as_matrix() - EulerAngles(angles, sequence).as_matrix()) < small
        assert largest(back.angles[:, 2]) == 0


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_rates_at_gimbal_lock_are_finite_and_drop_only_the_component_that_no_rate_can_produce(
    dtype, tolerance, sequence
):
    """The locked axes a, b span a plane: the rates give ω back but for its component along a × b."""
    small = tolerance(float64=1e-14, float32=1e-5)
    omega = unit_vectors(10, seed=4).astype(dtype)
    for beta in lock_angles(sequence):
        angles = np.asarray([0.3, beta, -0.8], dtype)
        rotation = EulerAngles(jnp.broadcast_to(angles, (10, 3)), sequence)
        rates = np.asarray(rotation.derivative(omega).angles, np.float64)
        axes = np.stack([np.asarray(x, np.float64) for x in rotation.axes()], -1)
        produced = np.einsum("kij,kj->ki", axes, rates)
        lost = np.cross(axes[..., 0], axes[..., 1])
        expected = omega - np.sum(omega * lost, -1, keepdims=True) * lost
        assert np.isfinite(rates).all()
        assert largest(produced - expected) < small


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_rates_give_back_the_angular_velocity_away_from_lock(dtype, tolerance, sequence):
    draw = np.random.default_rng(3)
    middle = 1.2 if sequence[0] == sequence[2] else 0.7
    angles = np.stack([draw.uniform(-3, 3, 30), np.full(30, middle), draw.uniform(-3, 3, 30)], -1).astype(
        dtype
    )
    omega = draw.normal(size=(30, 3)).astype(dtype)
    rotation = EulerAngles(angles, sequence)
    rates = rotation.derivative(omega).angles
    produced = sum(axis * rates[:, i : i + 1] for i, axis in enumerate(rotation.axes()))
    assert largest(produced - omega) < tolerance(float64=1e-14, float32=1e-5)


def test_unknown_sequence_is_refused_and_the_twelve_are_named():
    with pytest.raises(WrongStructure, match="xyx"):
        EulerAngles(jnp.zeros(3), "xxz")


def test_any_angles_are_a_rotation(dtype):
    angles = EulerAngles(np.asarray([10.0, -20.0, 30.0], dtype))
    drift = angles.drift()
    assert float(drift.scale) == float(drift.skew) == 0
    assert largest(angles.normalise().angles - angles.angles) == 0
