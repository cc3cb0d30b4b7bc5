"""All effects × all built-in scenes: a scene from which an effect was taken is the program that never had it."""

import inspect
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
import jaxrb.effects
from jaxrb.accuracy.cost import without
from jaxrb.effects.effect import Effect, Force
from jaxrb.scene.contact_library import CONTACT_SCENES
from jaxrb.scene.library import SCENES

pytestmark = pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"),
    reason="which operations a program has does not depend on the precision",
)


def _still(time, parameters):
    return rb.Pose(jnp.zeros(3), rb.Quaternion(jnp.asarray([1.0, 0.0, 0.0, 0.0])))


EFFECTS = (
    rb.UniformGravity(),
    rb.CentralGravity(1.0, (0.0, 0.0, 9.0)),
    rb.GravityGradient(1.0, (0.0, 0.0, 9.0)),
    rb.MutualGravity(),
    rb.LinearDrag(0.1, angular_coefficient=0.1, wind=(1.0, 0.0, 0.0)),
    rb.QuadraticDrag(0.1, 1.0),
    rb.WindField(rb.LinearDrag(0.1), lambda position, time, parameters: 0.1 * position),
    rb.Buoyancy(1e-3),
    rb.MagnusForce(0.1),
    rb.PlateAerodynamics((0.0, 0.0, 1.0), 0.1),
    rb.SpringDamper(1.0),
    rb.AngularSpring(1.0),
    rb.BodyThruster((0.0, 0.0, 1.0)),
    rb.PrescribedTorque((0.0, 0.0, 1.0)),
    rb.MagneticTorque((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    rb.Motor((0.0, 0.0, 1.0), 1.0, 1.0, torque_limit=0.1),
    rb.PrescribedMotion(_still),
    rb.CustomForce(lambda body, state, parameters: rb.Wrench(force=-state.position)),
)
NAMES = {type(effect).__name__ for effect in EFFECTS}
# Constraints and contact decide how a step is made; scenes with and without them are compared elsewhere.
APART = {"FixedPoint", "RigidContact", "CompliantContact"}


def lowered(scene, state, **options):
    return jax.jit(lambda s, y: rb.step(s, y)).lower(scene, state).as_text(**options)


def test_no_effect_is_forgotten_here():
    public = {
        name
        for name, kind in inspect.getmembers(jaxrb.effects, inspect.isclass)
        if issubclass(kind, Effect) and kind not in (Effect, Force)
    }
    assert public - APART == NAMES


@pytest.mark.parametrize("name", [*SCENES, "bouncing_ball", "spinning_coin"])
def test_scene_without_added_effects_is_the_program_that_never_had_them(name):
    """Byte for byte, in what goes to the compiler."""
    every = SCENES | CONTACT_SCENES
    example = every[name]()
    scene, state = example.scene, example.state()
    own = len(scene.effects)
    blocked = {"PrescribedMotion"} if name in (*CONTACT_SCENES, "heavy_top", "lagrange_top") else set()
    added = tuple(effect for effect in EFFECTS if type(effect).__name__ not in blocked)
    crowded = rb.Scene(scene.bodies, (*scene.effects, *added))
    again = without(crowded, range(own, own + len(added)))
    assert lowered(again, state) == lowered(every[name]().scene, state)


@pytest.fixture(scope="module")
def brick():
    scene = rb.Scene((rb.Body(2.0, (1.0, 2.0, 2.5)), rb.Body(1.0, (0.3, 0.2, 0.4))))
    return scene, scene.state(position=[(1, 0, 0), (0, 2, 0)], velocity=np.ones(3).tolist())


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: type(effect).__name__)
def test_effect_is_in_the_program_of_a_scene_that_has_it_and_in_no_other(brick, effect):
    scene, state = brick
    text = lowered(rb.Scene(scene.bodies, effect), state, debug_info=True)
    others = {name for name in NAMES if re.search(rf"\b{name}\b", text)}
    inside = {"LinearDrag"} if isinstance(effect, rb.WindField) else set()
    assert others == {type(effect).__name__} | inside
