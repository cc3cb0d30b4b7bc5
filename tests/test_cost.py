"""What effects cost, and which a scene does not call for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.accuracy.cost import count_equations, count_operations, names, without
from jaxrb.accuracy.differences import difference
from jaxrb.scene.library import example_of

BODY = rb.Body(1.0, (1.0, 2.0, 2.5))
EFFECTS = (
    rb.UniformGravity(),
    rb.LinearDrag(1e-3, angular_coefficient=1e-4),
    rb.QuadraticDrag(coefficient=0.4, area=0.02),
    rb.PrescribedTorque((0.0, 0.0, 1e-3)),
)


@pytest.fixture(scope="module")
def report():
    scene = rb.Scene(BODY, EFFECTS)
    state = scene.state(angular_velocity=[(0.1, 0.2, 1.0)], velocity=[(1.0, 0.0, 0.0)])
    return rb.cost(scene, state, dt=2e-3, steps=500, rounds=3)


def test_every_effect_is_priced(report):
    assert {effect.name for effect in report.effects} == set(names(rb.Scene(BODY, EFFECTS)))
    assert report.whole.step_seconds > 0
    assert report.bare.equations < report.whole.equations
    for effect in report.effects:
        assert effect.size.equations < report.whole.equations
        assert effect.size.operations < report.whole.operations
    total = report.share_of_motion + sum(effect.share for effect in report.effects)
    assert report.shares_add_up_to == pytest.approx(total)
    assert "the motion itself" in report.summary()
    assert report.as_dict()["shares_add_up_to"] == report.shares_add_up_to


def test_dropping_gravity_changes_the_fall_by_what_galileo_says(report, tolerance):
    (gravity,) = [effect for effect in report.effects if effect.name == "UniformGravity"]
    # The drag that remains takes less than a hundredth.
    assert gravity.difference.position == pytest.approx(0.5 * 9.81 * 1.0**2, rel=1e-2)
    assert gravity.difference.attitude < tolerance(float64=1e-12, float32=1e-5)


def test_dropping_a_torque_changes_the_attitude_by_what_it_turns(dtype):
    scene = rb.Scene(rb.Body(1.0, 2.0), rb.PrescribedTorque((0.0, 0.0, 1e-2)))
    state = scene.state(dtype=dtype)
    found = difference(scene, without(scene, [0]), state, 0.01, 100, rb.RungeKutta4())
    assert found.attitude == pytest.approx(0.5 * 1e-2 / 2.0, rel=1e-3)
    assert found.angular_velocity == pytest.approx(1e-2 / 2.0, rel=1e-3)


def test_equations_and_operations_are_counted():
    def function(x):
        return jax.lax.fori_loop(0, 3, lambda _, y: jnp.sin(y) + 1.0, x)

    # Inside the loop: i + 1, sin, +.
    assert count_equations(jax.make_jaxpr(function)(1.0).jaxpr) == 3
    one = jax.jit(lambda x: x + 1.0).lower(1.0).compile().as_text()
    more = jax.jit(lambda x: jnp.sort(x) + 1.0).lower(np.zeros(8)).compile().as_text()
    assert 0 < count_operations(one) < count_operations(more)


@pytest.mark.parametrize("dropped", range(len(EFFECTS)), ids=[type(e).__name__ for e in EFFECTS])
def test_a_scene_without_an_effect_is_the_program_that_never_had_it(dropped):
    """Byte for byte, in what goes to the compiler."""
    kept = tuple(effect for i, effect in enumerate(EFFECTS) if i != dropped)

    def text(scene):
        return jax.jit(lambda s, y: rb.step(s, y)).lower(scene, scene.state()).as_text()

    assert text(without(rb.Scene(BODY, EFFECTS), [dropped])) == text(rb.Scene(BODY, kept))
    assert text(rb.Scene(BODY, EFFECTS)) != text(rb.Scene(BODY, kept))


def random_scene(seed):
    """Effects that matter much, little or not at all."""
    random = np.random.default_rng(seed)
    size = 10.0 ** random.uniform(-7, 0, size=4)
    effects = (
        rb.UniformGravity((0.0, 0.0, -size[0])),
        rb.LinearDrag(size[1], angular_coefficient=size[2]),
        rb.PrescribedTorque(size[3] * random.normal(size=3)),
    )
    scene, start = rb.Scene(BODY, effects), random.normal(size=(2, 1, 3)).tolist()
    return scene, scene.state(velocity=start[0], angular_velocity=start[1])


@pytest.mark.parametrize("tolerance_exponent", [-2, -4])
def test_nothing_is_dropped_that_changes_the_motion_beyond_the_tolerance(tolerance_exponent, dtype):
    wanted, dropped = 10.0**tolerance_exponent, set()
    for seed in range(25):
        scene, state = random_scene(seed)
        found = rb.recommend(scene, state, 2.0, wanted, steps=64)
        # Judged by another step and at other times than those of the recommendation.
        judged = difference(scene, found.scene, state, 2.0 / 96, 96, rb.RungeKutta4())
        assert judged.largest <= 1.02 * wanted + 10 * float(jnp.finfo(dtype).eps)
        assert set(found.kept) | set(found.dropped) == set(names(scene))
        dropped |= set(found.dropped)
    assert len(dropped) == 3  # each of them in some scene


def test_effects_that_matter_together_are_not_both_dropped(dtype):
    """Two equal torques, each within the tolerance, both beyond it."""
    push = rb.PrescribedTorque((0.0, 0.0, 0.75e-2))
    scene = rb.Scene(rb.Body(1.0, 0.5), (push, push))
    found = rb.recommend(scene, scene.state(dtype=dtype), 1.0, 1e-2, steps=32)
    assert len(found.dropped) == 1
    assert "needed" in found.summary()


def test_a_scene_that_a_program_in_float32_holds_is_judged_in_float64(dtype):
    """What JAX keeps of the scene's arrays in one precision must not reach the other."""
    brick = rb.Body.from_shape(rb.Box((0.10, 0.05, 0.02)), density=700.0)
    scene = rb.Scene(brick, (rb.UniformGravity(), rb.QuadraticDrag(0.4, 0.02)))
    held = jax.jit(rb.stepper(scene, dt=1e-3))  # as long as it lives, so does what JAX keeps
    state = held(scene.state(angular_velocity=(0.0, 5.0, 0.1), dtype=dtype))
    assert rb.recommend(scene, state, t1=0.2, tolerance=1e-2).dropped


def test_recommendation_of_a_built_in_scene_chooses_its_own_steps():
    example = example_of("thrown_brick")
    found = rb.recommend(example.scene, example.state(), example.duration, 1e-3)
    assert found.kept == ("UniformGravity", "QuadraticDrag")
    assert found.as_dict()["dropped"] == ()


def test_cost_and_recommendation_cannot_be_traced():
    scene = rb.Scene(BODY, EFFECTS)
    with pytest.raises(rb.WrongStructure, match="jit"):
        jax.jit(lambda s: rb.recommend(scene, s, 1.0, 1e-3).steps)(scene.state())
    with pytest.raises(rb.WrongStructure, match="jit"):
        jax.jit(lambda s: rb.cost(scene, s).steps)(scene.state())
