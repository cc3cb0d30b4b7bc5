"""Rolling and spinning resistance of rigid contact: closed forms, the two solvers, derivatives, what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb

G = 9.81
RADIUS, LENGTH = 0.1, 0.01
BALL = rb.Body.from_shape(rb.Sphere(RADIUS), 1000.0)
CUBE = rb.Body.from_shape(rb.Box((0.1, 0.1, 0.1)), 500.0)
METHOD = rb.SemiImplicitEuler()


def on_floor(
    gravity, position, velocity, spin, rolling, spinning, *, body=BALL, restitution=None, steps=1600, save=100
):
    floor = rb.RigidContact(
        rb.HalfSpace(),
        friction=0.5,
        restitution=restitution,
        rolling_resistance=rolling,
        spinning_resistance=spinning,
    )
    scene = rb.Scene(body, (rb.UniformGravity(gravity), floor))
    state = scene.state(position, velocity=velocity, angular_velocity=spin, dtype=jnp.asarray(velocity).dtype)
    return rb.rollout(scene, state, dt=1e-3, steps=steps, save_every=save, method=METHOD)


@pytest.fixture(scope="module")
def paths(dtype):
    """Balls that roll, that spin where they stand, and that lie on inclines at 0.99 and 1.01 of what holds them."""
    slopes = np.arctan(np.array([0.0, 0.0, 0.99, 1.01]) * LENGTH / RADIUS)
    gravity = G * np.stack([np.sin(slopes), 0 * slopes, -np.cos(slopes)], axis=1)
    velocity = np.array([[0.6, 0.8, 0], *np.zeros((3, 3))])
    spin = np.array([[-8.0, 6.0, 0], [0, 0, 20.0], *np.zeros((2, 3))])
    position = np.broadcast_to([0, 0, RADIUS], (4, 3))
    arguments = (jnp.asarray(x, dtype) for x in (gravity, position, velocity, spin))
    run = jax.jit(jax.vmap(lambda *x: on_floor(*x, LENGTH, 0.02)), compiler_options=QUICK)
    found = jax.tree.map(np.asarray, run(*arguments))
    assert found.contact.poor.max() == 0
    return found, slopes


def moving(path, case):
    """Times, positions, velocities and rates of the one body of a case."""
    states = path.states
    return path.times[case], *(
        x[case, :, 0] for x in (states.position, states.velocity, states.angular_velocity)
    )


def test_a_rolling_ball_slows_by_five_sevenths_of_g_b_over_r_and_stands(paths, tolerance):
    found, _ = paths
    slow = 5 / 7 * G * LENGTH / RADIUS
    time, position, velocity, _ = moving(found, 0)
    speed = velocity @ [0.6, 0.8, 0]
    rolls = time < 1 / slow
    np.testing.assert_allclose(
        speed[rolls], 1 - slow * time[rolls], atol=tolerance(float64=1e-11, float32=2e-5)
    )
    assert not rolls[-1]
    assert np.abs(velocity[~rolls]).max() < tolerance(float64=1e-9, float32=1e-5)
    # Of an order 1 step, each 1 ms long, the mean velocity is that at its end.
    way = position[-1] @ [0.6, 0.8, 0]
    assert way == pytest.approx(1 / (2 * slow) - 1e-3 / 2, abs=2e-5)


def test_a_spinning_ball_slows_by_b_m_g_over_its_inertia(paths, tolerance):
    found, _ = paths
    slow = 0.02 * G / (0.4 * RADIUS**2)
    time, _, _, spin = moving(found, 1)
    spin = spin[:, 2]
    np.testing.assert_allclose(
        spin, np.maximum(20 - slow * time, 0), atol=tolerance(float64=1e-9, float32=1e-4)
    )
    assert spin[-1] == pytest.approx(0.0, abs=1e-6)


def test_a_ball_rolls_down_from_the_slope_that_the_length_gives(paths, tolerance):
    """It holds still, to round-off, while tan α < b/r, and beyond it rolls by 5/7 (g sin α − g cos α b/r)."""
    found, slopes = paths
    assert np.abs(moving(found, 2)[2][-1]).max() < tolerance(float64=1e-12, float32=1e-6)
    wanted = 5 / 7 * G * (np.sin(slopes[3]) - np.cos(slopes[3]) * LENGTH / RADIUS) * found.times[3]
    np.testing.assert_allclose(moving(found, 3)[2][:, 0], wanted, atol=tolerance(float64=1e-9, float32=3e-6))


def test_two_bodies_that_spin_on_each_other_share_their_spin(dtype, tolerance):
    """Pressed together in space: angular momentum is kept, and each slows by b F / I until they turn as one."""
    spring = rb.SpringDamper(200.0, rest_length=0.1, body_a=0, body_b=1)
    touch = rb.RigidContact(spinning_resistance=0.05, rolling_resistance=0.05, friction=0.3)
    scene = rb.Scene((BALL, CUBE), (spring, touch))
    state = scene.state([[0, 0, 0.2], [0, 0, 0]], angular_velocity=[[0, 0, 6.0], [0, 0, -1.0]], dtype=dtype)
    path = rb.rollout(scene, state, dt=1e-3, steps=400, save_every=50, method=METHOD)
    momentum = np.asarray(jax.vmap(lambda s: rb.angular_momentum(scene, s))(path.states))
    np.testing.assert_allclose(momentum - momentum[0], 0, atol=tolerance(float64=1e-12, float32=1e-5))
    spins = np.asarray(path.states.angular_velocity)[..., 2]
    inertia = [float(body.inertia.as_matrix()[2, 2]) for body in (BALL, CUBE)]
    one = (6 * inertia[0] - inertia[1]) / sum(inertia)
    np.testing.assert_allclose(spins[-1], one, atol=tolerance(float64=1e-6, float32=1e-4))
    early = 6 - 0.05 * 200 * 0.1 / inertia[0] * 0.05
    assert spins[1, 0] == pytest.approx(early, rel=2e-2)


def problem_of(scene, state, dt):
    dynamics = scene.prepared(state.dtype)
    contact = dynamics.contact
    alone = eqx.tree_at(lambda d: d.contact, dynamics, None)
    free = METHOD.step(alone, state, dt)
    found = contact.detected(state, free, dt, contact.first_memory(state).memory)
    return contact._problem(dynamics, state, free, found, dt)[0]


def thrown_together(dtype):
    """A ball and two cubes that overlap a little, on a floor, all moving and turning."""
    rules = {"friction": 0.4, "rolling_resistance": 0.02, "spinning_resistance": 0.03}
    touch = (rb.RigidContact(rb.HalfSpace(), **rules), rb.RigidContact(**rules))
    scene = rb.Scene((CUBE, CUBE, BALL), (rb.UniformGravity((0, 0, -G)), *touch))
    rng = np.random.default_rng(5)
    position = [[0, 0, 0.0999], [0.05, 0.03, 0.2998], [0.2, 0, 0.0999]]
    return scene, scene.state(
        position,
        velocity=rng.normal(0, 0.4, (3, 3)),
        angular_velocity=rng.normal(0, 3, (3, 3)),
        dtype=dtype,
    )


@pytest.fixture(scope="module")
def problem(dtype):
    return jax.jit(lambda: problem_of(*thrown_together(dtype), 1e-3), compiler_options=QUICK)()


def test_newton_and_the_rounds_find_one_answer(problem, dtype):
    """Two solvers that share no step of their arithmetic, and the law looked at from outside."""
    if dtype != jnp.float64:
        pytest.skip("answers are compared to 1e-7")
    from jaxrb.contact.accelerated import projected_gradient
    from jaxrb.contact.newton import newton

    def both(problem):
        start = jnp.zeros((*problem.contacts.active.shape, 3))
        one, least = jnp.ones(()), jnp.asarray(1e-11)
        first = newton(problem, start, one, least, one)
        return first[0], projected_gradient(problem, start, one, least, rounds=20000)[0]

    first, second = jax.jit(both, compiler_options=QUICK)(problem)
    np.testing.assert_allclose(problem.moved_by(first), problem.moved_by(second), atol=1e-7)
    c = problem.contacts
    load = np.sum(first * c.normal[:, None], axis=-1)[:, :-1].sum(axis=1)
    couple = np.asarray(c.resistance.arm[:, None] * first[:, -1])
    about = np.sum(couple * c.normal, axis=-1)
    across = np.linalg.norm(couple - about[:, None] * c.normal, axis=-1)
    rate = np.asarray(c.relative_velocity(problem.moved_by(first)))[:, -1] / c.resistance.arm[:, None]
    assert (across <= 0.02 * load * (1 + 1e-6)).all()
    assert (np.abs(about) <= 0.03 * load * (1 + 1e-6)).all()
    assert (load > 0).sum() >= 3
    # Where they still turn on each other, the couple is as great as it may be, against the turning.
    turns = (np.abs(np.sum(rate * c.normal, axis=-1)) > 1e-5) & (load > 0)
    np.testing.assert_allclose(
        about[turns], -0.03 * load[turns] * np.sign(np.sum(rate * c.normal, axis=-1))[turns], rtol=1e-5
    )
    assert turns.any()


def test_rows_columns_and_blocks_are_one_jacobian(problem, dtype, tolerance):
    """Jᵀ of J, Jᵀ G J of both, in rows and in columns."""
    from jaxrb.contact.columns import columns_of

    c, count = problem.contacts, len(problem.mass)
    rng = np.random.default_rng(1)
    motion = rng.normal(size=(count, 6)).astype(dtype)
    impulse = rng.normal(size=(*c.active.shape, 3)).astype(dtype)
    root = rng.normal(size=(*c.active.shape, 3, 3))
    bend = (root @ np.swapaxes(root, -1, -2)).astype(dtype)

    def looked_at(problem, motion, impulse, bend):
        c, points = problem.contacts, columns_of(problem)
        velocity = c.relative_velocity(motion)
        jacobian = jax.jacfwd(c.relative_velocity)(motion)
        across = (c.impulse_on_bodies(impulse), points.on_bodies(points.columns(impulse)).T)
        return jacobian, (velocity, points.rows(points.velocity(motion.T))), across, c.blocks(bend)

    jacobian, velocities, given, blocks = jax.jit(looked_at, compiler_options=QUICK)(
        problem, motion, impulse, bend
    )
    scale = {"atol": tolerance(float64=1e-13, float32=2e-5)}
    for velocity in velocities:
        np.testing.assert_allclose(velocity, np.einsum("ksinm,nm->ksi", jacobian, motion), **scale)
    for wrench in given:
        np.testing.assert_allclose(wrench, np.einsum("ksinm,ksi->nm", jacobian, impulse), **scale)
    own = np.einsum("ksinm,ksij,ksjnl->nml", jacobian, bend, jacobian)
    np.testing.assert_allclose(blocks, own, rtol=1e-5, atol=tolerance(float64=1e-12, float32=1e-4))
    assert np.abs(own[:, 3:, 3:]).min(axis=(1, 2)).max() > 1e-3


def ends(x):
    """Where a ball that rolls, with a spin about the vertical, is and how it turns."""
    rolling, spinning, speed, mass = x
    zero = 0.0 * mass
    body = rb.Body(mass, BALL.inertia, BALL.shape)
    path = on_floor(
        jnp.asarray([0, 0, -G]), jnp.asarray([0, 0, RADIUS]), jnp.stack([speed, zero, zero]),
        jnp.stack([zero, speed / RADIUS, 10 + zero]), rolling, spinning, body=body, steps=40, save=40,
    )  # fmt: skip
    return jnp.stack([path.final.position[0, 0], path.final.angular_velocity[0, 2]])


def test_derivatives_are_those_of_differences(dtype):
    if dtype != jnp.float64:
        pytest.skip("differences need float64")
    at, h = jnp.asarray([0.01, 0.02, 1.3, 3.0]), 1e-6
    sides = jnp.concatenate([at + h * jnp.eye(4), at - h * jnp.eye(4)])
    found = jax.jit(jax.vmap(ends), compiler_options=QUICK)(sides)
    differences = (found[:4] - found[4:]).T / (2 * h)
    reverse = jax.jit(jax.jacrev(ends), compiler_options=QUICK)(at)
    np.testing.assert_allclose(reverse, differences, rtol=1e-5, atol=1e-7)
    assert np.all(np.abs(differences).max(axis=0) > 1e-3)  # none of the four is without effect


def test_what_does_not_know_couples_refuses_them():
    resists = rb.RigidContact(rb.HalfSpace(), rolling_resistance=0.01)
    scene = rb.Scene(BALL, (rb.UniformGravity((0, 0, -G)), resists))
    with pytest.raises(rb.WrongStructure, match=r"solve_events: RigidContact resists rolling.*rb\.rollout"):
        rb.solve_events(scene, scene.state((0, 0, 1.0)), t1=1.0, max_events=4)
    with pytest.raises(rb.WrongStructure, match=r"solve_contact: RigidContact resists rolling"):
        rb.solve_contact(scene, scene.state((0, 0, 1.0)), t1=1.0, tolerance=1e-3)
    crowd = rb.Scene((BALL, BALL), rb.RigidContact(spinning_resistance=0.01, solver="sparse"))
    with pytest.raises(rb.WrongStructure, match=r"spinning_resistance: the sparse solve.*newton"):
        crowd.prepared(jnp.float32)
    with pytest.raises(rb.InvalidInput, match=r"RigidContact\.rolling_resistance is .*-0\.1.* m"):
        rb.RigidContact(rb.HalfSpace(), rolling_resistance=-0.1)
