"""Bodies that cannot move freely: point masses, fixed bodies, axles, planes. What they lack is not in the program."""

import re
from collections import Counter

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.accuracy.reference import end_state
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.integrators.names import METHODS

LUMP = rb.Body(1.5, np.asarray([[1.0, 0.1, 0.2], [0.1, 1.2, 0.05], [0.2, 0.05, 1.4]]))
BRICK = rb.Body(2.0, (1.0, 2.0, 2.5))
POINT = rb.Body.point(2.0)
GRAVITY = np.asarray([0.3, 0.0, -9.0])
TORQUE = np.asarray([0.4, -0.2, 0.6])


def optimised(function, *arguments) -> str:
    """What the compiler makes of a function, without names and places of the source."""
    text = jax.jit(function).lower(*arguments).compile().as_text()
    text = text[text.index("\n\n\n") :] if "FileNames" in text else text
    return re.sub(r", metadata=\{[^}]*\}|\.\d+", "", text)


def operations(function, *arguments) -> Counter:
    lines = re.findall(r"= .*?[\]})] ([\w\-]+)\(", optimised(function, *arguments))
    moved = ("parameter", "constant", "fusion", "bitcast", "copy", "tuple")
    return Counter(kind for kind in lines if kind not in moved)


run_to = jax.jit(end_state, compiler_options=QUICK)


def step_of(scene):
    return lambda state: rb.step(scene, state, None, 1e-3)


def test_program_of_a_fixed_body_counts_the_time_and_nothing_else():
    scene = rb.Scene(LUMP.fixed(), (rb.UniformGravity(), rb.BodyThruster((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))))
    assert operations(step_of(scene), scene.state()) == Counter(add=1)
    bare = rb.Scene(LUMP.fixed())
    # Byte for byte, although the effects were asked: no number of theirs reaches a body that cannot move.
    assert optimised(step_of(scene), scene.state()) == optimised(step_of(bare), bare.state())


def test_program_of_a_point_mass_is_the_hand_written_one():
    scene = rb.Scene(POINT)

    def by_hand(state):
        position = jnp.stack([state.position[:, i] + 1e-3 * state.velocity[:, i] for i in range(3)], axis=1)
        return position, state.time + 1e-3

    assert operations(step_of(scene), scene.state()) == operations(by_hand, scene.state())


def test_inertia_of_what_does_not_turn_is_not_in_the_program():
    thrust = rb.BodyThruster((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))  # needs the orientation, and gives a torque
    texts = [
        jax.jit(step_of(scene)).lower(scene.state()).as_text()
        for scene in (rb.Scene(POINT, thrust), rb.Scene(BRICK.restricted(angular=""), thrust))
    ]
    assert texts[0] == texts[1]


def test_axle_has_no_gyroscopic_term_and_no_translation():
    free = operations(step_of(rb.Scene(LUMP)), rb.Scene(LUMP).state())
    axle = operations(step_of(rb.Scene(LUMP.restricted("", "z"))), rb.Scene(LUMP).state())
    ball = operations(step_of(rb.Scene(rb.Body(1.0, 1.0))), rb.Scene(LUMP).state())
    assert 2 * axle["multiply"] < ball["multiply"] < free["multiply"]


def test_explicitly_free_bodies_are_the_program_that_never_knew_restrictions():
    texts = [
        jax.jit(lambda s, y: rb.step(s, y)).lower(scene, scene.state()).as_text()
        for scene in (
            rb.Scene(BRICK),
            rb.Scene(BRICK.restricted()),
            rb.Scene(BRICK.fixed().restricted("xyz", "xyz")),
        )
    ]
    assert texts[0] == texts[1] == texts[2]


@pytest.fixture(scope="module")
def mixed():
    """A free brick, a point, a fixed body, one in a plane and one on an axle, under a force and a torque."""
    bodies = (BRICK, rb.Body.point(3.0), LUMP.fixed(), LUMP.restricted("xy", "z"), LUMP.restricted("", "x"))
    scene = rb.Scene(bodies, (rb.UniformGravity(GRAVITY), rb.PrescribedTorque(TORQUE)))
    state = scene.state(
        position=[(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (4, 0, 0)],
        velocity=[(1, 0, 0), (1, 2, 3), (0, 0, 0), (0.5, -1, 0), (0, 0, 0)],
        angular_velocity=[(0.1, 0.2, 0.3), (0, 0, 0), (0, 0, 0), (0, 0, 0.7), (-0.4, 0, 0)],
    )
    return scene, state


# One of each way of advancing; the others share its code.
_WAYS = (
    "SemiImplicitEuler", "VelocityVerlet", "RungeKutta4", "ImplicitMidpoint", "ThreeAxisSplitting", "MoserVeselov6"
)  # fmt: skip


@pytest.mark.parametrize("method", [*_WAYS, "compensated"])
def test_every_method_moves_each_body_as_its_freedom_allows(mixed, method, tolerance):
    """Against ½ g t² and τ t/I_aa; the free body beside them moves as it does alone."""
    scene, state = mixed
    kind = rb.RungeKutta4(compensated=True) if method == "compensated" else METHODS[method]()
    t = 0.5
    span, count = jnp.asarray(t, state.dtype), jnp.asarray(25)
    end = run_to(scene, state, kind, span, count)
    small = tolerance(float64=1e-12, float32=2e-5)
    coarse = small if kind.order > 1 else 0.11  # ½ g t dt
    start, velocity = np.asarray(state.position), np.asarray(state.velocity)
    fall = start + velocity * t + 0.5 * GRAVITY * t**2
    np.testing.assert_allclose(end.position[1], fall[1], atol=coarse)
    np.testing.assert_allclose(end.position[3], [fall[3, 0], fall[3, 1], 0.0], atol=coarse)
    for held in (2, 4):
        np.testing.assert_array_equal(end.position[held], start[held])
    np.testing.assert_allclose(end.angular_velocity[3], [0, 0, 0.7 + TORQUE[2] * t / 1.4], atol=small)
    np.testing.assert_allclose(end.angular_velocity[4], [-0.4 + TORQUE[0] * t / 1.0, 0, 0], atol=small)
    turned = end.orientation.log()
    for still in (1, 2):
        np.testing.assert_array_equal(end.angular_velocity[still], 0.0)
        np.testing.assert_array_equal(turned[still], 0.0)
    angle = 0.7 * t + 0.5 * TORQUE[2] / 1.4 * t**2
    np.testing.assert_allclose(turned[3], [0, 0, angle], atol=1e-4 if kind.order > 1 else 6e-3)
    if method in ("RungeKutta4", "MoserVeselov6"):
        alone = rb.Scene(BRICK, scene.effects)
        first = jax.tree.map(lambda leaf: leaf[:1] if jnp.ndim(leaf) else leaf, state)
        apart = run_to(alone, first, kind, span, count)
        # In company the brick's inertia is a full one: the same numbers in another order.
        np.testing.assert_allclose(end.position[0], apart.position[0], atol=small)
        np.testing.assert_allclose(end.orientation.log()[0], apart.orientation.log()[0], atol=10 * small)


@pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"), reason="their agreement shows below float32's round-off"
)
def test_error_controlled_and_smooth_solvers_agree_with_steps(mixed):
    scene, state = mixed
    end = run_to(scene, state, rb.RungeKutta4(), jnp.asarray(0.5, state.dtype), jnp.asarray(25))
    others = [rb.solve(scene, state, t1=0.5, solver=diffrax.Tsit5(), rtol=1e-6, atol=1e-6).final]
    others.append(rb.solve_smooth(scene, state, t1=0.5, steps=100, order=6).final)
    for other in others:
        for mine, theirs in zip(jax.tree.leaves(end), jax.tree.leaves(other), strict=True):
            np.testing.assert_allclose(mine, theirs, atol=2e-6)


def test_free_flight_of_restricted_bodies(mixed, tolerance):
    scene = rb.Scene(mixed[0].bodies)
    state = mixed[1]
    end = rb.free_flight(scene, state, 2.0)
    small = tolerance(float64=1e-13, float32=1e-5)
    np.testing.assert_allclose(end.position, state.position + 2.0 * state.velocity, atol=small)
    np.testing.assert_allclose(end.orientation.log()[3], [0, 0, 1.4], atol=small)
    np.testing.assert_allclose(end.orientation.log()[1], 0.0, atol=small)
    stepped = run_to(scene, state, rb.MoserVeselov4(), jnp.asarray(2.0, state.dtype), jnp.asarray(200))
    np.testing.assert_allclose(
        end.orientation.log(), stepped.orientation.log(), atol=tolerance(float64=1e-8, float32=2e-5)
    )


SWINGS = {
    "quaternion": (rb.Quaternion, rb.RungeKutta4()),
    "Euler angles": (rb.EulerAngles, rb.RungeKutta4()),
    "compensated": (rb.Quaternion, rb.RungeKutta4(compensated=True)),
    "matrix": (rb.RotationMatrix, rb.VelocityVerlet()),
    "midpoint": (rb.Quaternion, rb.ImplicitMidpoint()),
    "splitting": (rb.RotationMatrix, rb.ThreeAxisSplitting4()),
    "finite rotation": (rb.Quaternion, rb.SemiImplicitEuler(finite_rotation=True)),
}


@pytest.mark.parametrize("case", SWINGS)
def test_body_on_an_axle_swings_with_its_moment_about_it(case, tolerance):
    """I_aa θ̈ = −k θ whatever the products of inertia: the bearing takes the rest. The energy is kept."""
    rotation, method = SWINGS[case]
    scene = rb.Scene(LUMP.restricted("", "y"), rb.AngularSpring(2.0))
    state = scene.state(angular_velocity=(0.0, 0.9, 0.0), rotation=rotation)
    end = run_to(scene, state, method, jnp.asarray(2.0, state.dtype), jnp.asarray(100))
    rate = np.sqrt(2.0 / 1.2)
    error = {1: 2e-2, 2: 2e-4}.get(method.order, tolerance(float64=1e-7, float32=1e-5))
    expected = 0.9 / rate * np.sin(rate * 2.0)
    angle = end.orientation.log()[0]
    assert float(angle[1]) == pytest.approx(expected, abs=error)
    np.testing.assert_allclose(angle[::2], 0.0, atol=tolerance(float64=1e-15, float32=1e-6))
    assert float(rb.energy(scene, end)) == pytest.approx(0.5 * 1.2 * 0.81, rel=3 * error)
    # A compensated sum is projected to the square of a step's drift only.
    exact = tolerance(float64=1e-10 if case == "compensated" else 1e-14, float32=1e-6)
    assert float(jnp.max(jnp.abs(end.orientation.drift().scale))) < exact


def test_one_angle_turns_exactly_at_a_constant_rate(tolerance):
    """A free body in a plane: two coordinates and an angle, no error but round-off at any step."""
    scene = rb.Scene(BRICK.restricted("xy", "z"))
    state = scene.state(velocity=(1.0, 2.0, 0.0), angular_velocity=(0.0, 0.0, 3.0))
    end = run_to(scene, state, rb.RungeKutta4(), jnp.asarray(5.0, state.dtype), jnp.asarray(10))
    small = tolerance(float64=1e-13, float32=1e-5)
    np.testing.assert_allclose(end.position[0], [5.0, 10.0, 0.0], atol=small)
    exact = rb.Quaternion.exp(jnp.asarray([0.0, 0.0, 15.0]))
    assert float(exact.angle_to(rb.Quaternion(end.orientation.wxyz[0]))) < small


@pytest.mark.parametrize("rotation", [rb.Quaternion, rb.RotationMatrix])
def test_a_long_spin_keeps_its_digits_however_it_is_saved(dtype, tolerance, rotation, tmp_path):
    """A run carries the angle, without whole double turns, from state to state and through files."""
    scene = rb.Scene(BRICK.restricted("xy", "z"), rb.UniformGravity((0.3, 0.0, 0.0)))
    start = rb.Quaternion.exp(jnp.asarray([[0.4, -0.9, 0.2]], dtype))
    state = scene.state(orientation=start, angular_velocity=(0, 0, 97.0), rotation=rotation, dtype=dtype)
    settings = {"dt": 2.0**-10, "steps": 20000}
    often, seldom = (rb.rollout(scene, state, **settings, save_every=n) for n in (2500, 20000))
    turned = start @ rb.Quaternion.exp(
        jnp.asarray([[0.0, 0.0, np.remainder(97.0 * 20000 / 1024, 4 * np.pi)]], dtype)
    )
    wanted = rotation.from_rotation(turned)
    assert float(often.final.orientation.angle_to(wanted)[0]) <= (5e-4 if dtype == np.float32 else 1e-10)
    kept = {"save_every": 2500, "chunk": 1700, "checkpoint": tmp_path / "run.npz"}
    whole = rb.run(scene, state, **settings, save_every=2500)
    rb.run(scene, state, dt=settings["dt"], steps=9000, **kept)
    resumed = rb.run(scene, state, **settings, **kept, resume=True)
    jax.tree.map(np.testing.assert_array_equal, whole.states, resumed.states)
    # Programs differ in how they round where the angle becomes a rotation again.
    for other in (seldom.final, resumed.final, jax.tree.map(lambda leaf: leaf[-1], often.states)):
        for a, b in zip(jax.tree.leaves(often.final), jax.tree.leaves(other), strict=True):
            np.testing.assert_allclose(a, b, rtol=8 * np.finfo(dtype).eps, atol=4 * np.finfo(dtype).eps)


def test_energy_and_momentum_of_points_and_fixed_bodies(dtype):
    scene = rb.Scene((POINT, LUMP.fixed()), rb.UniformGravity((0.0, 0.0, -10.0)))
    state = scene.state(position=[(0, 0, 1), (0, 0, 3)], velocity=[(1, 2, 0), (0, 0, 0)], dtype=dtype)
    assert float(rb.energy(scene, state)) == pytest.approx(0.5 * 2.0 * 5.0 + 20.0 + 45.0)
    np.testing.assert_allclose(rb.momentum(scene, state), [2.0, 4.0, 0.0])
    np.testing.assert_allclose(rb.angular_momentum(scene, state), [-4.0, 2.0, 0.0])


def test_a_fixed_sun_attracts_and_stays(tolerance):
    scene = rb.Scene((rb.Body.point(4.0).fixed(), rb.Body.point(1e-3)), rb.MutualGravity(1.0))
    state = scene.state(position=[(0, 0, 0), (1, 0, 0)], velocity=[(0, 0, 0), (0, 2, 0)])
    path = rb.rollout(scene, state, dt=np.pi / 400, steps=400, save_every=400)
    np.testing.assert_allclose(
        path.final.position, state.position, atol=tolerance(float64=1e-7, float32=1e-5)
    )


def test_derivatives_of_restricted_bodies(tolerance):
    """Of the angle τ t²/2I_zz with respect to the inertia, and of a fall with respect to a point's mass: none."""

    def end(six, mass):
        scene = rb.Scene(
            (rb.Body(1.0, rb.FullInertia(six)).restricted("xy", "z"), rb.Body.point(mass)),
            (rb.UniformGravity(), rb.PrescribedTorque((0.1, 0.2, 0.6))),
        )
        final = rb.rollout(scene, scene.state(), dt=0.1, steps=5).final
        return final.orientation.log()[0, 2], final.position[1, 2]

    six = jnp.asarray([1.0, 1.2, 1.4, 0.1, 0.2, 0.05])
    jacobian = jax.jit(jax.jacrev(end, argnums=(0, 1)), compiler_options=QUICK)
    (to_six, _), (_, to_mass) = jacobian(six, jnp.asarray(3.0))
    expected = np.zeros(6)
    expected[2] = -0.5 * 0.6 * 0.25 / 1.4**2
    np.testing.assert_allclose(to_six, expected, atol=tolerance(float64=1e-6, float32=1e-5))
    np.testing.assert_allclose(to_mass, 0.0, atol=tolerance(float64=1e-15, float32=1e-6))


def test_worlds_and_crowds_of_points_are_vmapped_as_any_other(dtype):
    crowd = rb.Scene(rb.replicate(POINT, 3), rb.UniformGravity())
    assert crowd.count == 3
    speeds = jnp.arange(4.0, dtype=dtype)
    ends = jax.vmap(lambda v: rb.step(crowd, crowd.state(velocity=v * jnp.ones(3, dtype)), None, 0.1))(speeds)
    assert ends.position.shape == (4, 3, 3)


BALL = rb.Body.from_shape(rb.Sphere(0.1), 1.0)
FIXED = rb.Scene((BALL, BALL.fixed()), rb.RigidContact())
REFUSED = {
    "unknown axis": (lambda: BRICK.restricted("xw"), WrongStructure, r"Freedom\.linear: 'xw'"),
    "two bearings": (lambda: BRICK.restricted("", "xy"), WrongStructure, r"Freedom\.angular: 'xy'; give 'xyz'"),
    "point that turns": (lambda: POINT.restricted("xy", "z"), WrongStructure, "no inertia to turn with"),
    "point without mass": (lambda: rb.Body.point(0.0), InvalidInput, r"Body\.mass is .*0\.0.* kg, but must"),
    "impacts of a fixed body": (
        lambda: rb.solve_events(FIXED, FIXED.state(), t1=1.0, max_events=4),
        WrongStructure,
        r"solve_events: RigidContact of body 1, which is fixed: .*use rb\.rollout, .*RigidContact\(against=…\)",
    ),
    "held and restricted": (
        lambda: rb.Scene(BRICK.restricted("xy", "z"), rb.FixedPoint((0, 0, 1))).state(),
        WrongStructure,
        "FixedPoint: body 0 moves along xy and turns about its z axis",
    ),
    "fixed body that moves": (
        lambda: rb.Scene((BRICK, BRICK.fixed())).state(velocity=[(1, 0, 0), (0, 1, 0)]),
        InvalidInput,
        r"state\.velocity of body 1 is \[0\.0, 1\.0, 0\.0\] m/s, but the body is fixed: its component 1 must be zero",
    ),
    "point that spins": (
        lambda: rb.Scene(POINT).state(angular_velocity=(0, 0, 1)),
        InvalidInput,
        r"state\.angular_velocity of body 0 .*does not turn",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_restricted_bodies_cannot_do_is_refused(case):
    make, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        make()
