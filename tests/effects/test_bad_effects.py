"""Effects and scenes that make no sense are refused where they are made, naming class, field, value and mend."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, WrongStructure

NUMBERS = {
    "gravity NaN [46]": (
        lambda: rb.UniformGravity((0, 0, np.nan)),
        InvalidInput,
        r"UniformGravity\.acceleration is .*nan.* m/s², but must be finite",
    ),
    "gravity a number": (
        lambda: rb.UniformGravity(-9.81),
        WrongStructure,
        r"UniformGravity\.acceleration: the shape is \(\), but must end in \(3,\)",
    ),
    "gravity a word": (
        lambda: rb.UniformGravity("down"),
        InvalidInput,
        r"UniformGravity\.acceleration: 'down' is not a real number",
    ),
    "drag negative": (
        lambda: rb.LinearDrag(-0.1),
        InvalidInput,
        r"LinearDrag\.coefficient is .*-0\.1.* N s/m, but must not be negative",
    ),
    "angular drag negative": (
        lambda: rb.LinearDrag(0.1, angular_coefficient=-1),
        InvalidInput,
        r"LinearDrag\.angular_coefficient",
    ),
    "area negative": (
        lambda: rb.QuadraticDrag(0.4, -0.02),
        InvalidInput,
        r"QuadraticDrag\.area is .*-0\.02.* m²",
    ),
    "density infinite": (
        lambda: rb.QuadraticDrag(0.4, 0.02, density=np.inf),
        InvalidInput,
        r"QuadraticDrag\.density is .*inf",
    ),
    "drag of one body negative": (
        lambda: rb.LinearDrag([0.1, -0.2]),
        InvalidInput,
        r"LinearDrag\.coefficient of body 1 is .*-0\.2",
    ),
    "stiffness negative": (
        lambda: rb.SpringDamper(-1.0),
        InvalidInput,
        r"SpringDamper\.stiffness is .*-1.* N/m",
    ),
    "damping NaN": (
        lambda: rb.SpringDamper(1.0, damping=np.nan),
        InvalidInput,
        r"SpringDamper\.damping is .*nan",
    ),
    "point of two numbers": (
        lambda: rb.SpringDamper(1.0, point_a=(0, 1)),
        WrongStructure,
        r"SpringDamper\.point_a: the shape is \(2,\)",
    ),
    "thrust missing a number": (lambda: rb.BodyThruster((1.0, 2.0)), WrongStructure, r"BodyThruster\.force"),
    "torque NaN": (lambda: rb.PrescribedTorque((0, 0, np.nan)), InvalidInput, r"PrescribedTorque\.torque"),
    "torque shorter than its times": (
        lambda: rb.PrescribedTorque(np.zeros((2, 3)), times=[0.0, 1.0, 2.0]),
        WrongStructure,
        r"times \(3,\) and torque \(2, 3\); give \(k,\) and \(k, 3\)",
    ),
    "times run backwards": (
        lambda: rb.PrescribedTorque(np.zeros((3, 3)), times=[0.0, 2.0, 1.0]),
        InvalidInput,
        r"PrescribedTorque\.times.*ascend.*1\.0",
    ),
    "times NaN": (
        lambda: rb.PrescribedTorque(np.zeros((2, 3)), times=[0.0, np.nan]),
        InvalidInput,
        r"PrescribedTorque\.times.*finite",
    ),
    "anchor NaN": (
        lambda: rb.FixedPoint((0, 0, 1), anchor=(np.nan, 0, 0)),
        InvalidInput,
        r"FixedPoint\.anchor",
    ),
    "function missing": (
        lambda: rb.CustomForce("push"),
        WrongStructure,
        r"CustomForce\.function: 'push' is no function",
    ),
    "radius zero": (
        lambda: rb.Sphere(0.0),
        InvalidInput,
        r"Sphere\.radius is .*0\.0.* m, but must be positive",
    ),
    "extents of two numbers": (lambda: rb.Box((1.0, 2.0)), WrongStructure, r"Box\.half_extents"),
}


@pytest.mark.parametrize("case", NUMBERS)
def test_bad_numbers_are_refused_at_construction(case):
    make, error, message = NUMBERS[case]
    with pytest.raises(error, match=message):
        make()


SCENES = {
    "body that is not there": (
        rb.LinearDrag(0.1, bodies=(2,)),
        r"LinearDrag\.bodies: there is no body 2 in a scene of 2; numbers start at 0",
    ),
    "negative number": (rb.LinearDrag(0.1, bodies=(-1,)), "there is no body -1"),
    "a body twice": (rb.LinearDrag(0.1, bodies=(1, 1)), r"LinearDrag\.bodies: body 1 is named twice"),
    "a number, no tuple": (rb.LinearDrag(0.1, bodies=1), r"LinearDrag\.bodies: 1; give a tuple"),
    "coefficients of other bodies": (
        rb.LinearDrag([0.1, 0.2, 0.3]),
        r"LinearDrag\.coefficient: shape \(3,\); give \(\) for all bodies, or \(2,\)",
    ),
    "coefficients for chosen bodies": (
        rb.UniformGravity(np.zeros((2, 3)), bodies=(0,)),
        r"or \(1, 3\) for one value a body",
    ),
    "torque course for a missing body": (
        rb.PrescribedTorque(np.zeros((2, 3)), times=[0.0, 1.0], bodies=(5,)),
        "there is no body 5",
    ),
    "spring to a missing body": (rb.SpringDamper(1.0, body_b=2), r"SpringDamper\.body_b: there is no body 2"),
    "springs of unequal ends": (
        rb.SpringDamper(1.0, body_a=(0, 1), body_b=(1,)),
        "must name equally many bodies",
    ),
    "stiffnesses of other springs": (
        rb.SpringDamper([1.0, 2.0, 3.0]),
        r"SpringDamper\.stiffness: shape \(3,\); give \(\) for all springs, or \(1,\)",
    ),
    "a class": (rb.UniformGravity, r"UniformGravity is a class; write UniformGravity\("),
    "a function": ((lambda body, state: None,), "is no effect; wrap a function in CustomForce"),
}


@pytest.mark.parametrize("case", SCENES)
def test_effect_that_does_not_fit_the_scene_is_refused(case):
    effect, message = SCENES[case]
    bodies = rb.replicate(rb.Body(1.0, 1.0), 2)
    with pytest.raises(WrongStructure, match=message):
        rb.Scene(bodies, effect if isinstance(effect, tuple) else (effect,))


@pytest.mark.parametrize("bodies", [(), (rb.Sphere(1.0),), ("ball",)])
def test_scene_needs_bodies(bodies):
    with pytest.raises(
        WrongStructure, match=r"Scene\.bodies: .*give a Body, or a tuple of at least one Body"
    ):
        rb.Scene(bodies)


def test_position_that_contradicts_a_fixed_point_is_refused():
    scene = rb.Scene(rb.Body(1.0, 1.0), rb.FixedPoint((0, 0, 1)))
    with pytest.raises(
        InvalidInput, match=r"position of body 0 is \[0\.0, 0\.0, 5\.0\] m.*holds it at \[0\.0, 0\.0, -1\.0\]"
    ):
        scene.state(position=(0, 0, 5))
    scene.state(position=(0, 0, -1))


def test_body_held_twice_is_refused():
    """Two points of a body that are held leave it an axis; the equations of one fixed point would be silently wrong."""
    scene = rb.Scene(
        rb.replicate(rb.Body(1.0, 1.0), 2), (rb.FixedPoint((0, 0, 1)), rb.FixedPoint((1, 0, 0), bodies=(1,)))
    )
    with pytest.raises(WrongStructure, match="body 1 is held by more than one FixedPoint"):
        scene.state()


def test_custom_force_must_return_a_wrench():
    scene = rb.Scene(rb.Body(1.0, 1.0), rb.CustomForce(lambda body, state, parameters: jnp.zeros(3)))
    with pytest.raises(
        WrongStructure, match=r"CustomForce: .* returned .*; return Wrench\(force=…, torque=…\)"
    ):
        rb.step(scene, scene.state())


def test_traced_numbers_pass_and_the_shape_is_still_checked(dtype):
    """In a fit a coefficient may go anywhere for a moment; what goes wrong shows in the status."""

    def loss(c):
        scene = rb.Scene(
            rb.Body(c[0] + 2, c[0] + 3), (rb.LinearDrag(c[0]), rb.UniformGravity(c), rb.SpringDamper(c[1]))
        )
        state = scene.state(position=c, velocity=c)
        return rb.rollout(scene, state, dt=c[2], steps=2).final.position.sum()

    assert np.isfinite(jax.jit(jax.grad(loss))(jnp.asarray([-1.0, -2.0, 0.1], dtype))).all()
    with pytest.raises(WrongStructure, match=r"UniformGravity\.acceleration"):
        jax.jit(lambda g: rb.UniformGravity(g).acceleration)(jnp.ones(2, dtype))
