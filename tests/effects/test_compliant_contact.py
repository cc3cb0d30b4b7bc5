"""Compliant contact: its law, what it keeps and spends, bounces and slides against closed forms."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from rotation_samples import QUICK, largest, unit_vectors

import jaxrb as rb
from jaxrb.body.diagnostics import kinetic_energy
from jaxrb.errors import InvalidInput, JaxrbWarning, WrongStructure
from jaxrb.integrators.method import rates

FLOOR = rb.HalfSpace()
BALL = rb.Body.from_shape(rb.Sphere(0.1), density=1000.0)
MASS = float(BALL.mass)
LAW = rb.CompliantContact(FLOOR, stiffness=1e5, exponent=1.5, dissipation=0.3, friction=0.5, slip_speed=0.01)


def test_normal_force_is_that_of_hunt_and_crossley(tolerance):
    depth, speed = np.meshgrid([1e-4, 1e-2], [-0.5, 0.0, 2.0])
    expected = 1e5 * depth**1.5 * (1.0 + 0.45 * speed)
    found = LAW.normal_force(jnp.asarray(depth), jnp.asarray(speed))
    np.testing.assert_allclose(found, expected, rtol=tolerance(float64=1e-14, float32=1e-5))


def test_contact_never_pulls_and_does_nothing_apart():
    depth = jnp.asarray([1e-2, 1e-2, 0.0, -1e-3, -10.0])
    leaving = jnp.asarray([-2.3, -50.0, 3.0, 3.0, -3.0])
    force = LAW.normal_force(depth, leaving)
    assert (np.asarray(force) == 0.0).all()
    assert (np.asarray(LAW.stored_energy(depth))[2:] == 0.0).all()


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
def test_derivatives_of_the_force_are_finite_at_touch_and_right_beyond(exponent, dtype, tolerance):
    law = rb.CompliantContact(FLOOR, stiffness=1e5, exponent=exponent, dissipation=0.3)

    def force(depth, speed, k, n):
        own = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), law)
        own = rb.CompliantContact(FLOOR, stiffness=k, exponent=n, dissipation=own.dissipation)
        return own.normal_force(depth, speed)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def all_of(*numbers):
        first = jax.grad(force, argnums=(0, 1, 2, 3))(*numbers)
        return force(*numbers), first, jax.hessian(force, argnums=(0, 1, 3))(*numbers)

    given = [jnp.asarray(x, dtype) for x in (0.5, 1e5, exponent)]
    for depth in (0.0, -1.0):
        found = jax.tree.leaves(all_of(jnp.asarray(depth, dtype), *given))
        assert all(float(leaf) == 0.0 for leaf in found)
    value, (by_depth, by_speed, by_k, by_n), second = all_of(jnp.asarray(4e-3, dtype), *given)
    near = {"rel": tolerance(float64=1e-12, float32=1e-4)}
    assert float(by_depth) == pytest.approx(float(value) * exponent / 4e-3, **near)
    assert float(by_speed) == pytest.approx(1e5 * 4e-3**exponent * 0.45, **near)
    assert float(by_k) == pytest.approx(float(value) / 1e5, **near)
    assert float(by_n) == pytest.approx(float(value) * np.log(4e-3), **near)
    bent = float(value) * exponent * (exponent - 1.0) / 4e-3**2
    assert float(second[0][0]) == pytest.approx(bent, rel=near["rel"], abs=1e-6 * float(value) / 4e-3**2)


def test_friction_is_smooth_at_rest_and_coulombs_when_sliding(dtype, tolerance):
    still = jnp.zeros(3, dtype)
    pressing = jnp.asarray(20.0, dtype)
    law = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), LAW)

    def friction(v):
        return law.friction_force(pressing, v)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def derivatives(v):
        return friction(v), jax.jacrev(friction)(v), jax.jacfwd(jax.jacrev(friction))(v)

    value, slope, bend = derivatives(still)
    assert (np.asarray(value) == 0.0).all()
    np.testing.assert_allclose(slope, -0.5 * 20.0 / 0.01 * np.eye(3), rtol=1e-6)
    np.testing.assert_allclose(bend, np.zeros((3, 3, 3)), atol=1e-6)
    sliding = jnp.asarray([3.0, -4.0, 0.0], dtype)
    expected = -10.0 * np.asarray([0.6, -0.8, 0.0]) / np.sqrt(1.0 + 0.002**2)
    np.testing.assert_allclose(friction(sliding), expected, rtol=tolerance(float64=1e-14, float32=1e-6))


# Shapes on a floor, and pairs, each with overlap at the start; the second shape comes on top of the first.
BRICK = rb.Box((0.1, 0.07, 0.05))
STANDING = {
    "sphere": rb.Sphere(0.1),
    "box": BRICK,
    "cylinder": rb.Cylinder(0.08, 0.05),
}
PAIRS = {
    "two spheres": (rb.Sphere(0.1), rb.Sphere(0.07), 0.168),
    "sphere on a box": (BRICK, rb.Sphere(0.07), 0.119),
}


def power(scene, state):
    """Rate of change of the energy, by the derivative of the energy along the motion, [W]."""
    dynamics = scene.prepared(state.dtype)

    def total(state):
        kinetic = jnp.sum(kinetic_energy(dynamics.bodies, state))
        return kinetic + sum(e.potential_energy_of(dynamics.bodies, state) for e in dynamics.effects)

    rate = rates(state, dynamics.acceleration(state))
    along = rb.State(
        rate.position, rate.orientation, rate.velocity, rate.angular_velocity, jnp.ones_like(state.time)
    )
    return jax.jvp(total, (state,), (along,))


def turned(seed, count, scale):
    axis = unit_vectors(count, seed)
    return rb.Quaternion.exp(jnp.asarray(scale * axis))


@pytest.mark.parametrize("name", [*STANDING, *PAIRS])
def test_spring_gives_back_what_it_takes_and_the_rest_is_spent(name, tolerance):
    """dE/dt is zero for the elastic law at any state, and minus a sum of losses with dissipation and friction."""
    if name in STANDING:
        bodies, place, against = rb.Body.from_shape(STANDING[name], 800.0), [(0.3, 0.1, 0.0)], FLOOR
    else:
        lower, upper, height = PAIRS[name]
        bodies = tuple(rb.Body.from_shape(shape, 800.0) for shape in (lower, upper))
        place, against = [(0.3, 0.1, 0.0), (0.31, 0.08, height)], None
    count = len(place)
    elastic = rb.CompliantContact(against, stiffness=1e5)
    lossy = rb.CompliantContact(against, stiffness=1e5, dissipation=0.2, friction=0.5, slip_speed=0.01)
    tilt = 0.6 if name in STANDING else 0.02

    @functools.partial(jax.jit, compiler_options=QUICK)
    def of(position, orientation, velocity, omega):
        found = []
        for law in (elastic, lossy):
            scene = rb.Scene(bodies, law)
            state = rb.State(position, orientation, velocity, omega, jnp.zeros((), position.dtype))
            found.append(power(scene, state))
        return found

    draw = np.random.default_rng(1)
    for seed in range(3):
        velocity, omega = draw.normal(size=(2, count, 3))
        orientation = turned(seed, count, tilt)
        if name in STANDING:
            place = [(0.3, 0.1, reach_down(STANDING[name], orientation) - 0.004)]
        (energy, change), (same, spent) = of(
            jnp.asarray(place),
            orientation,
            0.3 * jnp.asarray(velocity),
            jnp.asarray(2.0 * omega),
        )
        stored = float(energy) - float(
            jnp.sum(kinetic_energy(rb.Scene(bodies).stacked(), _motion(velocity, omega)))
        )
        assert stored > 1e-4  # they do touch
        assert float(energy) == pytest.approx(float(same))
        assert abs(float(change)) < tolerance(float64=1e-11, float32=2e-3) * float(energy)
        assert float(spent) < -1e-2 * stored


def reach_down(shape, orientation):
    """How far below its centre a shape reaches [m]."""
    down = jnp.asarray([[0.0, 0.0, -1.0]])
    return -float(orientation.rotate(shape.farthest(orientation.unrotate(down)))[0, 2])


def _motion(velocity, omega):
    count = len(velocity)
    identity = rb.Quaternion(jnp.asarray(count * [[1.0, 0.0, 0.0, 0.0]]))
    return rb.State(
        jnp.zeros((count, 3)), identity, jnp.asarray(0.3 * velocity), jnp.asarray(2.0 * omega), 0.0
    )


@pytest.fixture(scope="module")
def bounces():
    """Speeds after head-on bounces of a ball, for laws of three exponents, three dissipations and two speeds."""
    cases = np.array([(n, c, u) for n in (1.0, 1.5, 2.0) for c in (0.0, 0.1, 0.6) for u in (0.5, 2.0)])
    # So stiff that each lasts about as long: half a period of the linear spring, 12 ms.
    stiffness = np.array([MASS * (np.pi / 0.012) ** 2 * 0.01 ** (1.0 - n) for n in cases[:, 0]])

    @jax.jit
    def bounce(case, k):
        law = rb.CompliantContact(FLOOR, stiffness=k, exponent=case[0], dissipation=case[1])
        scene = rb.Scene(BALL, law)
        start = scene.state(position=(0, 0, 0.1), velocity=jnp.stack([0 * case[2], 0 * case[2], -case[2]]))
        return rb.rollout(scene, start, dt=2.5e-5, steps=1600, save_every=1600).final

    final = jax.vmap(bounce)(jnp.asarray(cases), jnp.asarray(stiffness))
    return cases, np.asarray(final.position[:, 0, 2], float), np.asarray(final.velocity[:, 0, 2], float)


def test_bounce_has_the_restitution_of_the_law(bounces, tolerance):
    """m v dv = −k δⁿ (1 + a v) dδ, a = 3c/2, is separable: a u (1 + e) = log((1 + a u)/(1 − a e u)) for any k, n, m."""
    cases, height, after = bounces
    assert (height > 0.1).all()
    # A linear spring begins with a kink; a step across it errs by its square.
    near = tolerance(float64=3e-6, float32=2e-4)
    for (_, c, u), v in zip(cases, after, strict=True):
        low, high = 0.0, 1.0
        a = 1.5 * c
        for _ in range(60):
            e = 0.5 * (low + high)
            low, high = (e, high) if a * u * (1 + e) > np.log((1 + a * u) / (1 - a * e * u)) else (low, e)
        expected = 1.0 if c == 0 else low
        assert v / u == pytest.approx(expected, abs=near)


def test_slow_bounces_lose_as_much_as_the_paper_says(bounces):
    """e ≈ 1 − c u: Hunt and Crossley's own relation, to first order in c u."""
    cases, _, after = bounces
    for (_, c, u), v in zip(cases, after, strict=True):
        assert v / u == pytest.approx(1.0 - c * u, abs=(c * u) ** 2 + 2e-4)


def held(friction, slip, against=FLOOR):
    """A ball too heavy to turn, at rest on the floor where its spring carries it: a sliding block in closed form."""
    body = rb.Body(2.0, 1e8, rb.Sphere(0.1))
    law = rb.CompliantContact(against, stiffness=1e5, exponent=1.0, friction=friction, slip_speed=slip)
    return rb.Scene(body, (rb.UniformGravity((0.0, 0.0, -10.0)), law)), 2.0 * 10.0 / 1e5


def test_block_slides_to_its_end_in_closed_form(tolerance):
    """v̇ = −μ g v/√(v² + s²): from speed u it comes to rest after (u √(u² + s²) + s² asinh(u/s))/(2 μ g)."""
    mu, slip, u = 0.5, 0.02, 0.6
    scene, depth = held(mu, slip)
    start = scene.state(position=(0.0, 0.0, 0.1 - depth), velocity=(0.6 * u, 0.8 * u, 0.0))
    path = rb.rollout(scene, start, dt=2e-4, steps=1200, save_every=1200)
    distance = (u * np.hypot(u, slip) + slip**2 * np.arcsinh(u / slip)) / (2 * mu * 10.0)
    found = np.asarray(path.final.position[0], float)
    expected = [0.6 * distance, 0.8 * distance, 0.1 - depth]
    np.testing.assert_allclose(found, expected, atol=tolerance(float64=1e-8, float32=1e-5))
    assert largest(path.final.velocity) < tolerance(float64=1e-9, float32=1e-5)


def test_ball_rolls_and_spins_to_rest_in_closed_form(tolerance):
    """v̇ = −5/7 g b/r of a solid ball that rolls; ω̇ = −5/2 g b/r² about the vertical; and their derivatives by b."""
    radius, gravity, duration, roll, spin = 0.1, 10.0, 0.25, 0.004, 0.002
    ball = rb.Body.from_shape(rb.Sphere(radius), 500.0)
    depth = float(ball.mass) * gravity / 1e5
    lever = radius - depth / 2  # the point is in the middle of the overlap

    @jax.jit
    def end(roll, spin):
        law = rb.CompliantContact(
            FLOOR,
            stiffness=1e5,
            exponent=1.0,
            friction=0.5,
            rolling_resistance=roll,
            spinning_resistance=spin,
        )
        scene = rb.Scene(ball, (rb.UniformGravity((0.0, 0.0, -gravity)), law))
        rolling = {"velocity": (1.0, 0.0, 0.0), "angular_velocity": (0.0, 1.0 / lever, 20.0)}
        state = scene.state((0.0, 0.0, radius - depth), **rolling)
        final = rb.rollout(scene, state, dt=1e-4, steps=2500, save_every=2500).final
        return final.velocity[0, 0], final.orientation.rotate(final.angular_velocity)[0, 2]

    lengths = (jnp.asarray(roll), jnp.asarray(spin))
    (speed, turn), (speed_rate, turn_rate) = jax.jvp(end, lengths, (jnp.ones(()), jnp.ones(())))
    slower = gravity / (lever + 0.4 * radius**2 / lever) * duration
    slower_turn = 5 / 2 * gravity / radius**2 * duration
    exact = tolerance(float64=1e-4, float32=1e-3)
    assert abs(float(speed) - (1.0 - slower * roll)) < exact
    assert abs(float(turn) - (20.0 - slower_turn * spin)) < 20 * exact
    assert abs(float(speed_rate) + slower) < 10 * exact * slower
    assert abs(float(turn_rate) + slower_turn) < 10 * exact * slower_turn


def test_block_creeps_down_a_slope_that_would_hold_it(tolerance):
    """tan α = μ v/√(v² + s²) at the end: v = s tan α/√(μ² − tan² α)."""
    alpha, mu, slip = np.deg2rad(15.0), 0.5, 0.02
    normal = np.array([np.sin(alpha), 0.0, np.cos(alpha)])
    scene, depth = held(mu, slip, rb.HalfSpace(normal))
    start = scene.state(position=(normal * (0.1 - depth * np.cos(alpha))).tolist())
    final = rb.rollout(scene, start, dt=2e-4, steps=600, save_every=600).final
    speed = slip * np.tan(alpha) / np.sqrt(mu**2 - np.tan(alpha) ** 2)
    down = speed * np.array([np.cos(alpha), 0.0, -np.sin(alpha)])
    np.testing.assert_allclose(
        np.asarray(final.velocity[0], float), down, atol=tolerance(float64=1e-9, float32=1e-5)
    )


@pytest.fixture(scope="module")
def collision():
    """Two spinning balls of unlike size that meet off centre, with everything the law has."""
    law = rb.CompliantContact(
        stiffness=2e5, dissipation=0.1, friction=0.4, slip_speed=0.01, rolling_resistance=1e-3,
        spinning_resistance=5e-4, turn_speed=0.1,
    )  # fmt: skip
    bodies = (BALL, rb.Body.from_shape(rb.Sphere(0.06), 3000.0))
    scene = rb.Scene(bodies, law)
    state = scene.state(
        [(0.0, 0, 0), (0.2, 0.05, 0.02)],
        velocity=[(1.0, 0.2, 0), (-1.0, 0, 0)],
        angular_velocity=[(0, 0, 5.0), (3.0, 0, 0)],
    )
    return scene, state, rb.rollout(scene, state, dt=5e-5, steps=1000, save_every=50)


def test_bodies_keep_momentum_and_angular_momentum_and_lose_energy(collision, tolerance):
    _, _, path = collision
    kept = path.diagnostics
    assert largest(kept.momentum - kept.momentum[0]) < tolerance(float64=1e-13, float32=2e-5)
    assert largest(kept.angular_momentum - kept.angular_momentum[0]) < tolerance(float64=1e-9, float32=2e-5)
    energy = np.asarray(kept.energy, float)
    assert np.diff(energy).max() < tolerance(float64=1e-9, float32=1e-5)
    assert energy[-1] < 0.95 * energy[0]
    assert (
        largest(path.final.angular_velocity - path.states.angular_velocity[0]) > 0.1
    )  # friction did its part


@pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"),
    reason="three ways to one answer are told apart by digits of float64",
)
def test_solvers_and_methods_and_representations_agree():
    """One bounce of a spinning ball with friction, by diffrax, by symplectic Euler, by matrices."""
    scene = rb.Scene(BALL, LAW)
    start = ((0.0, 0.0, 0.101), None, (0.5, 0.0, -1.0), (0.0, 20.0, 0.0))
    found = rb.rollout(scene, scene.state(*start), dt=1e-4, steps=500, save_every=500).final
    assert float(found.velocity[0, 2]) > 0.5
    solver = {"solver": diffrax.Tsit5(), "rtol": 1e-9, "atol": 1e-8}
    solved = rb.solve(scene, scene.state(*start), t1=0.05, **solver).final
    other = rb.rollout(
        scene, scene.state(*start, rotation=rb.RotationMatrix), dt=1e-4, steps=500, save_every=500,
        method=rb.SemiImplicitEuler(),
    ).final  # fmt: skip
    for final, near in ((solved, 1e-5), (other, 1e-2)):
        assert largest(final.velocity - found.velocity) < near
        assert largest(final.angular_velocity - found.angular_velocity) < 10 * near


def test_gradients_of_a_run_with_contact_are_those_of_differences(tolerance, dtype):
    """Through a bounce with spin and friction, with respect to every number; and finite from a start just at touch."""

    def end(law, position, velocity):
        scene = rb.Scene(BALL, (rb.UniformGravity(), law))
        start = scene.state(position=position, velocity=velocity, angular_velocity=(0.0, 20.0, 0.0))

        def one(state, _):
            return rb.step(scene, state, None, 2e-4, method=rb.SemiImplicitEuler()), None

        final = lax.scan(one, start, None, length=160)[0]
        return jnp.sum(final.position * jnp.asarray([[1.0, 2.0, 3.0]]))

    soft = _with(_with(LAW, "stiffness", 2e4), "slip_speed", 0.05)
    law = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), soft)
    touch, down = jnp.asarray([0.0, 0.0, 0.1], dtype), jnp.asarray([1.0, 0.0, -1.0], dtype)
    gradient = jax.jit(jax.grad(end, argnums=(0, 1, 2)), compiler_options=QUICK)
    found = gradient(law, touch, down)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient(law, touch, 0.0 * down)))
    if dtype == jnp.float32:
        return  # differences of so stiff a run are round-off here
    value = jax.jit(end, compiler_options=QUICK)
    for name in ("stiffness", "exponent", "dissipation", "friction", "slip_speed"):
        h = 1e-5 * float(getattr(law, name))
        ahead, behind = (value(_with(law, name, getattr(law, name) + step), touch, down) for step in (h, -h))
        difference = float(ahead - behind) / (2 * h)
        assert float(getattr(found[0], name)) == pytest.approx(difference, rel=1e-5, abs=1e-9), name
    h = 1e-6
    for axis in range(3):
        step = h * jnp.eye(3)[axis]
        difference = float(value(law, touch, down + step) - value(law, touch, down - step)) / (2 * h)
        assert float(found[2][axis]) == pytest.approx(difference, rel=1e-5, abs=1e-7)


def _with(law, name, number):
    numbers = {n: getattr(law, n) for n in ("stiffness", "exponent", "dissipation", "friction", "slip_speed")}
    return rb.CompliantContact(FLOOR, **(numbers | {name: number}))


def test_rate_is_that_of_the_spring_and_coarse_steps_are_told():
    """A ball on a linear spring oscillates with √(k/m); the rate names a corner, which may yield four times."""
    law = rb.CompliantContact(FLOOR, stiffness=1e6, exponent=1.0)
    scene = rb.Scene(BALL, law)
    spring = np.sqrt(1e6 / MASS)
    assert law.rate(scene.stacked(), scene.state()) == pytest.approx(2 * spring)
    with pytest.warns(JaxrbWarning, match="CompliantContact"):
        rb.rollout(scene, scene.state(position=(0, 0, 1.0)), dt=2.0 / spring, steps=1)
    rubbing = rb.CompliantContact(FLOOR, stiffness=1.0, friction=0.5, slip_speed=1e-3)
    assert rubbing.rate(scene.stacked(), scene.state()) == pytest.approx(4 * 0.5 * 9.81 / 1e-3)


def test_pairs_and_floors_of_several_kinds_share_a_scene():
    """All pairs of unlike kinds are looked at, each once; the weight of a small heap ends up on the floor."""
    bodies = (BALL, rb.Body.from_shape(BRICK, 500.0), rb.Body.from_shape(rb.Sphere(0.07), 900.0))
    laws = (
        rb.CompliantContact(FLOOR, stiffness=1e4, exponent=1.0, bodies=(0, 1)),
        rb.CompliantContact(stiffness=1e4, exponent=1.0),
    )
    scene = rb.Scene(bodies, laws)
    place = [(0.0, 0.0, 0.09), (0.3, 0.0, 0.045), (0.3, 0.0, 0.155)]

    def forces(state):
        dynamics = scene.prepared(state.dtype)
        return [effect.wrench_on(dynamics.bodies, state).force for effect in dynamics.effects]

    floor, mutual = jax.jit(forces, compiler_options=QUICK)(scene.state(place))
    np.testing.assert_allclose(floor[:, 2], [1e4 * 0.01, 4 * 1e4 * 0.005, 0.0], rtol=1e-3)
    np.testing.assert_allclose(mutual[:, 2], [0.0, -1e4 * 0.01, 1e4 * 0.01], rtol=1e-3, atol=1e-9)


def test_what_is_none_is_not_in_the_program():
    def equations(**law):
        scene = rb.Scene(BALL, rb.CompliantContact(FLOOR, stiffness=1e5, **law))
        state = scene.state()
        return len(jax.make_jaxpr(lambda s: scene.prepared(s.dtype).wrench(s))(state).eqns)

    both = {"dissipation": 0.1, "friction": 0.3}
    assert (
        equations()
        < equations(dissipation=0.1)
        < equations(**both)
        < equations(**both, rolling_resistance=1e-3)
    )


@pytest.mark.parametrize(
    ("error", "words", "make"),
    [
        (InvalidInput, "stiffness", lambda: rb.CompliantContact(FLOOR, stiffness=0.0)),
        (InvalidInput, "at least 1", lambda: rb.CompliantContact(FLOOR, stiffness=1.0, exponent=0.5)),
        (InvalidInput, "friction", lambda: rb.CompliantContact(FLOOR, stiffness=1.0, friction=-0.5)),
        (InvalidInput, "slip_speed", lambda: rb.CompliantContact(FLOOR, stiffness=1.0, slip_speed=0.0)),
        (WrongStructure, "CompliantContact.against", lambda: rb.CompliantContact("floor", stiffness=1.0)),
        (
            WrongStructure,
            "one number for all",
            lambda: rb.Scene(BALL, rb.CompliantContact(FLOOR, stiffness=[1.0, 2.0])),
        ),
        (
            WrongStructure,
            "no body 1",
            lambda: rb.Scene(BALL, rb.CompliantContact(FLOOR, stiffness=1.0, bodies=(1,))),
        ),
        (
            WrongStructure,
            "CompliantContact: body 0 .* has no shape",
            lambda: rb.Scene(rb.Body(1.0, 1.0), rb.CompliantContact(FLOOR, stiffness=1.0)).prepared(float),
        ),
    ],
)
def test_what_cannot_be_is_refused(error, words, make):
    with pytest.raises(error, match=words):
        make()
