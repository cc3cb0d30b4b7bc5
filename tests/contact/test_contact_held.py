"""Rigid contact of bodies that are fixed, guided or driven: what holds them takes what they cannot follow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb

G = 9.81
METHOD = rb.SemiImplicitEuler()
BALL = rb.Body.from_shape(rb.Sphere(0.1), 300.0, name="ball")
SLAB = rb.Body.from_shape(rb.Box((2.0, 0.5, 0.05)), 500.0, name="slab")
CUBE = rb.Body.from_shape(rb.Box((0.1, 0.1, 0.1)), 500.0, name="cube")
DOWN = rb.UniformGravity((0.0, 0.0, -G))


def run(scene, state, dt, steps, save_every=None, method=METHOD):
    return rb.rollout(scene, state, dt=dt, steps=steps, save_every=save_every or steps, method=method)


def test_a_fixed_body_is_what_stands_still(dtype, tolerance):
    """A cube thrown on a fixed slab that is turned, beside the same slab as an obstacle."""
    turn = rb.Quaternion.from_axis_angle((0, 1.0, 0), 0.1)
    rules = {"friction": 0.3, "restitution": 0.4}
    throw = {"velocity": (0.7, 0.1, 0.0), "angular_velocity": (0.5, -2.0, 1.0)}
    alone = rb.Scene(CUBE, (DOWN, rb.RigidContact((SLAB.shape, rb.Pose((0.0, 0, 0), turn)), **rules)))
    path = run(alone, alone.state((-1.0, 0, 0.5), dtype=dtype, **throw), 1e-3, 400, 40)
    # Its mass is no part of it: light as a feather, it stands.
    still = rb.Body(1e-3, (1e-4, 1e-4, 1e-4), SLAB.shape).fixed()
    both = rb.Scene((still, CUBE), (DOWN, rb.RigidContact(**rules)))
    wxyz = np.stack([turn.as_quaternion_array(), [1.0, 0, 0, 0]])
    start = both.state(
        [[0, 0, 0], [-1.0, 0, 0.5]], wxyz, *([[0, 0, 0], value] for value in throw.values()), dtype=dtype
    )
    other = run(both, start, 1e-3, 400, 40)
    assert int(path.contact.points.max()) > 0
    assert int(other.contact.poor.max()) == 0
    moved = np.abs(np.asarray(other.states.position[:, 1]) - np.asarray(path.states.position[:, 0]))
    assert moved.max() < tolerance(float64=1e-9, float32=2e-3)
    np.testing.assert_array_equal(other.states.position[:, 0], 0.0)
    np.testing.assert_array_equal(other.states.velocity[:, 0], 0.0)
    np.testing.assert_array_equal(other.states.angular_velocity[:, 0], 0.0)


def test_what_stands_still_never_meets_what_stands_still():
    contact = rb.Scene((BALL.fixed(), BALL.fixed(), BALL), rb.RigidContact()).prepared(jnp.float32).contact
    (meeting,) = contact.meetings
    assert sorted(zip(meeting.first.tolist(), meeting.second.tolist(), strict=True)) == [(0, 2), (1, 2)]
    floor = rb.RigidContact(rb.HalfSpace())
    (obstacle,) = rb.Scene((BALL.fixed(), BALL), floor).prepared(jnp.float32).contact.obstacles
    assert obstacle.members == (1,)
    assert rb.Scene(BALL.fixed(), floor).prepared(jnp.float32).contact is None


def blow(e, offset, speed):
    """A ball that hits a bead on a guide along x, `offset` beside its middle; both momenta and energies."""
    bead = rb.Body(2.0, (1e-2, 1e-2, 1e-2), rb.Sphere(0.1)).restricted("x", "")
    scene = rb.Scene((bead, BALL), rb.RigidContact(restitution=e))
    position = jnp.stack([jnp.zeros(3), jnp.stack([-jnp.sqrt(0.04 - offset**2) - 1e-5, offset, 0.0 * e])])
    state = scene.state(position, velocity=jnp.stack([jnp.zeros(3), jnp.stack([speed, 0.0 * e, 0.0 * e])]))
    return run(scene, state, 2e-5, 4).final


def test_a_bead_on_a_guide_is_struck_as_the_closed_form_says(dtype, tolerance):
    """Along the normal n = (c, s): v_n of the bead is c u, and the impulse p solves p (1/m + c²/M) = (1 + e) v c."""
    e, offset, speed = jnp.asarray(
        [[0.0, 0.4, 1.0, 0.7], [0.0, 0.05, 0.1, 0.17], [1.0, 2.0, 1.5, 3.0]], dtype
    )
    final = jax.jit(jax.vmap(blow), compiler_options=QUICK)(e, offset, speed)
    sine = np.asarray(offset) / 0.2
    cosine, mass = np.sqrt(1 - sine**2), float(BALL.mass)
    p = (1 + np.asarray(e)) * np.asarray(speed) * cosine / (1 / mass + cosine**2 / 2.0)
    scale = {"atol": 3e-4}  # the way to the impact turns the normal so far
    np.testing.assert_allclose(final.velocity[:, 0, 0], cosine * p / 2.0, **scale)
    np.testing.assert_allclose(final.velocity[:, 1, 0], np.asarray(speed) - cosine * p / mass, **scale)
    np.testing.assert_allclose(final.velocity[:, 1, 1], sine * p / mass, **scale)
    np.testing.assert_array_equal(final.velocity[:, 0, 1:], 0.0)
    np.testing.assert_array_equal(final.angular_velocity[:, 0], 0.0)


def test_a_flap_on_an_axle_is_struck_as_the_closed_form_says(dtype, tolerance):
    """I ω = p r and p (1/m + r²/I) = (1 + e) v, at r from the axle."""
    flap = SLAB.restricted("", "y")
    scene = rb.Scene((flap, BALL), rb.RigidContact(restitution=0.6))
    r, speed = 1.3, 2.0
    state = scene.state([[0, 0, 0], [r, 0, 0.15 + 1e-5]], velocity=[[0, 0, 0], [0, 0, -speed]], dtype=dtype)
    final = run(scene, state, 2e-5, 2).final
    inertia, mass = float(SLAB.inertia.as_matrix()[1, 1]), float(BALL.mass)
    p = 1.6 * speed / (1 / mass + r * r / inertia)
    np.testing.assert_allclose(
        final.angular_velocity[0], [0.0, p * r / inertia, 0.0], atol=tolerance(float64=1e-9, float32=1e-5)
    )
    np.testing.assert_allclose(
        final.velocity[1, 2], p / mass - speed, atol=tolerance(float64=1e-9, float32=1e-5)
    )
    np.testing.assert_array_equal(final.velocity[0], 0.0)
    np.testing.assert_array_equal(np.asarray(final.angular_velocity[0])[[0, 2]], 0.0)


def test_what_is_held_along_the_normal_carries_nothing(dtype):
    """A slider that overlaps a wall beside its guide: no impulse could part them, so there is none, and no NaN."""
    slider = CUBE.restricted("x", "")
    wall = rb.RigidContact(rb.HalfSpace((0, 0, 1.0)), friction=0.5)
    scene = rb.Scene((slider, CUBE.fixed()), (wall, DOWN, rb.RigidContact(friction=0.5)))
    state = scene.state([[0, 0, 0.09], [0.05, 0.19, 0.1]], velocity=[[1.0, 0, 0], [0, 0, 0]], dtype=dtype)
    path = run(scene, state, 1e-2, 20)
    assert int(path.contact.poor.max()) == 0
    assert int(path.contact.points.max()) == 0
    np.testing.assert_allclose(path.final.velocity[0], [1.0, 0.0, 0.0])


def table(time, parameters):
    """Carried off at a speed, and shaken from rest."""
    speed, size, rate = parameters
    x = speed * time + size * (1 - jnp.cos(rate * time))
    return rb.Pose(jnp.stack([x, 0.0 * time, 0.0 * time]), rb.Quaternion.identity())


RATE, SPEED = 20.0, 1.5
BELT_FRICTION, TABLE_FRICTION = 0.5, 0.4


def carried(speed, share, friction):
    """A cube on a table that moves, of whose shaking `share` is what friction can follow."""
    size = share * friction * G / RATE**2
    drive = rb.PrescribedMotion(table, jnp.stack([speed, size, RATE + 0.0 * size]), body=0)
    scene = rb.Scene((SLAB, CUBE), (drive, DOWN, rb.RigidContact(friction=friction)))
    return run(scene, scene.state([[0, 0, 0], [-1.5, 0, 0.15]], dtype=speed.dtype), 1e-3, 600, 20)


@pytest.fixture(scope="module")
def paths(dtype):
    """On a belt, on a table shaken a little less than friction can follow, and a little more."""
    cases = [[SPEED, 0.0, 0.0], [0.0, 0.97, 1.3], [BELT_FRICTION, TABLE_FRICTION, TABLE_FRICTION]]
    found = jax.jit(jax.vmap(carried), compiler_options=QUICK)(*jnp.asarray(cases, dtype))
    return jax.tree.map(np.asarray, found)


def test_a_belt_takes_a_box_along(paths, tolerance):
    """It slips for v/(μ g), and comes v²/(2 μ g) behind."""
    time, position = paths.times[0], paths.states.position[0]
    wanted = np.minimum(BELT_FRICTION * G * time, SPEED)
    np.testing.assert_allclose(
        paths.states.velocity[0, :, 1, 0], wanted, atol=1.01 * BELT_FRICTION * G * 1e-3
    )
    behind = SPEED * time[-1] - position[-1, 1, 0] - 1.5
    assert behind == pytest.approx(SPEED**2 / (2 * BELT_FRICTION * G), abs=2e-3)
    np.testing.assert_allclose(position[:, 0, 0], SPEED * time, atol=tolerance(float64=1e-12, float32=1e-6))
    spins = np.abs(paths.states.angular_velocity[0])
    assert spins.max() < tolerance(float64=1e-6, float32=2e-3)


def test_a_box_on_a_shaker_slips_from_the_acceleration_that_friction_gives(paths, tolerance):
    """It goes along, to round-off, as long as a ω² < μ g, and not beyond."""
    x = paths.states.position[1:, :, :, 0]
    little, much = np.ptp(x[:, :, 1] - x[:, :, 0], axis=1)
    assert little < tolerance(float64=1e-12, float32=1e-6)
    assert much > 1e-3


def test_planar_bodies_stay_in_their_plane_and_keep_momentum(dtype, tolerance):
    """Eight discs thrown together in z = 0, with friction and restitution: spheres, but guided."""
    side = np.linspace(-0.3, 0.3, 4)
    position = np.array([[x, y, 0.0] for x in side for y in (-0.11, 0.11)])
    rng = np.random.default_rng(3)
    velocity = np.c_[-4.0 * position[:, :2] + rng.normal(0, 0.3, (8, 2)), np.zeros(8)]
    spin = np.c_[np.zeros((8, 2)), rng.normal(0, 3.0, 8)]
    bodies = tuple(BALL.restricted("xy", "z") for _ in range(8))
    scene = rb.Scene(bodies, rb.RigidContact(friction=0.4, restitution=0.5))
    state = scene.state(position, velocity=velocity, angular_velocity=spin, dtype=dtype)
    path = run(scene, state, 2e-3, 100, 10)
    np.testing.assert_array_equal(path.states.position[..., 2], 0.0)
    np.testing.assert_array_equal(path.states.angular_velocity[..., :2], 0.0)
    momentum = np.asarray(path.states.velocity.sum(axis=1))
    np.testing.assert_allclose(
        momentum, momentum[:1].repeat(len(momentum), 0), atol=tolerance(float64=1e-12, float32=1e-5)
    )
    energy = np.asarray(jax.vmap(lambda state: rb.energy(scene, state))(path.states))
    assert np.all(np.diff(energy) <= tolerance(float64=1e-9, float32=1e-4) * energy[0])
    assert energy[-1] < 0.7 * energy[0]
    assert int(path.contact.points.max()) >= 3


BEAD = rb.Body(2.0, (1e-2, 1e-2, 1e-2), rb.Sphere(0.1))
WHEEL = rb.Body.from_shape(rb.Sphere(2.0), 100.0)


def places(x):
    """Where balls end: one slips on a great one that moves, one strikes a bead on a guide, one leaves a fixed ball."""
    friction, e, speed, mass = x
    zero = 0.0 * mass
    drive = rb.PrescribedMotion(table, jnp.stack([speed, zero, zero]), body=0)
    ball = rb.Body(mass, BALL.inertia, BALL.shape)
    bodies = (WHEEL, BEAD.restricted("x", ""), BALL.fixed(), ball, ball, ball)
    rules = rb.RigidContact(friction=friction, restitution=e)
    scene = rb.Scene(bodies, (drive, rb.UniformGravity((0.0, 0.0, -G), bodies=(3,)), rules))
    position = [[0, 0, 0], [0, 5, 0], [0, 9, 0], [0, 0, 2.099], [-0.21, 5.1, 0], [-0.21, 9.1, 0]]
    velocity = jnp.zeros((6, 3)).at[4:, 0].set(speed)
    final = run(scene, scene.state(jnp.asarray(position), velocity=velocity), 5e-3, 20).final
    return jnp.stack([final.position[3, 0], final.position[1, 0], final.position[4, 1], final.position[5, 1]])


def test_derivatives_of_held_bodies_are_those_of_differences(dtype):
    """By friction, restitution, speed and mass."""
    if dtype != jnp.float64:
        pytest.skip("differences need float64")
    at, h = jnp.asarray([0.3, 0.5, 1.3, 2.0]), 1e-5
    sides = jnp.concatenate([at + h * jnp.eye(4), at - h * jnp.eye(4)])
    ends = jax.jit(jax.vmap(places), compiler_options=QUICK)(sides)
    differences = (ends[:4] - ends[4:]).T / (2 * h)
    reverse = jax.jit(jax.jacrev(places), compiler_options=QUICK)(at)
    np.testing.assert_allclose(reverse, differences, rtol=2e-5, atol=2e-6)
    assert np.all(np.abs(differences).max(axis=0) > 1e-3)  # none of the four is without effect


def test_a_flap_hung_by_a_hinge_stops_at_a_fixed_post(dtype, tolerance):
    """A joint and a fixed body in one solve: ω⁺ = −e ω⁻."""
    post = rb.Body.from_shape(rb.Sphere(0.1), 1000.0).fixed()
    hinge = rb.Hinge((0, 0, 1.0), (-2.0, 0, 0), bodies=(1, None), anchor_b=(-2.0, 0, 0))
    scene = rb.Scene((post, SLAB), (hinge, rb.RigidContact(restitution=0.5)))
    state = scene.state(
        [[1.5, -0.6 - 1e-4, 0], [0, 0, 0]], velocity=[[0, 0, 0], [0, -2.0, 0]],
        angular_velocity=[[0, 0, 0], [0, 0, -1.0]], dtype=dtype,
    )  # fmt: skip
    path = run(scene, state, 2e-4, 3)
    np.testing.assert_allclose(
        path.final.angular_velocity[1, 2], 0.5, atol=tolerance(float64=1e-6, float32=1e-4)
    )
    np.testing.assert_array_equal(path.final.position[0], state.position[0])


def test_a_crowd_with_a_fixed_ball(dtype, tolerance):
    """The sparse solve: two balls fall on a fixed third and part; it does not move, and its mass is no part of it."""
    balls = (rb.Body(1e-4, (1e-6, 1e-6, 1e-6), BALL.shape).fixed(), BALL, BALL)
    scene = rb.Scene(balls, (DOWN, rb.RigidContact(friction=0.3, solver="sparse")))
    state = scene.state([[0, 0, 0], [0.02, 0, 0.22], [-0.02, 0, 0.45]], dtype=dtype)
    path = run(scene, state, 2e-3, 200, 10)
    np.testing.assert_array_equal(path.states.position[:, 0], 0.0)
    gap = np.linalg.norm(np.asarray(path.states.position[:, 1:] - path.states.position[:, :1]), axis=-1) - 0.2
    assert gap.min() > -2e-3
    assert int(path.contact.points.max()) > 0
    assert float(path.states.position[-1, 1, 2]) < float(path.states.position[-1, 2, 2])
