"""Joints against motion in closed form: one run of the yard (`joint_scenes.py`) for all kinds."""

import jax
import jax.numpy as jnp
import joint_scenes as js
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.scene.joint_library import bricard, chain, double_pendulum

DT, STEPS = 2e-3, 500


@pytest.fixture(scope="module")
def run(dtype):
    scene = js.yard(js.numbers(dtype))
    state = scene.state(*js.start(), dtype=dtype)
    return scene, rb.rollout(scene, state, dt=DT, steps=STEPS, save_every=50)


def close(found, expected, tolerance, float64=1e-9, float32=2e-4):
    np.testing.assert_allclose(found, expected, atol=tolerance(float64=float64, float32=float32))


def test_joints_stay_closed(run, tolerance):
    scene, path = run
    error = jax.vmap(lambda state: rb.joint_error(scene, state))(path.states)
    most = tolerance(float64=1e-12, float32=1e-5)
    assert error.gap.shape == (11, 11)
    assert float(error.gap.max()) < most
    assert float(error.angle.max()) < most
    assert float(error.rate.max()) < 10 * most


def test_door_on_two_hinges_swings_as_a_damped_oscillator(run, tolerance):
    scene, path = run
    half, m = js.DOOR_HALF, js.DOOR_MASS
    inertia = m * (half[0] ** 2 + half[1] ** 2) / 3 + m * half[0] ** 2
    decay = js.DOOR_DAMPING / (2 * inertia)
    omega = np.sqrt(js.DOOR_STIFFNESS / inertia - decay**2)
    t = np.asarray(path.times, float)
    angle = js.DOOR_SPEED / omega * np.exp(-decay * t) * np.sin(omega * t)
    found = jax.vmap(scene.effects[1].coordinate)(path.states)
    close(found, angle, tolerance)
    # The second hinge says the same.
    close(jax.vmap(scene.effects[2].coordinate)(path.states), found, tolerance, 1e-12, 1e-5)


def test_welded_pair_flies_as_one_body(run, tolerance):
    """Its attitude is that of the body made of both, in free flight by the closed form; its centre falls."""
    scene, path = run
    first, second = scene.bodies[1], scene.bodies[2]
    c, s = np.cos(js.WELD_TURN), np.sin(js.WELD_TURN)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    masses = np.array([float(first.mass), float(second.mass)])
    places = np.stack([js.start()[0][1], js.start()[0][2]])
    middle = masses @ places / masses.sum()
    inertia = np.zeros((3, 3))
    for mass, place, own in zip(
        masses,
        places,
        (np.asarray(first.inertia.as_matrix()), turn @ np.asarray(second.inertia.as_matrix()) @ turn.T),
    ):
        d = place - middle
        inertia += own + mass * (d @ d * np.eye(3) - np.outer(d, d))
    one = rb.Scene(rb.Body(masses.sum(), inertia))
    alone = one.state(angular_velocity=js.start()[3][1], dtype=path.final.dtype)
    flown = rb.free_flight(one, alone, float(path.final.time))
    found = jax.tree.map(lambda x: x[1:2], path.final.orientation)
    close(rb.Quaternion.from_rotation(found).angle_to(flown.orientation), 0.0, tolerance)
    centre = masses @ np.asarray(path.final.position, float)[1:3] / masses.sum()
    t = float(path.final.time)
    close(centre, middle - [0, 0, 0.5 * js.GRAVITY * t * t], tolerance, 1e-10, 1e-4)


def test_slider_on_a_spring_swings_and_one_with_a_motor_runs_up(run, tolerance):
    scene, path = run
    t = np.asarray(path.times, float)
    spring, motor = (effect for effect in scene.effects if isinstance(effect, rb.Slider))
    close(
        jax.vmap(spring.coordinate)(path.states), js.START * np.cos(np.sqrt(js.SPRING / 2.0) * t), tolerance
    )
    # At its limit all the time: the motor wants more than it has until the speed is near.
    close(jax.vmap(motor.coordinate_rate)(path.states), js.LIMIT / 2.0 * t, tolerance)


def test_pendulums_follow_jacobi(run, tolerance):
    _, path = run
    last = jax.tree.map(lambda x: np.asarray(x, float), path.final)
    rates = {
        5: np.sqrt(js.GRAVITY / js.LENGTH),
        6: np.sqrt(js.GRAVITY * 0.5 / (1 / 3 + 0.5 * 0.005**2 * 0.0)),
    }
    for body, x in ((5, last.position[5, 0] / js.LENGTH), (6, -last.position[6, 0] / 0.5)):
        close(np.arcsin(x), js.pendulum_angle(js.ANGLE, rates[body], float(last.time)), tolerance, 2e-9)


def test_linkage_keeps_its_energy(run, tolerance):
    """Closed loop in a plane: eight constraints of twenty are said twice."""
    scene, path = run
    bars = slice(7, 10)
    mass = np.array([0.3, 0.9, 0.7])
    moment = np.stack([np.asarray(body.inertia.moments) for body in scene.bodies[7:]])
    states = jax.tree.map(lambda x: np.asarray(x, float), path.states)
    v, w = states.velocity[:, bars], states.angular_velocity[:, bars]
    energy = (
        0.5 * (mass * (v**2).sum(-1) + (moment * w**2).sum(-1))
        + mass * js.GRAVITY * states.position[:, bars, 2]
    ).sum(-1)
    close(energy, energy[0], tolerance, 1e-9, 1e-4)
    assert np.abs(v).max() > 0.5


X64 = pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="figures that float32 cannot show")


@X64
def test_pendulum_follows_jacobi_for_a_hundred_periods():
    """Within 1e-9: a rod on a hinge, by a solver of diffrax on the same equations."""
    scene = rb.Scene(
        js.rod(1.0, 1.0),
        (rb.UniformGravity((0, 0, -js.GRAVITY)), rb.Hinge((0, 1, 0), (0, 0, 0.5), bodies=(0, None))),
    )
    state = scene.state((-0.5 * np.sin(1.0), 0, -0.5 * np.cos(1.0)), (np.cos(0.5), 0, np.sin(0.5), 0))
    rate = np.sqrt(js.GRAVITY * 0.5 / (1 / 3))
    end = 100.0 * js.pendulum_period(1.0, rate) + 0.3
    path = rb.solve(scene, state, t1=end, rtol=1e-12, atol=1e-12)
    found = float(scene.effects[1].coordinate(path.final))
    assert abs(found - js.pendulum_angle(1.0, rate, end)) < 1e-9
    assert abs(found) < 0.99


@X64
def test_bricards_mechanism_keeps_its_energy():
    example = bricard()
    path = rb.rollout(example.scene, example.state(), dt=1e-3, steps=10_000, save_every=500)
    energy = np.asarray(path.diagnostics.energy)
    assert np.abs(energy - energy[0]).max() < 1e-6
    assert float(rb.joint_error(example.scene, path.final).gap.max()) < 1e-10
    assert np.ptp(np.asarray(path.states.position)[:, 2, 1]) > 0.2  # it moves


def test_chain_hangs_together(tolerance, dtype):
    """Twenty links: more rows than one block, with links of very different mass as well."""
    example = chain(20)

    def of(masses):
        inertia = rb.PrincipalInertia(
            masses[:, None] * np.asarray(example.scene.bodies[0].inertia.moments) / 0.1
        )
        scaled = rb.Body(masses, inertia, None, jnp.zeros((20, 3), masses.dtype))
        scene = rb.Scene(scaled, example.scene.effects)
        state = scene.state(**example.start, dtype=masses.dtype)
        path = rb.rollout(scene, state, dt=5e-4, steps=400, save_every=40, on_error="flag")
        return path.diagnostics.energy, rb.joint_error(scene, path.final), path.status.reason

    alike = np.full(20, 0.1)
    # A load at the end; of 1e4 links in float32 the run ends, and says so.
    heavy = np.where(np.arange(20) == 19, 0.1 * tolerance(float64=1e4, float32=1e2), 0.1)
    masses = jnp.asarray(np.stack([alike, heavy]), dtype)
    energy, error, reason = jax.jit(jax.vmap(of), compiler_options=rb.compiler_options())(masses)
    assert (np.asarray(reason) == 0).all()
    most = tolerance(float64=1e-12, float32=1e-5)
    assert float(error.gap.max()) < most
    drift = np.abs(energy - energy[:, :1]).max(axis=1) / np.abs(energy[:, 0])
    assert drift.max() < tolerance(float64=1e-8, float32=1e-3)


def double_pendulum_reference(angles, times):
    """Angles (k, 2) from the vertical of two rods of 1 m and 1 kg let go at rest, by DOP853 at 1e-13."""
    from scipy.integrate import solve_ivp

    def field(_t, y):
        a, b, da, db = y
        matrix = np.array([[1 / 3 + 1.0, 0.5 * np.cos(a - b)], [0.5 * np.cos(a - b), 1 / 3]])
        right = np.array([
            -0.5 * np.sin(a - b) * db**2 - 1.5 * js.GRAVITY * np.sin(a),
            0.5 * np.sin(a - b) * da**2 - 0.5 * js.GRAVITY * np.sin(b),
        ])  # fmt: skip
        return [da, db, *np.linalg.solve(matrix, right)]

    found = solve_ivp(field, (0, times[-1]), [*angles, 0, 0], "DOP853", times, rtol=1e-13, atol=1e-13)
    return found.y[:2].T


def test_double_pendulum_follows_the_reference_until_chaos(tolerance, dtype):
    """Let go stretched out level, both rods in line; with rotation matrices."""
    example = double_pendulum()
    path = rb.rollout(
        example.scene, example.state(rb.RotationMatrix, dtype), dt=1e-3, steps=2000, save_every=500
    )
    expected = double_pendulum_reference((np.pi / 2, np.pi / 2), np.asarray(path.times, float))
    ends = jax.vmap(lambda s: s.point_position(jnp.asarray([0, 0, 0.5], dtype)))(path.states)
    tip = np.stack([np.sin(expected).sum(1), 0 * expected[:, 0], -np.cos(expected).sum(1)], axis=1)
    close(ends[:, 1], tip, tolerance, 2e-8, 2e-3)
