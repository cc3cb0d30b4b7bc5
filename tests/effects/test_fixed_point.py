"""Bodies held at a point: pendulums, tops, and free bodies beside them."""

import numpy as np
import pytest
from rotation_samples import largest

import jaxrb as rb

G, MASS, ARM = 9.80665, 2.0, 0.3
MOMENTS = (0.05, 0.04, 0.03)
ABOUT_PIVOT = MOMENTS[1] + MASS * ARM**2


def pendulum(*more, **options) -> rb.Scene:
    """A body that hangs from its point (0, 0, 0.3) at the world's origin; it swings about y."""
    return rb.Scene(
        rb.Body(MASS, MOMENTS), (rb.UniformGravity(), rb.FixedPoint((0, 0, ARM), **options), *more)
    )


def tilted(angle: float) -> rb.Quaternion:
    return rb.Quaternion.from_axis_angle((0.0, 1.0, 0.0), angle)


def angles(path) -> np.ndarray:
    """Angle of the swing about y, in float64."""
    wxyz = np.asarray(path.states.orientation.wxyz[:, 0], np.float64)
    return 2 * np.arctan2(wxyz[:, 2], wxyz[:, 0])


def test_physical_pendulum_has_the_period_of_its_moment_about_the_pivot(tolerance):
    """θ = θ₀ cos ωt, ω² = m g d/I_O with Steiner's I_O, for a small angle."""
    scene, start = pendulum(), 1e-3
    path = rb.rollout(scene, scene.state(orientation=tilted(start)), dt=0.005, steps=400)
    omega = np.sqrt(MASS * G * ARM / ABOUT_PIVOT)
    expected = start * np.cos(omega * np.asarray(path.times, np.float64))
    assert largest(angles(path) - expected) / start < tolerance(float64=1e-5, float32=2e-3)


def test_large_swing_has_the_speed_that_its_height_gives(tolerance):
    """½ I_O ω² = m g d (cos θ − cos θ₀): energy, without the scene's own formula for it."""
    scene, start = pendulum(), 2.5
    path = rb.rollout(scene, scene.state(orientation=tilted(start)), dt=0.002, steps=600)
    theta, omega = angles(path), np.asarray(path.states.angular_velocity[:, 0, 1], np.float64)
    gained = MASS * G * ARM * (np.cos(theta) - np.cos(start))
    assert largest(0.5 * ABOUT_PIVOT * omega**2 - gained) < tolerance(float64=1e-8, float32=2e-4)
    assert theta.min() < -2.0


@pytest.fixture(scope="module")
def top():
    """A tumbling asymmetric top, held off its centre at an anchor away from the origin."""
    scene = pendulum(anchor=(1.0, -2.0, 0.5))
    state = scene.state(orientation=tilted(1.0), angular_velocity=(2.0, -3.0, 10.0))
    return rb.rollout(scene, state, dt=0.001, steps=1000, save_every=50)


def test_energy_of_a_held_body_is_conserved(top, tolerance):
    energy = np.asarray(top.diagnostics.energy)
    assert largest(energy - energy[0]) < tolerance(float64=1e-9, float32=2e-4)


def test_held_point_stays_at_its_anchor(top, tolerance):
    """Position and velocity follow from the attitude: the constraint cannot drift."""
    point = np.broadcast_to(np.asarray([0, 0, ARM], np.float32), top.states.position.shape)
    small = tolerance(float64=1e-7, float32=1e-5)  # the point is given in single precision
    assert largest(top.states.point_position(point) - np.asarray([1.0, -2.0, 0.5])) < small
    assert largest(top.states.point_velocity(point)) < 10 * small


def test_angular_momentum_about_the_vertical_through_the_anchor_is_conserved(top, tolerance):
    """Gravity has no torque about it; the scene's own sum is about the world's origin."""
    kept, final = top.diagnostics, top.states
    anchor = np.asarray([1.0, -2.0, 0.5])
    about_anchor = np.asarray(kept.angular_momentum) - np.cross(
        anchor, MASS * np.asarray(final.velocity[:, 0])
    )
    assert largest(about_anchor[:, 2] - about_anchor[0, 2]) < tolerance(float64=1e-9, float32=2e-5)


def test_held_and_free_bodies_move_as_if_alone(tolerance):
    """Gravity and drag on all; only the middle one is held."""
    body = rb.Body(MASS, MOMENTS)
    common = (rb.UniformGravity(), rb.LinearDrag(0.3, angular_coefficient=0.01))
    hold = {"point": (0, 0, ARM), "anchor": (0, 1, 0)}
    mixed = rb.Scene(rb.replicate(body, 3), (*common, rb.FixedPoint(**hold, bodies=(1,))))
    held, free = rb.Scene(body, (rb.FixedPoint(**hold), *common)), rb.Scene(body, common)
    motion = {"orientation": tilted(0.7), "angular_velocity": (1.0, 0.2, -0.5)}
    path = rb.rollout(mixed, mixed.state(**motion), dt=0.01, steps=50)
    small = tolerance(float64=1e-14, float32=5e-6)
    for i, scene in enumerate((free, held, free)):
        alone = rb.rollout(scene, scene.state(**motion), dt=0.01, steps=50)
        for name in ("position", "velocity", "angular_velocity"):
            difference = getattr(path.final, name)[i] - getattr(alone.final, name)[0]
            assert largest(difference) < small, (i, name)
        assert largest(path.final.orientation.wxyz[i] - alone.final.orientation.wxyz[0]) < small


def test_body_held_at_its_centre_turns_as_a_free_one(tolerance):
    body = rb.Body(MASS, MOMENTS)
    held, free = rb.Scene(body, (rb.UniformGravity(), rb.FixedPoint((0.0, 0.0, 0.0)))), rb.Scene(body)
    finals = [
        rb.rollout(scene, scene.state(angular_velocity=(1, 2, 3)), dt=0.005, steps=100).final
        for scene in (held, free)
    ]
    small = tolerance(float64=1e-13, float32=3e-6)
    assert largest(finals[0].orientation.wxyz - finals[1].orientation.wxyz) < small
    assert largest(finals[0].position) == 0


def test_force_on_a_held_body_acts_by_its_torque_about_the_point(tolerance):
    """A push at the centre of a resting pendulum without gravity: ω̇ = d F/I_O."""
    scene = rb.Scene(rb.Body(MASS, MOMENTS), (rb.BodyThruster((0.5, 0.0, 0.0)), rb.FixedPoint((0, 0, ARM))))
    final = rb.rollout(scene, scene.state(), dt=0.001, steps=100).final
    expected = -ARM * 0.5 / ABOUT_PIVOT * 0.1
    assert float(final.angular_velocity[0, 1]) == pytest.approx(
        expected, rel=tolerance(float64=1e-12, float32=1e-5)
    )


def test_state_of_a_held_body_places_its_centre():
    scene = pendulum(anchor=(0.0, 0.0, 2.0))
    state = scene.state(angular_velocity=(0.0, 1.0, 0.0))
    assert np.asarray(state.position[0]) == pytest.approx([0, 0, 2.0 - ARM])
    assert np.asarray(state.velocity[0]) == pytest.approx([-ARM, 0, 0])
