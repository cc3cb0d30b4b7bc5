"""Runs with contact to a tolerance: against closed forms, themselves, and what they claim."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.accuracy.contact_scenes import bouncing_ball, cube_toss, sliding_block

G = 9.81
# Six times and the end: all runs here are of few programs, which compiling is most of.
SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)


def times_of(duration, dtype):
    """Times of a run (6,) as numbers of its type."""
    return (duration * np.asarray(SHARES, dtype)).tolist()


@pytest.fixture(scope="module")
def toss(dtype):
    """`run(tolerance)`: the library's cube thrown on a table."""
    case = cube_toss()
    return functools.partial(
        rb.solve_contact, case.scene, case.state(), t1=times_of(1.5, dtype)[-1], times=times_of(1.5, dtype)
    )


def test_ball_bounces_until_it_rolls_as_the_closed_form_says(tolerance, dtype):
    case = bouncing_ball()
    times = times_of(5.0, dtype)
    for asked in (1e-3, tolerance(float64=1e-9, float32=2e-4)):
        path = rb.solve_contact(case.scene, case.state(), t1=5.0, times=times, tolerance=asked)
        position, turn = case.exact(np.asarray(times))
        np.testing.assert_allclose(
            path.states.position, position, atol=tolerance(float64=1e-11, float32=1e-3)
        )
        wxyz = np.asarray(path.states.orientation.wxyz)
        off = np.minimum(np.abs(wxyz - turn).max(axis=-1), np.abs(wxyz + turn).max(axis=-1))
        assert off.max() < tolerance(float64=1e-10, float32=1e-2)
        assert int(path.steps.impacts) > tolerance(float64=20, float32=15)
        assert float(path.steps.smallest) > 0


def test_rolling_down_an_incline_has_no_error_of_the_step(tolerance, dtype):
    # A ball rolls with 5/7 g sin α; its point of contact moves over its surface.
    angle = 0.3
    case = bouncing_ball()
    plane = rb.HalfSpace((np.sin(angle), 0.0, np.cos(angle)))
    contact = rb.RigidContact(plane, friction=0.5, restitution=0.0)
    scene = rb.Scene(case.scene.bodies, (case.scene.effects[0], contact))
    start = scene.state((0.1 * np.sin(angle), 0.0, 0.1 * np.cos(angle)))
    asked = tolerance(float64=1e-8, float32=1e-4)
    path = rb.solve_contact(scene, start, t1=1.0, times=times_of(1.0, dtype), tolerance=asked)
    far = float(np.linalg.norm(path.final.position - start.position))
    assert far == pytest.approx(0.5 * 5 / 7 * G * np.sin(angle), rel=tolerance(float64=1e-10, float32=1e-4))
    assert int(path.steps.accepted) < 40


def test_blocks_slide_and_stop_where_they_must(tolerance, dtype):
    # Worlds of other frictions in one program: two stop, one does not.
    case = sliding_block()
    times, asked = times_of(1.0, dtype), tolerance(float64=1e-8, float32=2e-4)

    def run(friction):
        contact = rb.RigidContact(rb.HalfSpace(), friction=friction)
        scene = rb.Scene(case.scene.bodies, (case.scene.effects[0], contact))
        return rb.solve_contact(scene, case.state(), t1=1.0, times=times, tolerance=asked, on_error="flag")

    frictions = jnp.asarray([0.3, 0.7, 0.1], dtype)
    if dtype == jnp.float64:
        paths = jax.jit(jax.vmap(run), compiler_options=rb.compiler_options())(frictions)
    else:  # worlds in one program are compiled for long: once, above
        paths = jax.tree.map(lambda *x: jnp.stack(x), *map(run, frictions))
    assert bool(paths.status.ok.all())
    for k, friction in enumerate(frictions.tolist()):
        exact = sliding_block(friction=friction).exact(np.asarray(times))[0]
        np.testing.assert_allclose(
            paths.states.position[k], exact, atol=tolerance(float64=1e-8, float32=3e-4)
        )


def test_ball_falls_on_a_ball_and_not_through_it(dtype):
    if dtype == jnp.float32:
        pytest.skip("another program, to be compiled once")
    # Drag makes flights of steps; the lower ball rests while the upper one still falls.
    balls = rb.replicate(rb.Body.from_shape(rb.Sphere(0.1), 300.0), 2)
    effects = (rb.UniformGravity((0, 0, -G)), rb.LinearDrag(0.5))
    scene = rb.Scene(balls, (*effects, rb.RigidContact(rb.HalfSpace()), rb.RigidContact()))
    start = scene.state([(0, 0, 0.15), (0, 0, 0.7)])
    times = times_of(1.0, dtype)
    path = rb.solve_contact(scene, start, t1=1.0, times=times, tolerance=1e-8)
    np.testing.assert_allclose(path.final.position[:, 2], [0.1, 0.3], atol=1e-7)
    mass = np.asarray(balls.mass).ravel()[0]
    k = 0.5 / mass
    fallen = G / k * (0.2 - (1 - np.exp(-0.2 * k)) / k)
    assert float(path.states.position[1, 1, 2]) == pytest.approx(0.7 - fallen, abs=1e-7)


def test_error_of_a_toss_falls_with_the_tolerance(toss, dtype):
    if dtype == jnp.float32:
        pytest.skip("six decades of tolerance are those of float64")
    truth = toss(tolerance=1e-10).final
    errors = []
    for asked in (1e-2, 1e-4, 1e-6, 1e-8):
        end = toss(tolerance=asked).final
        errors.append(
            float(
                np.linalg.norm(end.position - truth.position) + end.orientation.angle_to(truth.orientation)[0]
            )
        )
    assert errors[0] < 1e-1
    assert errors[1] < 5e-3
    assert errors[2] < 5e-5
    assert errors[3] < 1e-6


def test_certificate_is_within_a_factor_of_ten(dtype):
    if dtype == jnp.float32:
        pytest.skip("the least tolerance of float32 leaves no truth to compare with")
    case, times = cube_toss(), times_of(1.5, dtype)
    within = []
    for friction, speed in ((0.2, 1.0), (0.3, 0.5), (0.5, -0.3), (0.7, 1.5), (0.4, 2.0)):
        contact = rb.RigidContact(rb.HalfSpace(), friction=friction, restitution=0.1)
        scene = rb.Scene(case.scene.bodies, (case.scene.effects[0], contact))
        start = scene.state(**{**case.example.start, "velocity": (speed, 0.3, -0.5)})
        path = rb.solve_contact(scene, start, t1=1.5, times=times, tolerance=1e-5, certify=True)
        truth = rb.solve_contact(scene, start, t1=1.5, times=times, tolerance=1e-9).final
        error = float(np.linalg.norm(path.final.position - truth.position))
        found = float(path.certificate.position_error[0])
        within.append(error / 10 < found < 10 * error)
        assert bool(path.certificate.reliable[0])
        assert float(path.certificate.position_error_max[0]) >= found
    # Of 100 random tosses 90 are: `python -m jaxrb.accuracy.contact_tosses`.
    assert sum(within) >= 4


def test_what_it_cannot_do_is_refused(dtype, tolerance):
    case = bouncing_ball()
    state, times = case.state(), times_of(1.0, dtype)

    def end(height):
        start = case.scene.state(position=(0.0, 0.0, height))
        return rb.solve_contact(case.scene, start, t1=1.0, times=times).final.position[0, 0]

    with pytest.raises(rb.WrongStructure, match="rollout"):
        jax.grad(end)(1.0)
    with pytest.raises(rb.WrongStructure, match="no RigidContact"):
        rb.solve_contact(rb.Scene(case.scene.bodies), state, t1=1.0)
    with pytest.raises(rb.InvalidInput, match="a step at best"):
        rb.solve_contact(case.scene, state, t1=1.0, tolerance=1e-14)
    with pytest.raises(rb.InvalidInput, match="a tenth"):
        rb.solve_contact(
            case.scene, state, t1=1.0, tolerance=tolerance(float64=2e-12, float32=2e-4), certify=True
        )
    with pytest.raises(rb.WrongStructure, match="solve_contact"):
        rb.plan(case.scene, state, 1.0, 1e-4)
    with pytest.raises(rb.RunFailed, match="max_steps"):
        rb.solve_contact(case.scene, state, t1=1.0, times=times, tolerance=1e-3, max_steps=2)


def test_certificate_of_fixed_steps_knows_their_error(dtype):
    # In the first bounce a ball that spins backwards slides, and the step misses when it begins to roll.
    case = bouncing_ball()
    path = rb.rollout(
        case.scene, case.state(), dt=0.05, steps=60, save_every=10, certify=True, tolerance=1e-3
    )
    exact = case.exact(np.asarray([3.0]))[0][0]
    error = float(np.linalg.norm(np.asarray(path.final.position) - exact))
    assert error > 1e-3
    assert float(path.certificate.position_error[0]) == pytest.approx(error, rel=0.1)
    assert not bool(path.certificate.met[0])
