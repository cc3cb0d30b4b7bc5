"""Bodies whose motion is given, and media that move: closed forms, order, derivatives, refusals."""

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

BALL = rb.Body(2.0, 0.5)
STIFFNESS, RATE = 8.0, 1.3


def shaker(time, amplitude):
    """Along x, and turning about z at the same rate."""
    zero = jnp.zeros_like(time)
    wxyz = jnp.stack([jnp.cos(0.5 * RATE * time), zero, zero, jnp.sin(0.5 * RATE * time)])
    return rb.Pose(jnp.stack([amplitude * jnp.sin(RATE * time), zero, zero]), rb.Quaternion(wxyz))


run_to = jax.jit(end_state, compiler_options=QUICK)  # the number of steps is a number of the run


def shaken(amplitude=0.3):
    """A mass on a spring whose other end is shaken."""
    scene = rb.Scene(
        (BALL, BALL),
        (rb.PrescribedMotion(shaker, amplitude), rb.SpringDamper(STIFFNESS, body_a=1, body_b=0), rb.UniformGravity()),
    )  # fmt: skip
    return scene, scene.state()


def position_by_hand(t, amplitude=0.3):
    """x of the mass from rest: m ẍ = −k (x − A sin Ωt), and it falls by the spring against its weight."""
    own = np.sqrt(STIFFNESS / 2.0)
    gain = amplitude * own**2 / (own**2 - RATE**2)
    return gain * (np.sin(RATE * t) - RATE / own * np.sin(own * t)), 9.80665 / own**2 * (
        np.cos(own * t) - 1.0
    )


# One of each way of advancing; the others share its code.
@pytest.mark.parametrize(
    "method",
    ["SemiImplicitEuler", "VelocityVerlet", "RungeKutta4", "ImplicitMidpoint", "ThreeAxisSplitting4"],
)
def test_a_shaken_mass_moves_as_the_closed_form_says(method, tolerance):
    scene, state = shaken()
    kind = METHODS[method]()
    ends = {}
    for steps in (40, 80):
        end = run_to(scene, state, kind, jnp.asarray(2.0, state.dtype), jnp.asarray(steps))
        assert float(end.position[0, 0]) == pytest.approx(0.3 * np.sin(2.0 * RATE), abs=2e-6)
        x, z = position_by_hand(2.0)
        ends[steps] = max(abs(float(end.position[1, 0]) - x), abs(float(end.position[1, 2]) - z))
    floor = tolerance(float64=1e-11, float32=2e-5)
    assert ends[80] < max(0.7 * ends[40] * 2.0 ** (1 - kind.order), floor)
    assert ends[80] < {1: 0.6, 2: 2e-2}.get(kind.order, 1e-5) + floor


def test_the_given_velocities_are_the_derivatives_of_the_pose(tolerance):
    scene, state = shaken()
    small = tolerance(float64=1e-14, float32=1e-6)
    np.testing.assert_allclose(state.velocity[0], [0.3 * RATE, 0, 0], atol=small)
    np.testing.assert_allclose(state.angular_velocity[0], [0, 0, RATE], atol=small)
    end = run_to(scene, state, rb.RungeKutta4(), jnp.asarray(1.0, state.dtype), jnp.asarray(10))
    np.testing.assert_allclose(end.orientation.log()[0], [0, 0, RATE], atol=1e-5)
    np.testing.assert_allclose(end.velocity[0, 0], 0.3 * RATE * np.cos(RATE), atol=10 * small)


@pytest.mark.parametrize("rotation", [rb.RotationMatrix, rb.EulerAngles])
def test_given_motion_in_other_representations(rotation):
    scene, _ = shaken()
    state = scene.state(rotation=rotation)
    end = run_to(scene, state, rb.SemiImplicitEuler(), jnp.asarray(1.0, state.dtype), jnp.asarray(5))
    np.testing.assert_allclose(end.orientation.as_matrix()[0, 1, 0], np.sin(RATE), atol=1e-5)


@pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"), reason="what a solver sees does not depend on precision"
)
def test_error_controlled_solver_follows_the_given_motion():
    scene, state = shaken()
    end = rb.solve(scene, state, t1=2.0, solver=diffrax.Tsit5(), rtol=1e-6, atol=1e-6).final
    x, z = position_by_hand(2.0)
    np.testing.assert_allclose(end.position[1], [x, 0, z], atol=1e-4)


def test_a_scene_of_given_motion_alone(tolerance):
    """No body is left to integrate; the end is the function's."""
    scene = rb.Scene(BALL, rb.PrescribedMotion(shaker, 0.3))
    for method in (rb.RungeKutta4(), rb.ThreeAxisSplitting()):
        state = scene.state(rotation=rb.RotationMatrix)
        end = run_to(scene, state, method, jnp.asarray(0.7, state.dtype), jnp.asarray(7))
        np.testing.assert_allclose(
            end.orientation.log()[0], [0, 0, 0.7 * RATE], atol=tolerance(float64=1e-13, float32=1e-6)
        )


def test_derivative_with_respect_to_the_motion(tolerance):
    """The mass moves in proportion to the amplitude."""
    scene, state = shaken()

    def end(amplitude):
        moved = rb.Scene(scene.bodies, (rb.PrescribedMotion(shaker, amplitude), *scene.effects[1:]))
        run = rb.rollout(moved, state, dt=0.1, steps=20, save_every=20, method="SemiImplicitEuler")
        return run.final.position[1, 0]

    value, gradient = jax.jit(jax.value_and_grad(end), compiler_options=QUICK)(jnp.asarray(0.3))
    assert abs(value) > 0.1
    assert float(gradient) == pytest.approx(float(value) / 0.3, rel=tolerance(float64=1e-12, float32=1e-5))


def shear(position, time, slope):
    """A wind along x that grows with height and with time."""
    return slope * (position[2] + time) * jnp.asarray([1.0, 0.0, 0.0])


def test_drag_in_a_shear_wind_follows_the_closed_form(tolerance):
    """m v̇ = c (s (z + t) − v) at constant z: a relaxation towards a ramp."""
    scene = rb.Scene(BALL, rb.WindField(rb.LinearDrag(1.0), shear, 0.5))
    state = scene.state(position=(0.0, 0.0, 4.0))
    path = rb.rollout(scene, state, dt=0.02, steps=100, save_every=20)
    t, decay = np.asarray(path.times), 2.0
    expected = 0.5 * (4.0 + t - decay) + 0.5 * (decay - 4.0) * np.exp(-t / decay)
    np.testing.assert_allclose(
        path.states.velocity[:, 0, 0], expected, atol=tolerance(float64=1e-9, float32=2e-6)
    )


def test_a_uniform_field_is_the_wind_of_each_effect(tolerance):
    wind = (1.0, -2.0, 0.5)
    own = [
        rb.LinearDrag(0.3, angular_coefficient=0.1, wind=wind),
        rb.QuadraticDrag(0.4, 0.5, wind=wind, bodies=(1,)),
        rb.MagnusForce(0.2, wind=wind),
        rb.PlateAerodynamics((0.2, 0.1, 1.0), 0.4, (0.3, 0.1, 0.0), wind=wind),
    ]
    still = [
        rb.LinearDrag(0.3, angular_coefficient=0.1),
        rb.QuadraticDrag(0.4, 0.5, bodies=(1,)),
        rb.MagnusForce(0.2),
        rb.PlateAerodynamics((0.2, 0.1, 1.0), 0.4, (0.3, 0.1, 0.0)),
    ]
    field = rb.WindField(still, lambda position, time, parameters: parameters, np.asarray(wind))
    scenes = [rb.Scene((BALL, BALL), effects) for effects in (tuple(own), field)]
    state = scenes[0].state(velocity=[(1, 2, 3), (0, 1, 0)], angular_velocity=[(1, 0, 2), (0, 1, 0)])
    a, b = (jax.jit(lambda s: s.prepared(state.dtype).wrench(state))(scene) for scene in scenes)
    for one, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(one, other, atol=tolerance(float64=1e-14, float32=1e-6))
    assert field.rate(scenes[1].stacked(), state) > 0


def test_derivatives_with_respect_to_the_wind(tolerance):
    def end(slope):
        scene = rb.Scene(BALL, rb.WindField(rb.LinearDrag(1.0), shear, slope))
        return rb.rollout(
            scene, scene.state(position=(0.0, 0.0, 4.0)), dt=0.02, steps=50, save_every=50
        ).final

    to_slope = jax.jit(jax.grad(lambda s: end(s).velocity[0, 0]), compiler_options=QUICK)(jnp.asarray(0.5))
    expected = (4.0 + 1.0 - 2.0) + (2.0 - 4.0) * np.exp(-0.5)
    assert float(to_slope) == pytest.approx(expected, abs=tolerance(float64=1e-8, float32=1e-5))


SHAKEN = rb.Scene(
    rb.Body.from_shape(rb.Sphere(0.1), 1.0),
    (rb.PrescribedMotion(shaker, 0.1), rb.RigidContact(rb.HalfSpace())),
)
REFUSED = {
    "no function": (lambda: rb.PrescribedMotion("up"), WrongStructure, "'up' is no function"),
    "no pose": (
        lambda: rb.Scene(BALL, rb.PrescribedMotion(lambda time, parameters: time)).state(),
        WrongStructure,
        r"returned .*; return rb\.Pose\(position, orientation\)",
    ),
    "no such body": (
        lambda: rb.Scene(BALL, rb.PrescribedMotion(shaker, 0.1, body=2)),
        WrongStructure,
        "there is no body 2",
    ),
    "driven twice": (
        lambda: rb.Scene(BALL, (rb.PrescribedMotion(shaker, 0.1), rb.PrescribedMotion(shaker, 0.1))).state(),
        WrongStructure,
        "PrescribedMotion: body 0 .*driven already",
    ),
    "elsewhere": (
        lambda: shaken()[0].state(position=[(1, 0, 0), (0, 0, 0)]),
        InvalidInput,
        r"position of body 0 is \[1\.0, 0\.0, 0\.0\] m.*its constraint holds it at",
    ),
    "faster": (
        lambda: shaken()[0].state(velocity=[(5, 0, 0), (0, 0, 0)]),
        InvalidInput,
        r"state\.velocity of body 0 is \[5\.0, 0\.0, 0\.0\].*PrescribedMotion",
    ),
    "impacts": (
        lambda: rb.solve_events(SHAKEN, SHAKEN.state(), t1=1.0, max_events=4),
        WrongStructure,
        "solve_events: RigidContact of body 0, which moves as PrescribedMotion says: .*use rb.rollout",
    ),
    "wind on a spring": (
        lambda: rb.WindField(rb.SpringDamper(1.0), shear),
        WrongStructure,
        "is no force on one body at a time",
    ),
    "wind without function": (lambda: rb.WindField(rb.LinearDrag(1.0), 3.0), WrongStructure, "3.0 is no function"),
    "wind that is a number": (
        lambda: rb.step(*_windy(lambda position, time, parameters: time)),
        WrongStructure,
        r"returned shape \(\); return the velocity \(3,\)",
    ),
    "wind on a missing body": (
        lambda: rb.Scene(BALL, rb.WindField(rb.LinearDrag(1.0, bodies=(3,)), shear)),
        WrongStructure,
        "there is no body 3",
    ),
}  # fmt: skip


def _windy(function):
    scene = rb.Scene(BALL, rb.WindField(rb.LinearDrag(1.0), function))
    return scene, scene.state()


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused(case):
    make, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        make()
