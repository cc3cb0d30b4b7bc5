"""A ceiling on the program of each built-in scene: what makes one larger is seen here before users wait for it.

Sizes, not times, so that the test means the same on every machine: operations of the compiled step for smooth scenes,
equations of the traced step for those with contact, whose compilation takes seconds. `jaxrb bench --what effects`
prints both, and the CPU seconds. Figures that grow for a good reason are raised here, in view of all.
"""

import jax
import pytest

import jaxrb as rb
from jaxrb.accuracy.cost import count_equations, count_operations
from jaxrb.scene.contact_library import CONTACT_SCENES
from jaxrb.scene.library import SCENES

ONCE = pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"), reason="the sizes are those of float64; once is enough"
)
# Equations, and operations: a tenth and a quarter above what was measured (versions of the compiler differ).
SMOOTH = {
    "tumbling_brick": (392, 670),
    "dzhanibekov": (392, 670),
    "heavy_top": (939, 1664),
    "lagrange_top": (939, 1664),
    "thrown_brick": (590, 997),
    "gazebo_boxes": (511, 810),
    "gazebo_boxes_simple": (392, 670),
    "free_boxes": (422, 810),
    "double_spring": (2242, 4530),
}
# Equations, a third above what was measured.
CONTACT = {
    "bouncing_ball": 4000,
    "billiard_break": 8500,
    "slab_with_balls": 6400,
    "block_on_incline": 4100,
    "domino_row": 9900,
    "stack_of_10": 9300,
    "arch": 13000,
    "pile_of_64": 10300,
    "spheres_216": 6000,
    "sphere_box": 6600,
    "cube_toss": 4500,
    "spinning_coin": 4100,
    "tippe_top": 3800,
}


def test_every_built_in_scene_has_a_budget():
    assert set(SMOOTH) == set(SCENES)
    assert set(CONTACT) == set(CONTACT_SCENES)


def traced(example):
    return jax.jit(lambda scene, state: rb.step(scene, state)).trace(example.scene, example.state())


@ONCE
@pytest.mark.parametrize("name", SMOOTH)
def test_program_of_a_step_stays_within_its_budget(name):
    step = traced(SCENES[name]())
    equations, operations = SMOOTH[name]
    assert 0.5 * equations < count_equations(step.jaxpr.jaxpr) <= equations
    assert 0.5 * operations < count_operations(step.lower().compile().as_text()) <= operations


@ONCE
@pytest.mark.parametrize("name", CONTACT)
def test_traced_step_with_contact_stays_within_its_budget(name):
    assert count_equations(traced(CONTACT_SCENES[name]()).jaxpr.jaxpr) <= CONTACT[name]


@pytest.mark.parametrize("name", [*SMOOTH, "bouncing_ball"])
def test_a_step_gives_what_a_step_takes(name):
    """The same shapes, types and weak types: else the second step would be traced and compiled anew."""
    example = (SCENES | CONTACT_SCENES)[name]()
    state = example.state()
    given = [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(state)]
    found = jax.eval_shape(lambda scene, state: rb.step(scene, state), example.scene, state)
    assert [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(found)] == given
    assert not any(weak for *_, weak in given)
    assert jax.tree.structure(found) == jax.tree.structure(state)


def test_one_trace_serves_all_scenes_of_a_structure():
    """Built-in scenes of one structure share their program, whoever made them and in whatever order."""
    traces = []

    @jax.jit
    def step(scene, state):
        traces.append(1)
        return rb.step(scene, state)

    for name in ("tumbling_brick", "dzhanibekov", "gazebo_boxes", "tumbling_brick", "gazebo_boxes"):
        example = SCENES[name]()
        # The shape of a body is part of its scene's structure; mass and inertia alone are not.
        bodies = tuple(rb.Body(body.mass, body.inertia) for body in example.scene.bodies)
        scene, state = rb.Scene(bodies, example.scene.effects), example.state()
        step(scene, step(scene, state))
    assert len(traces) == 2  # with gravity, and without
