"""Gravity, drag, thrust, torque and a user's own force against their closed forms.

One run serves most tests: seven balls side by side, each under an effect of its own, chosen by `bodies`. What one test
says of its ball therefore also says that no other ball's effect reaches it.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import largest

import jaxrb as rb

FREE, FALLING, SLOWED, SINKING, BRAKED, PUSHED, TURNED = range(7)
MASS, INERTIA = 2.0, 0.5
C, C_ROT = 1.2, 0.3
AREA, DRAG = 0.5, 0.8
G = 9.80665
TIMES = np.asarray([0.0, 0.5, 1.0])
TORQUES = np.asarray([[0.0, 0.0, 0.0], [0.0, 0.0, 0.6], [0.0, 0.0, 0.2]])
START_V, START_W = np.asarray([1.0, -2.0, 2.0]), np.asarray([0.3, 0.4, -1.2])


@pytest.fixture(scope="module")
def run():
    """Two seconds of all seven, saved every 0.1 s."""
    effects = (
        rb.UniformGravity(bodies=(FALLING, SINKING)),
        rb.LinearDrag([C, 40.0], angular_coefficient=C_ROT, bodies=(SLOWED, SINKING)),
        rb.QuadraticDrag(DRAG, AREA, density=1.1, bodies=(BRAKED,)),
        rb.BodyThruster((0.0, 0.0, 3.0), point=(0.2, 0.0, 0.0), bodies=(PUSHED,)),
        rb.PrescribedTorque(TORQUES, times=TIMES, bodies=(TURNED,)),
    )
    scene = rb.Scene(rb.replicate(rb.Body(MASS, INERTIA), 7), effects)
    velocity, omega = np.tile(START_V, (7, 1)), np.tile(START_W, (7, 1))
    velocity[SINKING], omega[[PUSHED, TURNED]] = 0, 0
    state = scene.state(velocity=velocity.tolist(), angular_velocity=omega.tolist())
    return rb.rollout(scene, state, dt=0.01, steps=200, save_every=10)


def of(run, body) -> tuple:
    """times, position, velocity, angular velocity of a ball, in float64."""
    s = run.states
    parts = (run.times, s.position[:, body], s.velocity[:, body], s.angular_velocity[:, body])
    return tuple(np.asarray(part, np.float64) for part in parts)


def test_ball_without_an_effect_moves_straight_and_spins_evenly(run, tolerance):
    t, p, v, w = of(run, FREE)
    small = tolerance(float64=1e-13, float32=2e-5)
    assert largest(p - t[:, None] * START_V) < small
    assert largest(v - START_V) == largest(w - np.float32(START_W) if small > 1e-6 else w - START_W) == 0


def test_falling_body_follows_the_parabola(run, tolerance):
    t, p, v, _ = of(run, FALLING)
    small = tolerance(float64=1e-12, float32=1e-4)
    g = np.asarray([0, 0, -G])
    assert largest(p - (t[:, None] * START_V + 0.5 * t[:, None] ** 2 * g)) < small
    assert largest(v - (START_V + t[:, None] * g)) < small


def test_linear_drag_slows_exponentially(run, tolerance):
    t, p, v, w = of(run, SLOWED)
    small = tolerance(float64=1e-10, float32=1e-5)
    decay = np.exp(-C / MASS * t)[:, None]
    assert largest(v - START_V * decay) < small
    assert largest(p - START_V * MASS / C * (1 - decay)) < small
    assert largest(w - START_W * np.exp(-C_ROT / INERTIA * t)[:, None]) < small


def test_sinking_body_reaches_the_terminal_velocity(run, tolerance):
    """m g = c v; the way there is exponential too."""
    t, _, v, _ = of(run, SINKING)
    terminal = MASS * G / 40.0
    expected = -terminal * (1 - np.exp(-40.0 / MASS * t))
    assert largest(v[:, 2] - expected) < tolerance(float64=1e-5, float32=1e-5)
    assert v[-1, 2] == pytest.approx(-terminal, rel=tolerance(float64=1e-12, float32=1e-6))


def test_quadratic_drag_slows_hyperbolically_along_its_line(run, tolerance):
    """v(t) = v₀/(1 + k v₀ t), k = ½ρCA/m."""
    t, p, v, _ = of(run, BRAKED)
    k, v0 = 0.5 * 1.1 * DRAG * AREA / MASS, np.linalg.norm(START_V)
    small = tolerance(float64=1e-10, float32=1e-5)
    assert largest(v - START_V / (1 + k * v0 * t)[:, None]) < small
    assert largest(p - START_V / v0 * (np.log1p(k * v0 * t) / k)[:, None]) < small


def test_thruster_turns_with_its_body(run, tolerance):
    """The torque r × F is constant in the body; the force turns with it: its x and z parts are Fresnel integrals."""
    t, _, v, w = of(run, PUSHED)
    rate = -0.2 * 3.0 / INERTIA  # about y
    assert largest(w - t[:, None] * np.asarray([0, rate, 0])) < tolerance(float64=1e-12, float32=1e-5)
    fine = np.linspace(0, t[-1], 20_001)
    angle = 0.5 * rate * fine**2
    push = np.stack([np.sin(angle), 0 * fine, np.cos(angle)], -1) * 3.0 / MASS
    gained = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(0.5 * (push[1:] + push[:-1]) * np.diff(fine)[:, None], 0)]
    )
    assert largest(v - START_V - gained[::1000]) < tolerance(float64=1e-7, float32=1e-5)


def test_torque_course_is_interpolated_and_constant_beyond_its_ends(run, tolerance):
    """The spin is the integral of the trapezia, then grows evenly."""
    t, _, _, w = of(run, TURNED)
    fine = np.linspace(0, t[-1], 20_001)
    torque = np.interp(fine, TIMES, TORQUES[:, 2])
    spin = np.concatenate([[0], np.cumsum(0.5 * (torque[1:] + torque[:-1]) * np.diff(fine))]) / INERTIA
    assert largest(w[:, 2] - spin[::1000]) < tolerance(float64=1e-9, float32=1e-5)
    assert largest(w[:, :2]) == 0


def test_constant_torque_spins_up_evenly_and_equals_the_applied_one(dtype, tolerance):
    """ω = τ t/I about a principal axis; `torque=` of the run and the effect are the same."""
    body = rb.Body(1.0, (1.0, 2.0, 2.5))
    torque = (0.0, 0.3, 0.0)
    scene, bare = rb.Scene(body, rb.PrescribedTorque(torque)), rb.Scene(body)
    final = rb.rollout(scene, scene.state(), dt=0.01, steps=100).final
    assert largest(final.angular_velocity - np.asarray([[0, 0.15, 0]])) < tolerance(
        float64=1e-14, float32=1e-6
    )
    applied = rb.rollout(bare, bare.state(), dt=0.01, steps=100, torque=np.asarray(torque, dtype)).final
    assert largest(final.orientation.wxyz - applied.orientation.wxyz) == 0
    turned = np.asarray([np.cos(0.0375), 0, np.sin(0.0375), 0])  # half of ½ (τ/I) t²
    assert largest(final.orientation.wxyz[0] - turned) < tolerance(float64=1e-9, float32=1e-6)


def test_energy_is_conserved_in_free_fall_and_spent_in_drag(run, tolerance):
    """What drag takes is ∫ c v² + c_r ω² dt; what gravity gives is potential energy."""
    scene = rb.Scene(rb.Body(MASS, INERTIA), rb.UniformGravity())
    fall = rb.rollout(scene, scene.state(velocity=(1, 2, 3)), dt=0.01, steps=100).diagnostics.energy
    assert largest(fall - np.asarray(fall)[0]) < tolerance(float64=1e-12, float32=1e-4)
    t, _, v, w = of(run, SLOWED)
    energy = 0.5 * MASS * np.sum(v**2, -1) + 0.5 * INERTIA * np.sum(w**2, -1)
    power = C * np.sum(v**2, -1) + C_ROT * np.sum(w**2, -1)
    spent = np.sum((power[:-2:2] + 4 * power[1:-1:2] + power[2::2]) / 3 * (t[1] - t[0]))  # Simpson's rule
    assert energy[0] - energy[-1] == pytest.approx(spent, rel=1e-5)
    assert (np.diff(energy) < 0).all()


def test_potential_energy_counts_only_the_bodies_acted_on():
    bodies = rb.replicate(rb.Body(2.0, 1.0), 3)
    scene = rb.Scene(bodies, rb.UniformGravity((0, 0, -10.0), bodies=(0, 2)))
    state = scene.state(position=[(0.0, 0, 1), (0.0, 0, 50), (0.0, 0, 3)])
    assert float(rb.energy(scene, state)) == pytest.approx(2.0 * 10.0 * 4.0)


def test_coefficients_of_each_body_act_on_that_body(tolerance):
    """A leading axis over the bodies, also of vectors, equals one scene for each."""
    drags, pulls = [0.1, 0.7], [(0.0, 0.0, -1.0), (2.0, 0.0, 0.0)]
    body = rb.Body(1.0, 1.0)
    both = rb.Scene(rb.replicate(body, 2), (rb.LinearDrag(drags), rb.UniformGravity(pulls)))
    together = rb.rollout(both, both.state(velocity=(1, 1, 1)), dt=0.05, steps=20).final
    for i in range(2):
        one = rb.Scene(body, (rb.LinearDrag(drags[i]), rb.UniformGravity(pulls[i])))
        alone = rb.rollout(one, one.state(velocity=(1, 1, 1)), dt=0.05, steps=20).final
        assert largest(together.velocity[i] - alone.velocity[0]) < tolerance(float64=1e-15, float32=3e-7)


def _pull(body, state, parameters):
    """Gravity and Stokes drag in the user's words."""
    return rb.Wrench(
        body.mass * parameters["g"] - parameters["c"] * state.velocity, -0.2 * state.angular_velocity
    )


def _height(body, state, parameters):
    return -body.mass * jnp.dot(parameters["g"], state.position)


def test_custom_force_equals_the_built_in_ones(dtype, tolerance):
    small = tolerance(float64=1e-14, float32=2e-6)
    parameters = {"g": jnp.asarray([0.0, 1.0, -9.0], dtype), "c": jnp.asarray(0.4, dtype)}
    bodies = rb.Body(1.5, (1.0, 2.0, 2.5))
    own = rb.Scene(bodies, rb.CustomForce(_pull, parameters, potential=_height))
    built_in = rb.Scene(
        bodies, (rb.UniformGravity((0.0, 1.0, -9.0)), rb.LinearDrag(0.4, angular_coefficient=0.2))
    )
    state = own.state((0, 1, 2), velocity=(1, 2, 3), angular_velocity=(0.3, -1.0, 2.0))
    one, other = (rb.rollout(scene, state, dt=0.01, steps=50).final for scene in (own, built_in))
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert largest(a - b) < small
    assert float(rb.energy(own, one)) == pytest.approx(float(rb.energy(built_in, other)), rel=small)


def _swing(body, state, parameters):
    return rb.Wrench(
        torque=jnp.stack([jnp.zeros_like(state.time), jnp.zeros_like(state.time), jnp.cos(state.time)])
    )


def test_custom_force_sees_the_time(tolerance):
    """ω = sin t: RK4 asks at the right times."""
    scene = rb.Scene(rb.Body(1.0, 1.0), rb.CustomForce(_swing))
    final = rb.rollout(scene, scene.state(time=0.5), dt=0.02, steps=50).final
    expected = np.sin(1.5) - np.sin(0.5)
    assert float(final.angular_velocity[0, 2]) == pytest.approx(
        expected, abs=tolerance(float64=1e-9, float32=1e-6)
    )


def test_order_of_effects_does_not_matter(tolerance):
    effects = (rb.UniformGravity(), rb.LinearDrag(0.3), rb.BodyThruster((1, 0, 0), point=(0, 0.1, 0)))
    body = rb.Body(1.0, (1.0, 2.0, 2.5))
    finals = []
    for order in (effects, effects[::-1]):
        scene = rb.Scene(body, order)
        finals.append(rb.rollout(scene, scene.state(angular_velocity=(1, 2, 3)), dt=0.01, steps=20).final)
    assert largest(finals[0].position - finals[1].position) < tolerance(float64=1e-15, float32=1e-6)
    assert largest(finals[0].orientation.wxyz - finals[1].orientation.wxyz) < tolerance(
        float64=1e-15, float32=1e-6
    )
