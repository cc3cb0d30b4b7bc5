"""How rotations change in time: the derivative maps in both frames, the exponential, the Cayley map, interpolation."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import (
    GROUPS,
    REPRESENTATIONS,
    largest,
    numbers,
    of_vectors,
    rotation_vectors,
    unit_vectors,
)

from jaxrb import EulerAngles, Quaternion, RotationMatrix, attitude_error, slerp


def unlocked(rotation) -> np.ndarray:
    """Where Euler angles are far enough from gimbal lock to have rates."""
    if not isinstance(rotation, EulerAngles):
        return np.ones(len(numbers(rotation)), bool)
    middle, proper = np.asarray(rotation.angles[:, 1]), rotation.sequence[0] == rotation.sequence[2]
    return np.abs(np.sin(middle) if proper else np.cos(middle)) > 0.1


@pytest.fixture(scope="module", params=["Quaternion", "RotationMatrix", "EulerAngles-zyx", "EulerAngles-xzx"])
def motion(request, dtype):
    """Rates of the numbers: by the maps, and by differentiating along exp curves, body turning and world turning."""
    kind, sequence = REPRESENTATIONS[request.param]
    vectors = rotation_vectors(dtype)
    omega = np.random.default_rng(2).normal(size=vectors.shape).astype(vectors.dtype)

    @jax.jit
    def rates(vectors, omega):
        start = of_vectors(kind, sequence, vectors)

        def along(turned):
            return jax.jvp(turned, (jnp.zeros((), vectors.dtype),), (jnp.ones((), vectors.dtype),))[1]

        def as_kind(rotation):
            return EulerAngles.from_rotation(rotation, sequence) if kind is EulerAngles else rotation

        # Products in a representation without gimbal lock: some sequences are locked at the identity itself.
        free = Quaternion if kind is EulerAngles else kind
        origin = free.from_rotation(start)

        return {
            "start": start,
            "body": start.derivative(omega),
            "world": start.derivative_world(omega),
            "same in world": start.derivative_world(start.rotate(omega)),
            "along body": along(lambda t: as_kind(origin @ free.exp(t * omega))),
            "along world": along(lambda t: as_kind(free.exp(t * omega) @ origin)),
        }

    return {
        name: value if name == "start" else numbers(value) for name, value in rates(vectors, omega).items()
    }


@pytest.mark.parametrize("frame", ["body", "world"])
def test_derivative_is_the_rate_along_the_exponential(motion, frame, tolerance):
    """q̇ = ½ q [0, ω_B] = ½ [0, ω_W] q and Ṙ = R ω_B* = ω_W* R, against automatic differentiation of R exp(ω t)."""
    far = unlocked(motion["start"])
    assert far.sum() > 60
    along, rate = np.asarray(motion[f"along {frame}"]), np.asarray(motion[frame])
    if isinstance(
        motion["start"], Quaternion
    ):  # of exp(ω t) the sign is free, of the product it is the start's
        assert largest(along - rate) < tolerance(float64=2e-15, float32=1e-6)
    assert largest((along - rate)[far]) < tolerance(float64=1e-12, float32=2e-4)


def test_body_and_world_form_of_the_derivative_agree(motion, tolerance):
    far = unlocked(motion["start"])
    assert largest((motion["body"] - motion["same in world"])[far]) < tolerance(float64=1e-13, float32=2e-4)


@pytest.mark.parametrize("kind", GROUPS)
def test_exponential_solves_the_kinematic_equation(kind, dtype, tolerance):
    """d/dt exp(ω t) = derivative of exp(ω t) at ω, at every t, also through t = 0 and half a turn."""
    omega = unit_vectors(5).astype(dtype)
    times = np.asarray([0.0, 1e-9, 0.3, 0.9999, 1.0001, 2.0, np.pi, 5.0], dtype)

    @jax.jit
    @jax.vmap
    def both(t):
        value, rate = jax.jvp(lambda t: kind.exp(t * omega), (t,), (jnp.ones_like(t),))
        return numbers(rate), numbers(value.derivative(omega))

    rate, expected = both(times)
    assert largest(rate - expected) < tolerance(float64=2e-15, float32=1e-6)


@pytest.mark.parametrize("kind", GROUPS)
def test_cayley_solves_the_implicit_midpoint_rule_exactly(kind, dtype, tolerance):
    """y₁ − y₀ = f((y₀ + y₁)/2) for the representation's own equation, for steps of any size."""
    vectors = rotation_vectors(dtype)

    @jax.jit
    def residual(vectors):
        start = jax.tree.map(lambda x: x[::-1], kind.exp(vectors))
        end = start @ kind.cayley(vectors)
        middle = jax.tree.map(lambda a, b: 0.5 * (a + b), start, end)
        return numbers(end) - numbers(start) - numbers(middle.derivative(vectors)), end.drift()

    error, drift = residual(vectors)
    assert largest(error) < tolerance(float64=2e-15, float32=1e-6)
    assert largest(drift) < tolerance(float64=2e-15, float32=1e-6)


@pytest.mark.parametrize("kind", GROUPS)
def test_cayley_agrees_with_the_exponential_to_third_order(kind, dtype, tolerance):
    """Halving the angle divides the difference by eight; the axis is the same."""
    size = tolerance(float64=1e-2, float32=0.3)
    v = (size * unit_vectors(10)).astype(dtype)
    errors = [np.linalg.norm(kind.cayley(v * f).log() - v * f, axis=-1) for f in (1, 0.5)]
    assert np.abs(errors[0] / errors[1] - 8.0).max() < tolerance(float64=1e-3, float32=0.2)
    assert largest(np.cross(kind.cayley(v).log(), v)) < tolerance(float64=1e-16, float32=1e-7)


@pytest.fixture(scope="module", params=GROUPS)
def interpolation(request, dtype):
    """`slerp` compiled, with start and end rotations that include equal and nearly opposite ones."""
    kind = request.param
    start = kind.exp(rotation_vectors(dtype))
    end = start @ jax.tree.map(lambda x: jnp.roll(x, 11, axis=0), start)
    return kind, start, end, jax.jit(lambda a, b, f: slerp(a, b, jnp.broadcast_to(f, numbers(a).shape[:1])))


def test_slerp_begins_and_ends_at_its_ends(interpolation, tolerance):
    _, start, end, between = interpolation
    small = tolerance(float64=3e-15, float32=2e-6)
    assert largest(numbers(between(start, end, 0.0)) - numbers(start)) < small
    assert largest(between(start, end, 1.0).as_matrix() - end.as_matrix()) < small


def test_slerp_passes_the_midpoint_at_half_the_angle(interpolation, tolerance):
    _, start, end, between = interpolation
    small = tolerance(float64=1e-14, float32=3e-6)
    middle = between(start, end, 0.5)
    whole = start.angle_to(end)
    assert largest(start.angle_to(middle) - 0.5 * whole) < small
    assert largest(middle.angle_to(end) - 0.5 * whole) < small


def test_slerp_turns_at_a_constant_rate(interpolation, tolerance):
    _, start, end, between = interpolation
    fractions = np.linspace(0, 1, 9)
    points = [between(start, end, f) for f in fractions]
    steps = np.stack([(a.inverse() @ b).log() for a, b in itertools.pairwise(points)])
    assert largest(steps - steps[:1]) < tolerance(float64=1e-14, float32=3e-6)


def test_slerp_between_equal_ends_stays(interpolation, tolerance):
    _, start, _, between = interpolation
    small = tolerance(float64=2e-15, float32=1e-6)
    assert largest(numbers(between(start, start, 0.3)) - numbers(start)) < small


def test_slerp_takes_the_short_way_between_antipodal_quaternions(dtype, tolerance):
    small = tolerance(float64=2e-15, float32=1e-6)
    a, b = Quaternion.exp(np.asarray([0.3, 0, 0], dtype)), Quaternion.exp(np.asarray([0.5, 0, 0], dtype))
    middle = slerp(a, Quaternion(-b.wxyz), 0.5)
    assert float(attitude_error(middle.wxyz, Quaternion.exp(np.asarray([0.4, 0, 0], dtype)).wxyz)) < small
    assert float(attitude_error(slerp(a, Quaternion(-a.wxyz), 0.7).wxyz, a.wxyz)) < small


@pytest.mark.parametrize("kind", [Quaternion, RotationMatrix, EulerAngles])
def test_angle_and_axis_come_back(kind, dtype, tolerance):
    axes, angles = unit_vectors(40), np.linspace(0.0, np.pi, 40)
    rotation = kind.from_axis_angle((3.7 * axes).astype(dtype), angles.astype(dtype))
    axis, angle = rotation.as_axis_angle()
    assert largest(angle - angles) < tolerance(float64=4e-15, float32=2e-6)
    assert largest((axis - axes)[4:-1]) < tolerance(float64=1e-13, float32=3e-5)
    assert largest(np.abs(axis[-1]) - np.abs(axes[-1])) < tolerance(float64=1e-14, float32=1e-5)


def test_identity_has_angle_zero_about_z(dtype):
    axis, angle = Quaternion.identity(dtype).as_axis_angle()
    assert np.asarray(axis).tolist() == [0, 0, 1]
    assert float(angle) == 0


@pytest.mark.parametrize("length", [1e-30, 1e-12, 1.0, 1e12, 1e30])
def test_length_of_the_axis_does_not_matter(dtype, tolerance, length):
    """Its square leaves the range of float32 at both ends."""
    axis = np.asarray([0.6, 0.0, 0.8])
    rotation = Quaternion.from_axis_angle((length * axis).astype(dtype), np.asarray(0.7, dtype))
    assert largest(rotation.log() - 0.7 * axis) < tolerance(float64=2e-16, float32=3e-7)


def test_angle_between_rotations_resolves_the_smallest_angles(dtype, tolerance):
    """arccos of the scalar product would give 0, or NaN, below √eps."""
    a = Quaternion.exp(np.asarray([0.3, -0.2, 0.9], dtype))
    for angle in (0.0, 1e-15, 1e-9, 1e-5, 1.0, np.pi):
        b = a @ Quaternion.exp(np.asarray([0, angle, 0], dtype))
        small = tolerance(float64=3e-16, float32=2e-7)
        assert abs(float(a.angle_to(b)) - angle) < 2 * small
        assert abs(float(b.angle_to(RotationMatrix.from_rotation(a))) - angle) < 4 * small
        if angle < 1e-4:
            assert abs(float(attitude_error(a.wxyz, b.wxyz)) - angle) < small
