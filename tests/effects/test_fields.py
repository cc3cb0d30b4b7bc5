"""Gravity of a centre and of bodies, fluids, magnets, twisted springs and motors against closed forms and balances."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb

MASS, INERTIA = 2.0, (0.3, 0.5, 0.6)
BODY = rb.Body(MASS, INERTIA)
BALL = rb.Body(MASS, 0.5)


def run(scene, state, duration, steps, **options):
    return rb.rollout(scene, state, dt=duration / steps, steps=steps, save_every=steps // 10, **options)


def test_circular_orbit_returns_after_keplers_period(tolerance):
    scene = rb.Scene(BALL, rb.CentralGravity(4.0, center=(0.0, 0.0, 1.0)))
    state = scene.state(position=[(1.0, 0.0, 1.0)], velocity=[(0.0, 2.0, 0.0)])
    path = run(scene, state, 2 * np.pi * np.sqrt(1.0 / 4.0), 400)
    np.testing.assert_allclose(
        path.final.position, state.position, atol=tolerance(float64=1e-7, float32=1e-5)
    )
    np.testing.assert_allclose(
        path.diagnostics.energy, MASS * (2.0 - 4.0), rtol=tolerance(float64=1e-7, float32=1e-5)
    )


def test_gravity_gradient_is_the_torque_on_the_parts(dtype):
    """A dumbbell of two points, each attracted by itself; the torque differs by the square of size over distance."""
    size, mu = 1e-2, 5.0
    inertia = np.diag([2 * size**2] * 2 + [1e-9])  # two unit masses on the z axis
    body = rb.Body(2.0, np.diag(inertia))
    turned = rb.Quaternion.exp(jnp.asarray([[0.4, 0.3, -0.2]], dtype))
    scene = rb.Scene(body, rb.GravityGradient(mu))
    place = np.asarray([[1.0, 2.0, -0.5]])
    state = scene.state(position=place.tolist(), orientation=turned.wxyz, dtype=dtype)
    torque = np.asarray(scene.prepared(state.dtype).wrench(state).torque[0], float)
    arms = np.asarray([[0, 0, size], [0, 0, -size]])
    with jax.enable_x64(True):
        frame = rb.Quaternion(jnp.asarray(np.asarray(turned.wxyz, float))).as_matrix()[0]
        at = place + arms @ np.asarray(frame).T
    pulls = -mu * at / np.linalg.norm(at, axis=1, keepdims=True) ** 3
    expected = np.cross(arms, pulls @ np.asarray(frame)).sum(0)
    np.testing.assert_allclose(torque, expected, atol=2e-4 * np.linalg.norm(expected))


def test_gravity_gradient_keeps_the_energy_of_a_satellite(tolerance):
    scene = rb.Scene(BODY, (rb.CentralGravity(4.0), rb.GravityGradient(4.0)))
    state = scene.state(
        position=[(1.0, 0.0, 0.0)], velocity=[(0.0, 2.0, 0.0)], angular_velocity=[(0.2, 0.1, 2.5)]
    )
    # The orbit does not feel the torque's reaction, so only what turns is balanced: about a circle the field turns
    # with the body, and energy less n·L is kept (Jacobi's integral).
    path = run(scene, state, 3.0, 1500)
    spin = path.states.orientation.rotate(jnp.asarray(INERTIA, state.dtype) * path.states.angular_velocity)
    jacobi = path.diagnostics.energy - 2.0 * (
        spin[:, 0, 2] + MASS * jnp.cross(path.states.position, path.states.velocity)[:, 0, 2]
    )
    np.testing.assert_allclose(jacobi, jacobi[0], atol=tolerance(float64=1e-7, float32=1e-4))


def test_two_bodies_circle_each_other_and_keep_momentum(tolerance):
    bodies = (rb.Body(3.0, 0.1), rb.Body(1.0, 0.1))
    scene = rb.Scene(bodies, rb.MutualGravity(1.0))
    rate = np.sqrt(4.0)  # G (m₁ + m₂)/d³ with d = 1
    state = scene.state(
        position=[(-0.25, 0, 0), (0.75, 0, 0)],
        velocity=[(0, -0.25 * rate, 0), (0, 0.75 * rate, 0)],
    )
    path = run(scene, state, 2 * np.pi / rate, 400)
    np.testing.assert_allclose(
        path.final.position, state.position, atol=tolerance(float64=1e-7, float32=1e-5)
    )
    np.testing.assert_allclose(path.diagnostics.momentum, 0.0, atol=tolerance(float64=1e-14, float32=1e-5))
    np.testing.assert_allclose(path.diagnostics.energy, path.diagnostics.energy[0], rtol=1e-5)


def test_mutual_gravity_has_a_finite_derivative():
    scene = rb.Scene((BALL, BALL, BALL), rb.MutualGravity(1.0))

    def loss(place):
        state = scene.state(position=place)
        return rb.rollout(scene, state, dt=0.01, steps=3).final.position[0, 0]

    gradient = jax.grad(loss)(jnp.asarray([[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]]))
    assert np.isfinite(gradient).all()


def test_archimedes_carries_a_body_of_the_waters_density(tolerance):
    water = rb.Buoyancy(volume=MASS / 999.97)
    scene = rb.Scene(BODY, (rb.UniformGravity(), water))
    path = run(scene, scene.state(), 1.0, 20)
    np.testing.assert_allclose(path.final.position, 0.0, atol=tolerance(float64=1e-12, float32=1e-5))


def test_a_buoy_rights_itself_and_keeps_its_energy(tolerance):
    scene = rb.Scene(BODY, rb.Buoyancy(volume=1e-3, point=(0.0, 0.0, 0.2)))
    state = scene.state(orientation=rb.Quaternion.exp(jnp.asarray([0.3, 0.0, 0.0])).wxyz)
    path = run(scene, state, 2.0, 400)
    tilt = path.states.orientation.as_matrix()[:, 0, 2, 2]
    assert float(tilt.max()) > float(tilt[0])
    energy = path.diagnostics.energy
    np.testing.assert_allclose(energy, energy[0], atol=tolerance(float64=1e-7, float32=1e-3))


def test_a_spinning_ball_flies_in_a_circle(tolerance):
    lift = 0.8
    scene = rb.Scene(BALL, rb.MagnusForce(lift))
    state = scene.state(velocity=[(1.0, 0.0, 0.0)], angular_velocity=[(0.0, 0.0, 5.0)])
    rate = lift * 5.0 / MASS
    path = run(scene, state, 2 * np.pi / rate, 300)
    np.testing.assert_allclose(path.final.position, 0.0, atol=tolerance(float64=1e-7, float32=1e-5))
    centre = np.asarray([0.0, 1.0 / rate, 0.0])
    radius = np.linalg.norm(np.asarray(path.states.position[:, 0]) - centre, axis=1)
    np.testing.assert_allclose(radius, 1.0 / rate, rtol=1e-5)


def wrench_of(effect, **start):
    scene = rb.Scene(BODY, effect)
    state = scene.state(**start)
    return scene.prepared(state.dtype).wrench(state)


def test_a_plate_feels_rayleighs_pressure(tolerance):
    plate = rb.PlateAerodynamics(normal=(0, 0, 2.0), area=0.3, density=1.2)
    flat = wrench_of(plate, velocity=[(0.0, 0.0, -3.0)])
    np.testing.assert_allclose(flat.force[0, 2], 0.5 * 1.2 * 0.3 * 9 * 2 * np.pi / (4 + np.pi), rtol=1e-6)
    angle = 0.3
    tilted = wrench_of(plate, velocity=[(3.0 * np.cos(angle), 0.0, -3.0 * np.sin(angle))])
    size = 2 * np.pi * np.sin(angle) / (4 + np.pi * np.sin(angle))
    np.testing.assert_allclose(tilted.force[0], [0, 0, 0.5 * 1.2 * 0.3 * 9 * size], rtol=1e-6, atol=1e-6)
    edge = wrench_of(plate, velocity=[(3.0, 0.0, 0.0)])
    np.testing.assert_allclose(edge.force[0], 0.0, atol=tolerance(float64=1e-14, float32=1e-6))


def test_a_plate_on_an_arm_slows_the_spin_and_has_derivatives_at_rest():
    plate = rb.PlateAerodynamics(normal=(0, 1.0, 0), area=0.3, point=(0.5, 0.0, 0.0))
    braked = wrench_of(plate, angular_velocity=[(0.0, 0.0, 4.0)])
    assert float(braked.torque[0, 2]) < 0
    assert float(wrench_of(plate, angular_velocity=[(0.0, 0.0, -4.0)]).torque[0, 2]) > 0

    def force(velocity):
        return wrench_of(plate, velocity=velocity[None]).force[0, 1]

    np.testing.assert_array_equal(jax.grad(force)(jnp.zeros(3)), 0.0)
    assert np.isfinite(jax.hessian(force)(jnp.zeros(3))).all()


def test_wind_carries_what_it_slows(tolerance):
    wind = (3.0, -1.0, 0.5)
    scene = rb.Scene(
        (BALL, BALL), (rb.LinearDrag(4.0, wind=wind, bodies=(0,)), rb.QuadraticDrag(1.0, 8.0, wind=wind, bodies=(1,)))
    )  # fmt: skip
    path = run(scene, scene.state(), 5.0, 500)
    decay = np.exp(-4.0 / MASS * 5.0)
    np.testing.assert_allclose(
        path.final.velocity[0], np.asarray(wind) * (1 - decay), rtol=tolerance(float64=1e-8, float32=1e-5)
    )
    # |v| v: the speed against the air falls as s/(1 + s c t).
    speed, c = np.linalg.norm(wind), 0.5 * 1.225 * 8.0 / MASS
    lag = np.linalg.norm(np.asarray(path.final.velocity[1]) - wind)
    assert lag == pytest.approx(speed / (1 + speed * c * 5.0), rel=tolerance(float64=1e-7, float32=1e-4))


def test_a_compass_needle_swings_at_its_frequency(tolerance):
    scene = rb.Scene(BALL, rb.MagneticTorque(moment=(2.0, 0.0, 0.0), field=(0.5, 0.0, 0.0)))
    amplitude = 1e-3
    state = scene.state(orientation=rb.Quaternion.exp(jnp.asarray([0.0, 0.0, amplitude])).wxyz)
    quarter = 0.5 * np.pi / np.sqrt(2.0 * 0.5 / 0.5)
    path = run(scene, state, quarter, 100)
    np.testing.assert_allclose(
        path.final.orientation.log()[0], 0.0, atol=tolerance(float64=1e-9, float32=1e-6)
    )
    energy = path.diagnostics.energy
    np.testing.assert_allclose(energy, energy[0], atol=tolerance(float64=1e-12, float32=1e-6))


@pytest.mark.parametrize("rotation", [rb.Quaternion, rb.RotationMatrix], ids=lambda r: r.__name__)
def test_a_twisted_spring_swings_harmonically_at_any_angle(rotation, tolerance):
    stiffness, angle = 2.0, 2.5
    scene = rb.Scene(BALL, rb.AngularSpring(stiffness))
    start = rb.Quaternion.exp(jnp.asarray([0.0, angle, 0.0])).wxyz
    state = scene.state(orientation=start, rotation=rotation)
    duration = 1.3
    path = run(scene, state, duration, 200)
    expected = angle * np.cos(np.sqrt(stiffness / 0.5) * duration)
    np.testing.assert_allclose(
        path.final.orientation.log()[0], [0.0, expected, 0.0], atol=tolerance(float64=1e-6, float32=1e-4)
    )


def test_a_spring_between_bodies_keeps_energy_and_angular_momentum(tolerance):
    rest = rb.Quaternion.exp(jnp.asarray([0.0, 0.2, 0.1]))
    scene = rb.Scene((BODY, BALL), rb.AngularSpring(3.0, rest=rest, body_a=0, body_b=1))
    state = scene.state(
        angular_velocity=[(0.4, 1.0, -0.3), (0.1, -0.5, 0.2)], position=[(0, 0, 0), (1, 0, 0)]
    )
    path = run(scene, state, 2.0, 800)
    found = path.diagnostics
    small = tolerance(float64=1e-8, float32=1e-4)
    np.testing.assert_allclose(found.energy, found.energy[0], atol=small)
    np.testing.assert_allclose(
        found.angular_momentum, np.broadcast_to(found.angular_momentum[0], (11, 3)), atol=small
    )
    assert float(jnp.ptp(path.states.angular_velocity[:, 1, 0])) > 0.05  # the reaction is felt


def test_damping_between_bodies_takes_energy_and_keeps_angular_momentum(tolerance):
    scene = rb.Scene((BODY, BALL), rb.AngularSpring(3.0, damping=0.3, body_a=1, body_b=0))
    state = scene.state(
        angular_velocity=[(0.4, 1.0, -0.3), (0.1, -0.5, 0.2)], position=[(0, 0, 0), (1, 0, 0)]
    )
    found = run(scene, state, 2.0, 400).diagnostics
    assert (np.diff(found.energy) < 0).all()
    np.testing.assert_allclose(
        found.angular_momentum[-1], found.angular_momentum[0], atol=tolerance(float64=1e-7, float32=1e-4)
    )


def test_a_motor_runs_up_at_its_limit_and_then_settles(tolerance):
    scene = rb.Scene(BALL, rb.Motor(axis=(0, 0, 2.0), speed=3.0, gain=5.0, torque_limit=1.0))
    path = run(scene, scene.state(), 1.0, 100)
    np.testing.assert_allclose(
        path.final.angular_velocity[0], [0, 0, 1.0 / 0.5], rtol=1e-5
    )  # still at the limit
    path = run(scene, path.final, 1.0, 200)
    assert float(path.final.angular_velocity[0, 2]) == pytest.approx(3.0, abs=1e-2)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: rb.CentralGravity(-1.0), r"CentralGravity\.parameter"),
        (lambda: rb.Buoyancy(np.nan), r"Buoyancy\.volume"),
        (lambda: rb.PlateAerodynamics((0, 0, 1), -1.0), r"PlateAerodynamics\.area"),
        (lambda: rb.MagneticTorque((0, 0), (0, 0, 1)), r"MagneticTorque\.moment"),
        (lambda: rb.LinearDrag(1.0, wind=1.0), r"LinearDrag\.wind"),
        (lambda: rb.Scene(BALL, rb.AngularSpring(1.0, body_b=3)), "there is no body 3"),
        (lambda: rb.Scene((BALL, BALL), rb.AngularSpring(1.0, body_b=0)), "against itself"),
        (lambda: rb.Motor((0, 0, 0), 1.0, 1.0), r"Motor\.axis"),
        (lambda: rb.PlateAerodynamics((0, 0, 0), 1.0), r"PlateAerodynamics\.normal"),
    ],
)  # fmt: skip
def test_fields_that_make_no_sense_are_refused(make, named):
    with pytest.raises(rb.JaxrbError, match=named):
        make()
