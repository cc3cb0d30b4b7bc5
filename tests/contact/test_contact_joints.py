"""Joints and rigid contact solved together: against closed forms, by balances of momentum and energy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.scene.joint_library import GRAVITY, Rods, cart, doll_on_floor

METHOD = rb.SemiImplicitEuler()
X64 = pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="differences need float64")


def stepped(scene, state, dt, steps, method):
    """Steps one by one: states, impulses that contact gave in each (steps, blocks, 3), joints' errors, energies."""

    def run(scene, state):
        dynamics = scene.prepared(state.dtype)

        def one(carry, _):
            state, memory = method.carried_step(dynamics, *carry, jnp.asarray(dt, carry[0].dtype))
            given = jnp.concatenate([jnp.sum(i, axis=1) for i in memory[1].memory.impulse])
            error = rb.joint_error(scene, state)
            told = (state, given, error.gap.max(), error.angle.max(), rb.energy(scene, state))
            return (state, memory), told

        (_, memory), told = jax.lax.scan(one, (state, method.first_carry(dynamics, state)), length=steps)
        return *told, memory[1].report

    return jax.jit(run, compiler_options=QUICK)(scene, state)


def blows(restitution, speed):
    """ω after a door has hit a wall with its whole edge."""
    half = (0.5, 0.05, 0.02)
    leaf = rb.Body.from_shape(rb.Box(half), 1000.0)
    hinge = rb.Hinge((0, 0, 1.0), (-half[0], 0, 0), bodies=(0, None))
    wall = rb.RigidContact(rb.HalfSpace((0, -1.0, 0), -half[1] - 5e-4), restitution=restitution)
    scene = rb.Scene(leaf, (hinge, wall))
    state = scene.state(
        (half[0], 0, 0), None, jnp.stack([0 * speed, half[0] * speed, 0 * speed]),
        jnp.stack([0 * speed, 0 * speed, speed]),
    )  # fmt: skip
    return rb.rollout(scene, state, dt=2e-4, steps=4, method=METHOD, on_error="flag")


def test_a_door_comes_back_from_a_wall_with_its_restitution(dtype, tolerance):
    """ω⁺ = −e ω⁻ to the square of the angle of a step, whatever the hinge bears."""
    e, speed = jnp.asarray([0.0, 0.3, 0.8, 1.0], dtype), jnp.asarray([2.0, 3.0, 4.0, 3.0], dtype)
    path = jax.jit(jax.vmap(blows), compiler_options=QUICK)(e, speed)
    assert bool(path.status.ok.all())
    assert int(path.contact.poor.max()) == 0
    after = path.final.angular_velocity[:, 0, 2]
    np.testing.assert_allclose(after / speed, -e, atol=tolerance(float64=1e-6, float32=1e-4))
    assert np.all(np.asarray(path.contact.points[:, -1]) > 0)


def test_the_pivot_bears_what_the_centre_of_percussion_says(dtype, tolerance):
    """A rod of length l hung up at its end and struck at d: the pivot gives p (3 d/(2 l) − 1), none at two thirds."""
    length, mass, size = 1.2, 0.7, 2.0
    inertia = mass * length**2 / 12
    rod = rb.Body(mass, (inertia, inertia, 1e-3))
    scene = rb.Scene(rod, (rb.Hinge((0, 1.0, 0), (0, 0, length / 2), bodies=(0, None)),))
    state = scene.state(position=(0, 0, -length / 2), dtype=dtype)
    dynamics = scene.prepared(dtype)
    inverse = jnp.diag(jnp.asarray([1 / mass] * 3 + [1 / inertia] * 2 + [1e3], dtype))
    struck = jnp.asarray([0.3, 2 / 3 * length, 1.0], dtype)
    # A push p along x at d below the pivot, d − l/2 below the centre: it turns the rod about y by −(d − l/2) p.
    blow = jnp.zeros((3, 1, 6), dtype).at[:, 0, 0].set(size).at[:, 0, 4].set(-(struck - length / 2) * size)

    def borne(state, blow):
        return dynamics.joints.reactions(state, inverse[None]).borne(blow) - blow

    given = jax.jit(jax.vmap(borne, (None, 0)), compiler_options=QUICK)(state, blow)[:, 0]
    close = tolerance(float64=1e-12, float32=1e-5)
    np.testing.assert_allclose(given[:, 0], size * (1.5 * struck / length - 1), atol=close)
    np.testing.assert_allclose(given[:, 4], length / 2 * given[:, 0], atol=close)


def chain(count, first, z, tilt):
    """Links of 0.2 m in a row, tilted: bodies, joints between them as bodies from number `first` on, places."""
    link, y = 0.2, 0.5 * first
    ends = [
        np.array([k * link * math.cos(tilt), y + 0.03 * (k % 2), z + k * link * math.sin(tilt)])
        for k in range(count + 1)
    ]
    rods = Rods(ends)
    joints = []
    for k in range(count - 1):
        ball = rods.ball(k + 1, k, k + 1)
        joints.append(rb.BallJoint(ball.anchor_a, ball.anchor_b, bodies=(first + k + 1, first + k)))
    return rods.start, joints


@pytest.fixture(scope="module")
def fallen(dtype):
    """A pair of links and a chain of ten, let fall on a floor with friction: what `stepped` tells of it."""
    (pair, first), (ten, others) = chain(2, 0, 0.05, 0.7), chain(10, 2, 0.1, 0.15)
    link = rb.replicate(rb.Body.from_shape(rb.Capsule(0.02, 0.08), 1000.0), 12)
    scene = rb.Scene(link, (GRAVITY, *first, *others, rb.RigidContact(rb.HalfSpace(), friction=0.5)))
    state = scene.state(**{name: pair[name] + ten[name] for name in pair}, dtype=dtype)
    return scene, state, stepped(scene, state, 2e-3, 700, rb.RungeKutta4())


def test_joints_stay_closed_while_contact_pushes(fallen, tolerance):
    _, _, (_, _, gap, angle, _, report) = fallen
    assert float(gap.max()) < tolerance(float64=1e-12, float32=2e-6)
    assert float(angle.max()) == 0.0  # ball joints have none
    assert float(report.penetration) < 5e-4
    assert int(report.overflow) < 0


def test_momentum_changes_by_what_the_floor_gives(fallen, tolerance):
    """Of a pair, and of a chain, that only the floor and gravity push: joints give nothing to the whole."""
    scene, start, (states, given, *_) = fallen
    mass = float(scene.bodies[0].mass[0])
    velocity = jnp.concatenate([start.velocity[None], states.velocity])
    change = mass * np.diff(np.asarray(velocity, float), axis=0) - 2e-3 * mass * np.array([0, 0, -9.81])
    for bodies in (slice(0, 2), slice(2, 12)):
        left = change[:, bodies].sum(axis=1) - np.asarray(given, float)[:, bodies].sum(axis=1)
        np.testing.assert_allclose(left, 0.0, atol=tolerance(float64=1e-12, float32=2e-6))
    assert np.asarray(given)[:, :2].sum() > 0
    assert np.asarray(given)[:, 2:].sum() > 0


def test_energy_falls_and_links_come_to_rest(fallen, tolerance):
    _, _, (states, _, _, _, energy, report) = fallen
    energy = np.asarray(energy, float)
    assert np.diff(energy).max() < tolerance(float64=1e-9, float32=2e-4)
    assert energy[-1] < 0.9 * energy[0]
    assert float(jnp.abs(states.velocity[-1]).max()) < tolerance(float64=1e-6, float32=1e-3)
    assert float(jnp.abs(states.angular_velocity[-1]).max()) < tolerance(float64=1e-4, float32=1e-1)
    # Links that jam with friction leave the law some steps without a solution; these do no work.
    assert int(report.poor) < tolerance(float64=70, float32=140)  # of 700; 36 and 73


def rolled(example, steps):
    """`distance(numbers)` [m] that the cart rolls. Numbers: moment of a wheel about its axle, load on the chassis."""
    scene, start = example.scene, example.state()

    def distance(numbers):
        chassis, wheel = scene.bodies
        heavier = rb.Body(chassis.mass * numbers["load"], chassis.inertia, chassis.shape)
        across = wheel.inertia.as_matrix()[0, 0, 0]
        moments = jnp.stack([across, across, numbers["moment"]])
        one_wheel = rb.Body(wheel.mass[0], moments, jax.tree.map(lambda leaf: leaf[0], wheel.shape))
        wheels = rb.replicate(one_wheel, 4)
        own = rb.Scene((heavier, wheels), scene.effects)

        dynamics = own.prepared(start.dtype)

        def one(carry, _):
            return METHOD.carried_step(dynamics, *carry, jnp.asarray(2e-3, start.dtype)), None

        (state, memory), _ = jax.lax.scan(one, (start, METHOD.first_carry(dynamics, start)), length=steps)
        x = state.position[0] - start.position[0]
        return jnp.sqrt(jnp.sum(x * x)), (state, memory[1].report)

    return distance


@pytest.fixture(scope="module")
def cart_numbers(dtype):
    example = cart()
    chassis, wheel = example.scene.bodies
    mass, each = float(chassis.mass), float(wheel.mass[0])
    numbers = {"moment": 0.5 * each * 0.01, "load": 1.0}
    return rolled(example, 25), jax.tree.map(lambda x: jnp.asarray(x, dtype), numbers), (mass, each)


def rolling(numbers, masses, steps=25, dt=2e-3):
    """The distance by the closed form: g sin α m/(m + 4 I/r²) for `steps` steps, each with its new velocity."""
    total = masses[0] * numbers["load"] + 4 * masses[1]
    pull = 9.81 * math.sin(math.radians(10.0)) * total / (total + 4 * numbers["moment"] / 0.01)
    return 0.5 * pull * dt * dt * steps * (steps + 1)


def test_a_cart_rolls_down_as_the_closed_form_says(cart_numbers, dtype, tolerance):
    """Distance, speed and, in float64, the gradient of the distance; wheels do not slip."""
    distance, numbers, masses = cart_numbers
    if dtype == jnp.float64:
        program = jax.value_and_grad(distance, has_aux=True)
        (found, (state, report)), slope = jax.jit(program, compiler_options=QUICK)(numbers)
        expected = jax.grad(rolling)(numbers, masses)
        for name in numbers:
            np.testing.assert_allclose(slope[name], expected[name], rtol=1e-6)
    else:
        found, (state, report) = jax.jit(distance, compiler_options=QUICK)(numbers)
    exact = rolling(numbers, masses)
    close = tolerance(float64=1e-9, float32=2e-4)
    np.testing.assert_allclose(found, exact, rtol=close)
    speed = math.sqrt(float(jnp.sum(state.velocity[0] ** 2)))
    np.testing.assert_allclose(speed, 2 * float(exact) / (26 * 2e-3), rtol=close)
    np.testing.assert_allclose(jnp.abs(state.angular_velocity[1:, 2]) * 0.1, speed, rtol=close)
    assert int(report.poor) == 0


def test_a_doll_falls_on_a_floor_and_lies_there(dtype, tolerance):
    """Joints closed, nothing lost; in float64 the derivative by the height that it falls from, finite."""
    example = doll_on_floor()
    scene = rb.Scene(example.scene.bodies, example.scene.effects[:-1])  # its limbs alone, which do not meet
    start = example.state(dtype=dtype)

    def fallen(height, steps):
        up = start.position + jnp.stack([0 * height, 0 * height, height])
        state = rb.State(up, start.orientation, start.velocity, start.angular_velocity, start.time)
        dynamics = scene.prepared(dtype)

        def one(_, carry):
            return METHOD.carried_step(dynamics, *carry, jnp.asarray(2e-3, dtype))

        state, carry = jax.lax.fori_loop(0, steps, one, (state, METHOD.first_carry(dynamics, state)))
        return state, carry[1].report

    def both(height, steps):
        if dtype == jnp.float32:  # the derivative is half of the compiling
            return fallen(height, steps), height
        return jax.jvp(lambda h: fallen(h, steps), (height,), (jnp.ones_like(height),))

    program = jax.jit(both, compiler_options=QUICK)
    height = jnp.zeros((), dtype)
    _, slope = program(height, 150)  # it stands on its legs and gives way
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(slope) if leaf.dtype == dtype)
    (state, report), _ = program(height, 2000)
    error = rb.joint_error(scene, state)
    assert float(error.gap.max()) < tolerance(float64=1e-12, float32=1e-5)
    assert float(state.position[:, 2].min()) > 0.03
    assert float(state.position[:, 2].max()) < 0.3
    assert float(jnp.abs(state.velocity).max()) < 0.05
    assert float(report.penetration) < 1e-3
    assert int(report.overflow) < 0


def test_bodies_of_a_joint_do_not_meet_unless_asked():
    """As in MuJoCo; those joined to the world, or over a third body, do."""
    ball = rb.replicate(rb.Body.from_shape(rb.Sphere(0.1), 1000.0), 3)
    joints = (
        rb.BallJoint((0.1, 0, 0), (-0.1, 0, 0), bodies=((0, 1), (1, 2))),
        rb.BallJoint(bodies=(2, None)),
    )

    def pairs(**options):
        scene = rb.Scene(ball, (*joints, rb.RigidContact(**options)))
        contact = scene.prepared(np.float32).contact
        return {pair for m in contact.meetings for pair in zip(m.first.tolist(), m.second.tolist())}

    assert pairs() == {(0, 2)}
    assert pairs(joined=True) == {(0, 1), (0, 2), (1, 2)}


def test_what_does_not_know_joints_says_so():
    ball = rb.replicate(rb.Body.from_shape(rb.Sphere(0.1), 1000.0), 2)
    joint = rb.BallJoint((0.2, 0, 0), bodies=(0, None))
    crowd = rb.Scene(ball, (joint, rb.RigidContact(solver="sparse")))
    with pytest.raises(rb.WrongStructure, match=r"sparse solve of a crowd does not know joints.*newton"):
        crowd.prepared(np.float32)
    scene = rb.Scene(ball, (joint, rb.RigidContact(rb.HalfSpace(offset=-9.0))))
    state = scene.state(position=[(-0.2, 0, 0), (5.0, 0, 0)])
    with pytest.raises(rb.WrongStructure, match=r"solve_events"):
        rb.solve_events(scene, state, t1=1.0)
    with pytest.raises(rb.WrongStructure, match=r"solve_contact.*joints"):
        rb.solve_contact(scene, state, t1=1.0)
