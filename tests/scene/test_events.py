"""Impacts as events against closed forms: states and gradients of 200 random ones; exchange, Zeno, rest, grazing."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from event_scenes import (
    ball_numbers,
    ball_on_plane,
    ball_on_plane_exact,
    box_numbers,
    box_on_plane,
    box_on_plane_exact,
    pair_numbers,
    two_balls,
    two_balls_exact,
)
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.errors import RunFailed, WrongStructure

G = 9.81


def worlds(cases, dtype):
    return jax.tree.map(lambda *x: jnp.asarray(np.stack([np.asarray(v, float) for v in x]), dtype), *cases)


def functional(numbers):
    """Random weights of the end's entries, the same for all worlds."""
    return jnp.asarray(np.random.default_rng(1).normal(size=18))[:numbers]


@functools.cache
def with_gradient(end, size):
    def weighted(numbers, *more):
        vector, ok = end(numbers, *more)
        return vector @ functional(size).astype(vector.dtype), (vector, ok)

    return jax.jit(jax.vmap(jax.grad(weighted, has_aux=True)), compiler_options=QUICK)


EXACT = {
    end: lambda n, *more, exact=exact: (exact(n, *more), True)
    for end, exact in (
        (ball_on_plane, ball_on_plane_exact),
        (two_balls, two_balls_exact),
        (box_on_plane, box_on_plane_exact),
    )
}


def compared(end, size, numbers, *more):
    """Largest errors over the worlds of the end, and of each number's gradient relative to its size (1 at least)."""
    gradient, (vector, ok) = with_gradient(end, size)(numbers)
    assert bool(ok.all()), np.flatnonzero(~np.asarray(ok))
    sure = with_gradient(EXACT[end], size)
    with jax.enable_x64(True):
        right, (expected, _) = sure(*jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), (numbers, *more)))
    off = {"end": np.abs(np.asarray(vector, float) - np.asarray(expected)).max()}
    for name, known in jax.tree.map(np.asarray, right).items():
        rows = np.abs(np.asarray(gradient[name], float) - known).reshape(len(known), -1).max(axis=1)
        scale = np.maximum(1.0, np.abs(np.asarray(known)).reshape(len(known), -1).max(axis=1))
        assert np.abs(known).max() > 1e-3, f"{name} does not matter: the test is blind"
        off[name] = (rows / scale).max()
    return off


def check(off, dtype, gradients, end):
    """In float32 a point near the switch may stick where it slides, another slope: there only the end counts."""
    assert off["end"] < end
    if dtype == jnp.float64:
        assert max(off.values()) < gradients, off


def test_eighty_balls_on_tilted_planes(dtype, tolerance):
    numbers = worlds([ball_numbers(seed) for seed in range(80)], dtype)
    off = compared(ball_on_plane, 9, numbers)
    check(off, dtype, gradients=1e-8, end=tolerance(float64=1e-13, float32=2e-5))


def test_sixty_pairs_of_balls(dtype, tolerance):
    numbers = worlds([pair_numbers(seed) for seed in range(60)], dtype)
    off = compared(two_balls, 18, numbers)
    check(off, dtype, gradients=1e-8, end=tolerance(float64=1e-13, float32=2e-5))


def test_sixty_boxes_on_a_corner(dtype, tolerance):
    cases = [box_numbers(seed) for seed in range(60)]
    corners = worlds([corner for _, corner in cases], dtype)
    numbers = worlds([numbers for numbers, _ in cases], dtype)
    off = compared(box_on_plane, 9, numbers, corners)
    check(off, dtype, gradients=1e-7, end=tolerance(float64=1e-13, float32=2e-4))


def test_grazing_balls_have_finite_gradients(dtype, tolerance):
    """Near a miss the closing speed is a root of the distance from it, so the gradient grows; it stays a number."""
    case = pair_numbers(0)
    radii = case["radii"].sum()
    cases = []
    for part in np.logspace(-2, tolerance(float64=-10, float32=-4), 60):
        aside = np.array([0.0, np.sqrt(1 - part) * radii, 0.0])
        positions = np.stack([np.zeros(3), np.array([radii + 0.3, 0.0, 0.0]) + aside])
        velocities = np.array([[1.0, 0.0, 0.0], [-0.5, 0.0, 0.0]])
        cases.append({**case, "positions": positions, "velocities": velocities, "mu": 0.1, "t1": 0.9})
    gradient, (vector, _) = with_gradient(two_balls, 18)(worlds(cases, dtype))
    assert np.isfinite(vector).all()
    for name, slope in gradient.items():
        assert np.isfinite(slope).all(), name
    assert np.abs(gradient["velocities"]).max() < tolerance(float64=1e6, float32=1e4)


def test_four_corners_at_once_are_one_impact(dtype, tolerance):
    """A box that falls flat: it bounces as a point would, its gradients are finite, and e's is exact."""
    cases = []
    for seed in range(60):
        numbers, _ = box_numbers(seed)
        still = {"turn": np.zeros(3), "velocity": np.array([0.0, 0.0, -1.0]), "t1": 0.5}
        position = np.array([0.0, 0.0, numbers["half"][2] + 0.3])
        bounce = {
            "e": np.asarray(0.4 + 0.6 * seed / 60),
            "gravity": np.array([0.0, 0.0, -5.0]),
        }  # once in 0.5 s
        cases.append({**numbers, **still, **bounce, "position": position})
    numbers = worlds(cases, dtype)
    gradient, (vector, ok) = with_gradient(box_on_plane, 9)(numbers)
    assert bool(ok.all())
    fall = 2.0  # [m/s] after 0.2 s
    e = np.asarray(numbers["e"], float)
    right = np.zeros((60, 9))
    right[:, 2] = np.asarray(numbers["half"])[:, 2] + 0.3 * e * fall - 0.5 * 5.0 * 0.3**2
    right[:, 5] = e * fall - 5.0 * 0.3
    close = tolerance(float64=1e-11, float32=1e-4)
    np.testing.assert_allclose(vector, right, atol=close)
    weights = np.asarray(functional(9))
    np.testing.assert_allclose(gradient["e"], fall * (0.3 * weights[2] + weights[5]), atol=1e2 * close)
    assert all(np.isfinite(slope).all() for slope in gradient.values())


def test_boxes_and_capsule_bounce_on_each_other_without_loss(dtype, tolerance):
    """Three bodies thrown together over a floor: energy is kept through every impact, and each impulse is recorded."""
    boxes = rb.replicate(rb.Body.from_shape(rb.Box((0.1, 0.07, 0.05)), 500.0), 2)
    scene = rb.Scene(
        (boxes, rb.Body.from_shape(rb.Capsule(0.05, 0.08), 500.0)),
        (
            rb.UniformGravity(),
            rb.RigidContact(rb.HalfSpace(), restitution=1.0),
            rb.RigidContact(restitution=1.0),
        ),
    )
    state = scene.state(
        jnp.asarray([[0.0, 0.0, 0.6], [0.4, 0.02, 0.65], [0.02, 0.3, 0.6]], dtype),
        None,
        jnp.asarray([[0.5, 0.2, 0.0], [-0.8, 0.0, 0.0], [0.0, -0.7, 0.3]], dtype),
        jnp.asarray([[3.0, 5.0, -2.0], [1.0, 2.0, 7.0], [2.0, -1.0, 0.5]], dtype),
    )
    run = jax.jit(
        lambda s: rb.solve_events(scene, s, t1=1.0, max_events=20, on_error="flag"), compiler_options=QUICK
    )
    path = run(state)
    assert bool(path.status.ok)
    energy = path.diagnostics.energy
    np.testing.assert_allclose(energy[-1], energy[0], rtol=tolerance(float64=1e-12, float32=1e-4))
    count = int(path.events.count)
    pairs = {tuple(pair) for pair in np.asarray(path.events.pair[:count]).tolist()}
    assert (1, 0) in pairs
    assert len(pairs) >= 3, pairs
    impulse = np.asarray(path.events.impulse[:count], float)
    on_floor = np.asarray(path.events.pair[:count, 1]) < 0
    mass = np.asarray(scene.stacked().mass, float).sum()
    given = np.asarray(path.diagnostics.momentum, float)
    expected = given[0] + impulse[on_floor].sum(axis=0) + mass * np.array([0.0, 0.0, -9.80665])
    np.testing.assert_allclose(given[-1], expected, atol=tolerance(float64=1e-10, float32=1e-3))


def test_equal_balls_exchange_their_velocities_exactly(dtype, tolerance):
    """One dimension, no loss: the end of each is the other's, in both modes of derivative."""
    ball = rb.replicate(rb.Body(1.3, 0.4 * 1.3 * 0.04, rb.Sphere(0.2)), 2)
    scene = rb.Scene(ball, rb.RigidContact(restitution=1.0))

    def end(x):
        line = jnp.zeros((4, 3), x.dtype).at[:, 0].set(x)
        path = rb.solve_events(scene, scene.state(line[:2], None, line[2:]), t1=1.0, max_events=1)
        ended = jnp.concatenate([path.final.position[:, 0], path.final.velocity[:, 0]])
        return ended, (ended, path.events)

    start = jnp.asarray([-1.0, 0.0, 2.0, 0.5], dtype)
    # x₁ ends where x₂ would have gone, back by two radii, and the other way round.
    exact = np.array([[0, 1, 0, 1], [1, 0, 1, 0], [0, 0, 0, 1], [0, 0, 1, 0]], float)
    close = tolerance(float64=1e-13, float32=2e-5)
    forward, (found, events) = jax.jit(jax.jacfwd(end, has_aux=True), compiler_options=QUICK)(start)
    np.testing.assert_allclose(found, [0.1, 1.4, 0.5, 2.0], atol=close)
    np.testing.assert_allclose(forward, exact, atol=close)
    np.testing.assert_allclose(events.time, [0.4], atol=close)
    np.testing.assert_array_equal(events.pair, [[1, 0]])
    np.testing.assert_allclose(events.impulse, [[1.3 * 1.5, 0, 0]], atol=close)
    np.testing.assert_allclose(events.point, [[0.0, 0, 0]], atol=close)


@pytest.fixture(scope="module")
def bouncing(dtype):
    """A ball that is thrown along a floor and bounces: run(e, mu, speed, events, dt)."""
    ball = rb.Body(1.0, 0.4 * 0.01, rb.Sphere(0.1))

    def run(e, mu, velocity):
        effects = (rb.UniformGravity((0, 0, -G)), rb.RigidContact(rb.HalfSpace(), friction=mu, restitution=e))
        scene = rb.Scene(ball, effects)
        state = scene.state(jnp.array([[0.0, 0.0, 0.6]], dtype), None, velocity[None])
        return rb.solve_events(scene, state, t1=4.0, max_events=60, dt=0.02, max_steps=201, on_error="flag")

    return jax.jit(run, compiler_options=QUICK)


def test_zeno_ends_in_rolling(bouncing, dtype, tolerance):
    """Bounces grow shorter by e; when they are over friction has set the ball rolling with 5/7 of its speed."""
    e = 0.6
    path = bouncing(jnp.asarray(e, dtype), jnp.asarray(0.3, dtype), jnp.asarray([1.0, 0.0, 0.0], dtype))
    assert bool(path.status.ok)
    fall, speed = np.sqrt(2 * 0.5 / G), np.sqrt(2 * 0.5 * G)
    times = fall + np.concatenate([[0.0], np.cumsum(2 * speed / G * e ** np.arange(1, 12))])
    np.testing.assert_allclose(path.events.time[:12], times, atol=tolerance(float64=1e-12, float32=5e-4))
    count = int(path.events.count)
    series = fall + 2 * speed / G * e / (1 - e)
    last = np.asarray(path.events.time)[count - 1]
    assert last == pytest.approx(series, abs=tolerance(float64=1e-4, float32=1e-3))
    assert count < 30
    final = path.final
    np.testing.assert_allclose(final.position[0, 2], 0.1, atol=tolerance(float64=1e-8, float32=1e-5))
    np.testing.assert_allclose(final.velocity[0], [5 / 7, 0, 0], atol=tolerance(float64=1e-6, float32=1e-3))
    np.testing.assert_allclose(
        final.angular_velocity[0, 1] * 0.1, 5 / 7, rtol=tolerance(float64=1e-6, float32=2e-3)
    )


def test_lossless_bounces_keep_the_energy(bouncing, dtype, tolerance):
    path = bouncing(jnp.asarray(1.0, dtype), jnp.asarray(0.0, dtype), jnp.asarray([0.3, 0.0, 0.0], dtype))
    assert bool(path.status.ok)
    energy = path.diagnostics.energy
    np.testing.assert_allclose(energy[-1], energy[0], rtol=tolerance(float64=1e-14, float32=1e-4))
    period = 2 * np.sqrt(2 * 0.5 / G)
    count = int(path.events.count)
    assert count == int((4.0 - period / 2) / period) + 1
    np.testing.assert_allclose(
        np.diff(path.events.time[:count]), period, rtol=tolerance(float64=1e-12, float32=1e-4)
    )
    np.testing.assert_array_equal(path.events.pair[:count], [[0, -1]] * count)
    np.testing.assert_array_equal(path.events.pair[count:], -2)


def test_too_many_impacts_and_rest_are_told(dtype):
    ball = rb.Body(1.0, 0.4 * 0.01, rb.Sphere(0.1))

    def run(e):
        scene = rb.Scene(ball, (rb.UniformGravity(), rb.RigidContact(rb.HalfSpace(), restitution=e)))
        state = scene.state(jnp.asarray([0.0, 0.0, 1.0], dtype))
        return rb.solve_events(scene, state, t1=3.0, max_events=4)

    run = jax.jit(run, compiler_options=QUICK)
    path = run(jnp.asarray(0.5, dtype))
    assert not bool(path.status.ok)
    assert float(path.final.time) < 3.0
    with pytest.raises(RunFailed, match=r"after 4 impacts .* more impacts than max_events = 4"):
        path.raise_if_bad()
    # A ball that does not bounce lies there, which needs a step to go on.
    with pytest.raises(RunFailed, match="give dt="):
        run(jnp.asarray(0.0, dtype)).raise_if_bad()


def test_what_cannot_be_run_is_refused():
    ball = rb.Body(1.0, 0.4 * 0.01, rb.Sphere(0.1))
    floor = rb.RigidContact(rb.HalfSpace())
    free = rb.Scene(ball, rb.UniformGravity())
    with pytest.raises(WrongStructure, match="no RigidContact"):
        rb.solve_events(free, free.state((0, 0, 1)), t1=1.0)
    slowed = rb.Scene(ball, (rb.LinearDrag(0.1), floor))
    with pytest.raises(WrongStructure, match=r"LinearDrag has no closed form; give dt"):
        rb.solve_events(slowed, slowed.state((0, 0, 1)), t1=1.0)
    scene = rb.Scene(ball, floor)
    with pytest.raises(WrongStructure, match="Euler angles"):
        rb.solve_events(scene, scene.state((0, 0, 1), rotation=rb.EulerAngles), t1=1.0)
    here, there = (rb.Pose(jnp.array([x, 0.0, 0.0]), rb.Quaternion.identity()) for x in (0.0, 0.1))
    two = rb.Body.from_shape(rb.Composite(((rb.Sphere(0.1), here), (rb.Sphere(0.1), there))), 500.0)
    joined = rb.Scene(two, floor)
    with pytest.raises(WrongStructure, match="Composite"):
        rb.solve_events(joined, joined.state((0, 0, 1)), t1=1.0)
