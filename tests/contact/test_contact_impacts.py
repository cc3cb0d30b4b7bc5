"""Impacts of balls against exact answers, and a ball that comes to roll."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from contact_scenes import DOWN, G, continued, long_run, motion, runner, state, worlds

import jaxrb as rb

RADIUS = 0.1


def ball(numbers):
    """One ball over a floor with friction and restitution."""
    body = rb.Body.from_shape(rb.Sphere(RADIUS), 500.0)
    contact = rb.RigidContact(rb.HalfSpace(), friction=numbers["mu"], restitution=numbers["e"])
    return rb.Scene(body, (rb.UniformGravity(DOWN), contact))


def five(numbers):
    """Five equal balls in space, without friction; those a case has no use for are far away."""
    balls = rb.replicate(rb.Body.from_shape(rb.Sphere(RADIUS), 500.0), 5)
    return rb.Scene(balls, rb.RigidContact(restitution=numbers["e"]))


@pytest.fixture(scope="module")
def drop(dtype):
    """States (worlds, steps, 1, ...) of balls over a floor: 500 steps of 1 ms a go; nine at most."""
    program = continued(ball, 500)
    place = jax.jit(jax.vmap(lambda n, m: state(ball(n), m)))

    def run(cases, goes):
        filled = [*cases, *[cases[-1]] * (9 - len(cases))]
        numbers, moves = (worlds(v, dtype) for v in zip(*filled))
        states = long_run(program, numbers, place(numbers, moves), jnp.full(9, 1e-3, dtype), goes)
        return jax.tree.map(lambda x: x[: len(cases)], states)

    return run


@pytest.fixture(scope="module")
def balls(dtype):
    """The paths of rows of five balls, 100 steps of 1 ms, by name."""
    program = runner(five, 100)
    names = list(CASES)
    numbers = worlds([{"e": np.asarray(CASES[name][0])} for name in names], dtype)
    moves = worlds([CASES[name][1] for name in names], dtype)
    path = program(numbers, moves, jnp.full(len(names), 1e-3, dtype))
    return {
        name: jax.tree.map(lambda x, k=k: np.asarray(x[k], float), path.states)
        for k, name in enumerate(names)
    }


def spread(places, velocities):
    """Five balls of which the first stand at `places`, the others far away and still."""
    far = [(50.0, 10.0 * k, 0.0) for k in range(5 - len(places))]
    return motion([*places, *far], [*velocities, *[(0, 0, 0)] * len(far)])


ROW = [(0.2 * k, 0.0, 0.0) for k in range(5)]
STILL = (0.0, 0.0, 0.0)
# Name: the way [m] to the others, the speeds before, the speeds after.
CRADLE = {
    "one in": (0.0503, (1, 0, 0, 0, 0), (0, 0, 0, 0, 1)),
    "two in": (0.0503, (1, 1, 0, 0, 0), (0, 0, 0, 1, 1)),
    "from both ends": (0.0503, (1, 0, 0, 0, -2), (-2, 0, 0, 0, 1)),
    # The blow falls on the end of a step, and what touches is apart or overlaps by round-off.
    "one in at a step's end": (0.05, (1, 0, 0, 0, 0), (0, 0, 0, 0, 1)),
    "two in at a step's end": (0.05, (1, 1, 0, 0, 0), (0, 0, 0, 1, 1)),
}


def spread_row(way, speeds):
    """A row of five, those that move drawn back along their way."""
    return motion(
        [(x - way * np.sign(v), 0, 0) for (x, *_), v in zip(ROW, speeds)], [(v, 0, 0) for v in speeds]
    )


# Touching, its partner below to the side: the line of centres is at 30° to the way.
OBLIQUE = [(0.0, 0.0, 0.0), (0.2 * np.cos(np.pi / 6), 0.2 * np.sin(np.pi / 6), 0.0)]
CASES = {
    **{
        f"head-on {e}": (e, spread([(0, 0, 0), (0.25, 0, 0)], [(1.5, 0, 0), (-0.5, 0, 0)]))
        for e in (0.0, 0.5, 1.0)
    },
    **{f"oblique {e}": (e, spread(OBLIQUE, [(1.0, 0.0, 0.3), STILL])) for e in (0.5, 1.0)},
    **{name: (1.0, spread_row(way, moving)) for name, (way, moving, _) in CRADLE.items()},
}


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_equal_balls_head_on(e, balls, tolerance):
    """They part with e times the speed of approach; momentum stays; also the way is exact, whatever the step."""
    found = balls[f"head-on {e}"]
    expected = 0.5 + e * np.array([-1.0, 1.0])
    tol = tolerance(float64=1e-10, float32=5e-4)
    assert found.velocity[-1, :2, 0] == pytest.approx(expected, abs=tol)
    meet = 0.05 / 2.0
    way = np.array([0.0, 0.25]) + meet * np.array([1.5, -0.5]) + (0.1 - meet) * expected
    assert found.position[-1, :2, 0] == pytest.approx(way, abs=tol)
    assert np.abs(found.velocity[..., 1:]).max() <= tol


@pytest.mark.parametrize("e", [0.5, 1.0])
def test_oblique_balls_change_only_along_the_line_of_centres(e, balls, tolerance):
    found = balls[f"oblique {e}"]
    line = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])
    before = np.array([1.0, 0.0, 0.3])
    passed = 0.5 * (1 + e) * (before @ line) * line
    tol = tolerance(float64=1e-10, float32=5e-4)
    assert found.velocity[-1, :2] == pytest.approx(np.array([before - passed, passed]), abs=tol)
    assert np.abs(found.angular_velocity).max() <= tol


@pytest.mark.parametrize("name", CRADLE)
def test_newtons_cradle(name, balls, tolerance):
    """One in, one out; two in, two out; from both ends the speeds change sides."""
    found = balls[name]
    tol = tolerance(float64=1e-9, float32=2e-3)
    assert found.velocity[-1, :, 0] == pytest.approx(np.array(CRADLE[name][2], float), abs=tol)
    assert np.abs(found.velocity[..., 1:]).max() <= tol


def test_ball_bounces_to_e_to_the_2k(drop, tolerance):
    """Over 20 bounces at e = 0.9, also with friction; heights are those of the energy in flight."""
    laws = [(0.0, 0.9), (0.5, 0.9), (0.5, 1.0)]
    fall = motion((0, 0, RADIUS + 0.1))
    found = drop([({"mu": np.asarray(mu), "e": np.asarray(e)}, fall) for mu, e in laws], 5)
    z, v = found.position[..., 0, 2] - RADIUS, found.velocity[..., 0, 2]
    high = z + v * v / (2 * G)
    bounces = np.diff(np.sign(v), axis=1) > 0
    tol = tolerance(float64=1e-8, float32=2e-2)
    for k in range(2):
        after = high[k, np.nonzero(bounces[k])[0] + 1][:20]
        assert after / 0.1 == pytest.approx(0.81 ** np.arange(1, 21), rel=tol)
    assert bounces[2].sum() > 7
    assert high[2] / 0.1 == pytest.approx(1.0, abs=tol)
    assert z.min() >= -tolerance(float64=1e-9, float32=1e-6)


def test_sliding_ball_ends_rolling_with_five_sevenths(drop, tolerance):
    speeds, frictions = (0.5, 1.0, 2.0), (0.2, 0.5, 1.0)
    cases = [
        ({"mu": np.asarray(mu), "e": np.asarray(0.0)}, motion((0, 0, RADIUS), (v, 0, 0)))
        for v in speeds
        for mu in frictions
    ]
    found = drop(cases, 2)
    speed = found.velocity[:, -1, 0, 0]
    tol = tolerance(float64=1e-9, float32=1e-3)
    assert speed / np.repeat(speeds, 3) == pytest.approx(5 / 7, abs=tol)
    assert RADIUS * found.angular_velocity[:, -1, 0, 1] == pytest.approx(speed, abs=tol)
    assert np.abs(found.position[..., 0, 2] - RADIUS).max() <= tol
