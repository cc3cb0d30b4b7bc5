"""All effects × all built-in scenes: a scene from which an effect was taken is the program that never had it."""

import inspect
import re

import jax
import numpy as np
import pytest

import jaxrb as rb
import jaxrb.effects
from jaxrb.bench.absent import EFFECTS, lowered, same_program
from jaxrb.effects.effect import Effect, Force
from jaxrb.scene.contact_library import CONTACT_SCENES
from jaxrb.scene.library import SCENES

pytestmark = pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"),
    reason="which operations a program has does not depend on the precision",
)


NAMES = {type(effect).__name__ for effect in EFFECTS}
# Constraints and contact decide how a step is made; scenes with and without them are compared elsewhere.
APART = {"FixedPoint", "RigidContact", "CompliantContact"}


def test_no_effect_is_forgotten_here():
    public = {
        name
        for name, kind in inspect.getmembers(jaxrb.effects, inspect.isclass)
        if issubclass(kind, Effect) and kind not in (Effect, Force)
    }
    assert public - APART == NAMES


@pytest.mark.parametrize("name", SCENES | CONTACT_SCENES)
def test_scene_without_added_effects_is_the_program_that_never_had_them(name):
    """Byte for byte, in what goes to the compiler."""
    assert same_program(name)


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
