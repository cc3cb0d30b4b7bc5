"""Energy, momentum and angular momentum of a body are those of the particles that it consists of."""

import jax
import numpy as np
import pytest
from rotation_samples import largest

import jaxrb as rb
from jaxrb.body import diagnostics
from jaxrb.errors import InvalidInput


@pytest.fixture(scope="module")
def swarm(dtype):
    """Particles, the rigid body that they form, and a scene of two copies in motion."""
    draw = np.random.default_rng(0)
    masses, places = draw.uniform(0.1, 2.0, 9), draw.normal(size=(9, 3))
    places = places - masses @ places / masses.sum()
    body = rb.Body.from_particles(masses.astype(dtype), places.astype(dtype))
    scene = rb.Scene(rb.replicate(body, 2))
    orientation = rb.Quaternion.exp(draw.normal(size=(2, 3)).astype(dtype))
    position, velocity, omega = draw.normal(size=(3, 2, 3)).astype(dtype)
    return masses, places, scene, scene.state(position, orientation, velocity, omega)


@pytest.fixture(scope="module")
def particles(swarm):
    """World positions and velocities (2, 9, 3) of all particles, in float64."""
    _, places, _, state = swarm
    r = np.asarray(state.orientation.as_matrix(), np.float64)
    omega = np.asarray(state.angular_velocity, np.float64)
    arms = np.einsum("bij,kj->bki", r, places)
    turning = np.cross(np.einsum("bij,bj->bi", r, omega)[:, None], arms)
    return np.asarray(state.position)[:, None] + arms, np.asarray(state.velocity)[:, None] + turning


def test_velocity_of_a_body_point_is_v_plus_omega_cross_r(swarm, particles, tolerance):
    """The lecture's v = v' + ω × r' + v₀."""
    _, places, _, state = swarm
    small = tolerance(float64=1e-14, float32=5e-6)
    for i in (0, 5):
        point = places[i].astype(state.dtype)
        points = np.broadcast_to(point, (2, 3))
        assert largest(state.point_position(points) - particles[0][:, i]) < small
        assert largest(state.point_velocity(points) - particles[1][:, i]) < small


def test_point_velocity_is_the_rate_of_the_point_position(swarm, dtype, tolerance):
    _, places, _, state = swarm
    points = np.broadcast_to(places[2].astype(dtype), (2, 3))

    def position(t):
        turned = state.orientation @ rb.Quaternion.exp(t * state.angular_velocity)
        at = rb.scene.scene.State(
            state.position + t * state.velocity, turned, state.velocity, state.angular_velocity, state.time
        )
        return at.point_position(points)

    _, rate = jax.jvp(position, (np.zeros((), dtype),), (np.ones((), dtype),))
    assert largest(rate - state.point_velocity(points)) < tolerance(float64=1e-14, float32=5e-6)


def test_kinetic_energy_is_the_sum_over_particles(swarm, particles, tolerance):
    masses, _, scene, state = swarm
    expected = 0.5 * np.einsum("k,bki->", masses, particles[1] ** 2)
    assert float(rb.energy(scene, state)) == pytest.approx(
        expected, rel=tolerance(float64=1e-13, float32=3e-6)
    )
    per_body = diagnostics.kinetic_energy(scene.stacked(), state)
    assert per_body.shape == (2,)


def test_momentum_is_the_sum_over_particles(swarm, particles, tolerance):
    masses, _, scene, state = swarm
    expected = np.einsum("k,bki->i", masses, particles[1])
    assert largest(rb.momentum(scene, state) - expected) < tolerance(float64=1e-13, float32=3e-5)


def test_angular_momentum_is_the_sum_over_particles(swarm, particles, tolerance):
    """L = Σ r × m v = Σ (p × m v + R I ω)."""
    masses, _, scene, state = swarm
    expected = np.einsum("k,bki->i", masses, np.cross(*particles))
    assert largest(rb.angular_momentum(scene, state) - expected) < tolerance(float64=1e-13, float32=5e-5)


def test_bodies_of_different_kinds_share_a_scene(dtype, tolerance):
    """A sphere, a principal and a full inertia: the kinds are generalised, the numbers stay."""
    full = np.asarray([[3.0, 0.2, -0.3], [0.2, 2.5, 0.1], [-0.3, 0.1, 2.0]])
    bodies = (rb.Body(1.0, 2.0), rb.replicate(rb.Body(2.0, (1.0, 2.0, 2.5)), 2), rb.Body(3.0, full))
    scene = rb.Scene(bodies)
    assert scene.count == 4
    stacked = scene.stacked()
    expected = [2.0 * np.eye(3), np.diag([1.0, 2.0, 2.5]), np.diag([1.0, 2.0, 2.5]), full]
    assert largest(stacked.inertia.as_matrix() - np.stack(expected)) < tolerance(float64=1e-15, float32=1e-6)
    assert np.asarray(stacked.mass).tolist() == [1, 2, 2, 3]
    assert rb.Scene(bodies[:1]).stacked().inertia.rank == 0
    assert rb.Scene(bodies[:2]).stacked().inertia.rank == 1


def test_replicate_repeats_every_number():
    crowd = rb.replicate(rb.Body.from_shape(rb.Box((0.1, 0.2, 0.3)), density=700.0), 5)
    assert np.shape(crowd.mass) == (5,)
    assert np.shape(crowd.inertia.moments) == (5, 3)
    assert np.shape(crowd.shape.half_extents) == (5, 3)
    for count in (0, -1, 2.5):
        with pytest.raises(InvalidInput, match="count"):
            rb.replicate(rb.Body(1.0, 1.0), count)
