"""Springs and dampers: periods, what they conserve, what they spend."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import largest

import jaxrb as rb

K = 30.0


def test_spring_to_the_world_oscillates_with_its_period(tolerance):
    """x = x₀ cos √(k/m) t for zero rest length: in all three directions at once, about the anchor."""
    scene = rb.Scene(rb.Body(2.0, 1.0), rb.SpringDamper(K, point_b=(1.0, 2.0, 3.0)))
    start = np.asarray([0.3, -0.2, 0.5])
    path = rb.rollout(
        scene, scene.state(position=np.add([1.0, 2.0, 3.0], start).tolist()), dt=0.005, steps=400
    )
    expected = np.cos(np.sqrt(K / 2.0) * np.asarray(path.times, np.float64))[:, None] * start
    error = largest(path.states.position[:, 0] - np.asarray([1.0, 2.0, 3.0]) - expected)
    assert error < tolerance(float64=1e-8, float32=1e-5)
    assert largest(path.diagnostics.energy - path.diagnostics.energy[0]) < tolerance(
        float64=1e-8, float32=1e-4
    )


def test_damped_spring_with_rest_length_follows_its_closed_form(tolerance):
    """Along its line: l − l₀ = A e^(−γt) (cos ω't + γ/ω' sin ω't), γ = d/2m, ω'² = k/m − γ²."""
    damping, rest, mass = 1.5, 0.4, 2.0
    scene = rb.Scene(rb.Body(mass, 1.0), rb.SpringDamper(K, damping=damping, rest_length=rest))
    path = rb.rollout(scene, scene.state(position=(0, 0, rest + 0.1)), dt=0.005, steps=400)
    t = np.asarray(path.times, np.float64)
    gamma = damping / (2 * mass)
    omega = np.sqrt(K / mass - gamma**2)
    stretch = 0.1 * np.exp(-gamma * t) * (np.cos(omega * t) + gamma / omega * np.sin(omega * t))
    assert largest(path.states.position[:, 0, 2] - rest - stretch) < tolerance(float64=1e-8, float32=1e-6)
    assert largest(path.states.position[:, 0, :2]) == 0


@pytest.fixture(scope="module")
def pair():
    """Two unequal bodies joined by a spring between points off their centres, tumbling; with and without damping."""
    bodies = (rb.Body(1.0, (0.1, 0.2, 0.25)), rb.Body(3.0, 0.4))
    ends = {"rest_length": 0.5, "point_a": (0.1, 0.0, 0.2), "point_b": (0.0, -0.2, 0.0), "body_b": 1}
    paths = []
    for damping in (0.0, 4.0):
        scene = rb.Scene(bodies, rb.SpringDamper(K, damping=damping, **ends))
        state = scene.state(
            [(0.0, 0, 0), (1.0, 0.5, 0)],
            velocity=[(0.5, 1, 0), (0, 0, -0.2)],
            angular_velocity=(1.0, -2.0, 0.5),
        )
        paths.append(rb.rollout(scene, state, dt=0.005, steps=400, save_every=20))
    return paths


@pytest.mark.parametrize("damped", [0, 1])
def test_spring_between_bodies_conserves_momentum_and_angular_momentum(pair, damped, tolerance):
    """Action and reaction along one line, damped or not."""
    kept = pair[damped].diagnostics
    assert largest(kept.momentum - kept.momentum[0]) < tolerance(float64=1e-13, float32=1e-5)
    assert largest(kept.angular_momentum - kept.angular_momentum[0]) < tolerance(float64=1e-7, float32=2e-5)


def test_spring_between_bodies_conserves_energy_and_a_damper_spends_it(pair, tolerance):
    free, damped = (np.asarray(path.diagnostics.energy, np.float64) for path in pair)
    assert largest(free - free[0]) < tolerance(float64=1e-6, float32=1e-5)
    assert free[0] == pytest.approx(damped[0])
    assert (np.diff(damped) <= 0).all()
    assert damped[-1] < 0.95 * damped[0]


def test_two_bodies_on_a_spring_oscillate_with_the_reduced_mass(tolerance):
    """ω² = k (1/m₁ + 1/m₂)."""
    scene = rb.Scene((rb.Body(1.0, 1.0), rb.Body(3.0, 1.0)), rb.SpringDamper(K, rest_length=1.0, body_b=1))
    path = rb.rollout(scene, scene.state([(0.0, 0, 0), (1.2, 0, 0)]), dt=0.005, steps=200)
    length = path.states.position[:, 1, 0] - path.states.position[:, 0, 0]
    omega = np.sqrt(K * (1 + 1 / 3))
    expected = 1.0 + 0.2 * np.cos(omega * np.asarray(path.times, np.float64))
    assert largest(length - expected) < tolerance(float64=1e-8, float32=2e-6)


def test_springs_in_one_effect_equal_springs_in_many(tolerance):
    """Bodies in a chain: a body may be at several ends, and the forces add up."""
    chain = rb.replicate(rb.Body(1.0, 0.2), 3)
    stiffness, points = [10.0, 20.0], [(0.1, 0.0, 0.0), (0.0, 0.1, 0.0)]
    one = rb.Scene(
        chain, rb.SpringDamper(stiffness, rest_length=0.3, point_a=points, body_a=(0, 1), body_b=(1, 2))
    )
    many = rb.Scene(
        chain,
        [
            rb.SpringDamper(stiffness[i], rest_length=0.3, point_a=points[i], body_a=i, body_b=i + 1)
            for i in (0, 1)
        ],
    )
    state = one.state([(0.0, 0, 0), (1.0, 0, 0), (1.0, 1.0, 0)])
    finals = [rb.rollout(scene, state, dt=0.01, steps=50).final for scene in (one, many)]
    assert largest(finals[0].position - finals[1].position) < tolerance(float64=1e-14, float32=2e-6)
    assert float(rb.energy(one, state)) == pytest.approx(float(rb.energy(many, state)))


def test_spring_of_zero_length_exerts_no_force():
    scene = rb.Scene(rb.Body(1.0, 1.0), rb.SpringDamper(K, damping=1.0, rest_length=0.5))
    final = rb.rollout(scene, scene.state(), dt=0.01, steps=5).final
    assert largest(final.position) == largest(final.velocity) == 0


def test_acceleration_at_zero_length_has_the_slope_of_a_spring_without_rest_length(dtype):
    """a = −(k/m) x is smooth at x = 0, though the direction x/|x| is not: value, first and second derivative."""
    scene = rb.Scene(rb.Body(2.0, 1.0), rb.SpringDamper(K))
    start = scene.state()

    def acceleration(x):
        state = rb.scene.scene.State(
            x[None], start.orientation, start.velocity, start.angular_velocity, start.time
        )
        return scene.prepared(dtype).acceleration(state).linear[0]

    zero = jnp.zeros(3, dtype)
    assert largest(acceleration(zero)) == 0
    np.testing.assert_array_equal(jax.jacrev(acceleration)(zero), -K / 2.0 * np.eye(3))
    np.testing.assert_array_equal(jax.jacfwd(acceleration)(zero), -K / 2.0 * np.eye(3))
    assert largest(jax.jacfwd(jax.jacrev(acceleration))(zero)) == 0
