"""Runs: what is saved, what is counted, what is raised, what a gradient costs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.scene.status import NOT_A_ROTATION, NOT_FINITE

BRICK = rb.Body(mass=2.0, inertia=(1.0, 2.0, 2.5))
SPIN = (0.3, 1.0, 0.2)


@pytest.fixture(scope="module")
def free():
    scene = rb.Scene(BRICK)
    return scene, scene.state(velocity=(1.0, 0.0, 0.0), angular_velocity=SPIN)


def leaves_equal(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)


def test_rollout_is_repeated_step(free, tolerance):
    scene, state = free
    path = rb.rollout(scene, state, dt=0.01, steps=7)
    for k in range(7):
        state = rb.step(scene, state, None, 0.01)
        for saved, stepped in zip(jax.tree.leaves(path.states), jax.tree.leaves(state), strict=True):
            np.testing.assert_allclose(saved[k + 1], stepped, atol=tolerance(float64=1e-15, float32=1e-6))


def test_saves_every_kth_state_and_always_the_last(free):
    scene, state = free
    every = rb.rollout(scene, state, dt=0.01, steps=23)
    fifth = rb.rollout(scene, state, dt=0.01, steps=23, save_every=5)
    np.testing.assert_array_equal(fifth.times, every.times[::5])
    np.testing.assert_allclose(fifth.states.position, every.states.position[::5], atol=1e-6)
    np.testing.assert_allclose(fifth.final.position, every.states.position[-1], atol=1e-6)
    assert float(fifth.final.time) == pytest.approx(0.23)


@pytest.mark.parametrize("steps", [64, 65, 97, 1000])
def test_blocks_of_long_stretches_lose_no_step(free, steps):
    scene, state = free
    path = rb.rollout(scene, state, dt=1.0, steps=steps, save_every=2000)
    assert float(path.final.position[0, 0]) == pytest.approx(steps, rel=1e-5)
    assert float(path.final.time) == steps


def test_no_steps_return_the_initial_state(free):
    scene, state = free
    path = rb.rollout(scene, state, dt=0.01, steps=0)
    leaves_equal(path.final, state)
    assert path.times.shape == (1,)


def test_time_is_counted_not_summed(dtype):
    scene = rb.Scene(rb.Body(1.0, 1.0))
    path = rb.rollout(scene, scene.state(), dt=0.1, steps=100_000, save_every=100_000)
    assert float(path.final.time) == pytest.approx(1e4, rel=4 * float(jnp.finfo(dtype).eps))


def test_varying_torque_reaches_its_step():
    scene = rb.Scene(rb.Body(1.0, 2.0))
    torque = np.zeros((90, 1, 3))
    torque[70, 0, 2] = 4.0
    path = rb.rollout(scene, scene.state(), dt=0.5, steps=90, save_every=80, torque=torque)
    np.testing.assert_allclose(path.states.angular_velocity[1, 0], (0, 0, 1.0), atol=1e-6)
    early = rb.rollout(scene, scene.state(), dt=0.5, steps=70, torque=torque[:70])
    np.testing.assert_array_equal(early.final.angular_velocity[0], (0, 0, 0))


def blow_up(body, state, parameters):
    force = jnp.where(state.time > parameters, jnp.nan, 1.0) * jnp.ones(3, state.velocity.dtype)
    return rb.Wrench(force=force)


def failing_scene(time):
    bodies = rb.replicate(BRICK, 3)
    return rb.Scene(bodies, rb.CustomForce(blow_up, parameters=np.asarray(time), bodies=(1,)))


def test_status_names_the_first_bad_step_and_body():
    scene = failing_scene(0.55)
    with pytest.raises(rb.RunFailed, match=r"body 1: .*not finite.*step 6") as caught:
        rb.rollout(scene, scene.state(), dt=0.1, steps=10)
    assert "smaller step" in str(caught.value)
    path = rb.rollout(scene, scene.state(), dt=0.1, steps=10, on_error="flag")
    np.testing.assert_array_equal(path.status.first_bad_step, (-1, 6, -1))
    np.testing.assert_array_equal(path.status.reason, (0, NOT_FINITE, 0))
    assert not bool(path.status.ok)


def test_first_bad_step_of_a_single_body_is_the_first_the_last_or_any():
    """Of one body a step's beginning is looked at, not its result: neither end may be lost."""

    def scene(time):
        return rb.Scene(BRICK, rb.CustomForce(blow_up, parameters=time))

    def found(time):
        path = rb.rollout(scene(time), scene(time).state(), dt=0.1, steps=10, on_error="flag")
        return path.status.first_bad_step[0]

    times, steps = (0.05, 0.55, 0.95, 9.0), (1, 6, 10, -1)
    np.testing.assert_array_equal(jax.vmap(found)(jnp.asarray(times)), steps)
    for time, step in zip(times, steps, strict=True):
        path = rb.run(scene(np.asarray(time)), scene(9.0).state(), dt=0.1, steps=10, chunk=4, on_error="flag")
        assert int(path.status.first_bad_step[0]) == step


def test_bad_body_changes_no_bit_of_its_neighbours():
    good = rb.rollout(failing_scene(99.0), failing_scene(99.0).state(velocity=(1, 2, 3)), dt=0.1, steps=10)
    bad = rb.rollout(
        failing_scene(0.5), failing_scene(0.5).state(velocity=(1, 2, 3)), dt=0.1, steps=10, on_error="flag"
    )
    for body in (0, 2):
        np.testing.assert_array_equal(good.states.position[:, body], bad.states.position[:, body])


def test_status_passes_through_jit_and_vmap_and_is_raised_outside():
    @jax.jit
    @jax.vmap
    def worlds(time):
        scene = failing_scene(1.0)
        scene = rb.Scene(scene.bodies, rb.CustomForce(blow_up, parameters=time, bodies=(1,)))
        return rb.rollout(scene, scene.state(), dt=0.1, steps=10)

    path = worlds(jnp.asarray([9.0, 0.35]))
    np.testing.assert_array_equal(path.status.first_bad_step[:, 1], (-1, 4))
    with pytest.raises(rb.RunFailed, match="world"):
        path.raise_if_bad()


def test_start_that_is_no_rotation_is_flagged_not_repaired(free):
    scene, state = free
    stretched = jax.tree.map(lambda q: 1.1 * q, state.orientation)
    state = rb.State(state.position, stretched, state.velocity, state.angular_velocity, state.time)
    with pytest.raises(rb.RunFailed, match="no rotation"):
        rb.rollout(scene, state, dt=0.01, steps=3)
    path = rb.rollout(scene, state, dt=0.01, steps=3, on_error="flag")
    assert int(path.status.reason[0]) == NOT_A_ROTATION
    watched = rb.rollout(scene, state, dt=0.01, steps=3, method=rb.RungeKutta4(renormalise=False))
    assert bool(watched.status.ok)  # watching the drift is what renormalise=False is for


def test_worlds_of_one_body_equal_one_scene_of_many(tolerance):
    spins = np.random.default_rng(0).normal(size=(5, 3)).tolist()
    many = rb.Scene(rb.replicate(BRICK, 5))
    one = rb.Scene(BRICK)
    together = rb.rollout(many, many.state(angular_velocity=spins), dt=0.01, steps=20).final
    starts = jax.vmap(lambda w: one.state(angular_velocity=w))(jnp.asarray(spins))
    apart = jax.vmap(lambda s: rb.rollout(one, s, dt=0.01, steps=20).final)(starts)
    np.testing.assert_allclose(
        apart.orientation.wxyz[:, 0], together.orientation.wxyz, atol=tolerance(float64=1e-15, float32=1e-6)
    )


def test_reverse_pass_needs_little_memory(free):
    _, state = free

    def memory(steps):
        def loss(inertia):
            scene = rb.Scene(rb.Body(2.0, inertia))
            return jnp.sum(
                rb.rollout(scene, state, dt=1e-3, steps=steps, save_every=steps).final.orientation.wxyz
            )

        compiled = jax.jit(jax.grad(loss)).lower(jnp.asarray([1.0, 2.0, 2.5], state.dtype)).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    # One hundred times the steps: a plain scan would need one hundred times the memory, recomputed blocks ten times.
    assert memory(100 * 400) < 15 * memory(400)


def test_state_of_another_scene_is_refused(free):
    scene, _ = free
    other = rb.Scene(rb.replicate(BRICK, 2))
    with pytest.raises(rb.WrongStructure, match=r"2 bodies|1 bodies"):
        rb.step(scene, other.state())
