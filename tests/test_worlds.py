"""Worlds of different structure in one call: each as it runs alone, one program a structure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, LimitExceeded, RunFailed, WrongStructure
from jaxrb.scene.worlds import _together

BRICK = rb.Body(2.0, (1.0, 2.0, 2.5))
traced: list[str] = []


def _push(body, state, strength):
    traced.append("push")
    return rb.Wrench(force=strength * jnp.ones(3, state.dtype))


def _pull(body, state, strength):
    traced.append("pull")
    return rb.Wrench(torque=-strength * jnp.ones(3, state.dtype))


def world(i):
    """Three structures in turn: two custom forces, and a scene of two bodies."""
    if i % 3 == 2:
        scene = rb.Scene((BRICK, rb.Body(1.0, 0.5 + i)), rb.UniformGravity((0.0, 0.0, -float(i))))
        return scene, scene.state(velocity=[(i, 0, 0), (0, i, 0)])
    scene = rb.Scene(BRICK, rb.CustomForce((_push, _pull)[i % 3], np.asarray(0.1 * i)))
    return scene, scene.state(angular_velocity=(0.1 * i, 1.0, 0.2))


@pytest.fixture(scope="module")
def ran():
    before = _together._cache_size()
    worlds = [world(i) for i in range(7)]
    paths = rb.rollout_worlds(worlds, dt=0.02, steps=50, save_every=10)
    return worlds, paths, _together._cache_size() - before, len(traced)


def test_each_world_runs_as_it_does_alone_and_in_the_order_given(ran, tolerance):
    worlds, paths, *_ = ran
    assert len(paths) == len(worlds)
    alone = [rb.rollout(*world, dt=0.02, steps=50, save_every=10) for world in worlds]
    for one, path in zip(alone, paths, strict=True):
        assert jax.tree.structure(one) == jax.tree.structure(path)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(path), strict=True):
            assert np.shape(a) == np.shape(b)
            np.testing.assert_allclose(a, b, atol=tolerance(float64=1e-13, float32=2e-6))
    np.testing.assert_allclose(
        paths[-2].diagnostics.energy,
        alone[-2].diagnostics.energy,
        rtol=tolerance(float64=1e-13, float32=1e-5),
    )
    assert len(paths[1:5:2]) == 2


def test_worlds_of_one_structure_are_one_program(ran):
    """Seven worlds of three structures: three programs, and none for other numbers in another order."""
    _, paths, programs, pushed = ran
    assert [who.tolist() for who, _ in paths.buckets] == [[0, 3, 6], [1, 4], [2, 5]]
    assert programs == 3
    assert pushed > 0
    before = _together._cache_size()
    traced.clear()
    rb.rollout_worlds([world(i) for i in (3, 1, 5, 0, 2, 6, 4)], dt=0.04, steps=50, save_every=10)
    assert not traced
    assert _together._cache_size() == before


def test_a_parameter_of_all_worlds_has_its_derivative(tolerance):
    def loss(drag):
        worlds = []
        for i in range(3):
            effects = (rb.LinearDrag(drag),) if i % 2 else (rb.UniformGravity(), rb.LinearDrag(drag))
            scene = rb.Scene(BRICK, effects)
            worlds.append((scene, scene.state(velocity=(1.0 + i, 0.0, 0.0))))
        paths = rb.rollout_worlds(worlds, dt=0.1, steps=10, method="SemiImplicitEuler")
        return sum(path.final.velocity[0, 0] for path in paths)

    # (1 − c dt/m)^10 of each velocity
    expected = 6.0 * 10 * (1 - 0.5 * 0.1 / 2.0) ** 9 * (-0.1 / 2.0)
    found = jax.jit(jax.grad(loss))(jnp.asarray(0.5))
    assert float(found) == pytest.approx(expected, rel=tolerance(float64=1e-12, float32=1e-5))


def test_the_world_that_fails_is_named_and_the_others_are_kept():
    calm = rb.Scene(BRICK)
    wild = rb.Scene(BRICK, rb.CustomForce(_explode))
    worlds = [
        (calm, calm.state()),
        (wild, wild.state(position=(1, 0, 0))),
        (calm, calm.state(velocity=(1, 0, 0))),
    ]
    with pytest.raises(RunFailed, match=r"world 1 of 3: body 0: the state is not finite"):
        rb.rollout_worlds(worlds, dt=0.1, steps=10)
    paths = rb.rollout_worlds(worlds, dt=0.1, steps=10, on_error="flag")
    assert [bool(path.status.ok) for path in paths] == [True, False, True]
    np.testing.assert_allclose(paths[2].final.position[0, 0], 1.0, rtol=1e-5)


def _explode(body, state, parameters):
    return rb.Wrench(force=state.position * jnp.inf)


def test_what_is_no_world_is_refused():
    scene = rb.Scene(BRICK)
    state = scene.state()
    with pytest.raises(WrongStructure, match="no worlds were given"):
        rb.rollout_worlds([], dt=0.1, steps=1)
    with pytest.raises(WrongStructure, match=r"world 1 is .*; give pairs \(scene, state\)"):
        rb.rollout_worlds([(scene, state), scene], dt=0.1, steps=1)
    with pytest.raises(WrongStructure, match="world 0: state: positions"):
        rb.rollout_worlds([(rb.Scene((BRICK, BRICK)), state)], dt=0.1, steps=1)
    with pytest.raises(LimitExceeded, match="2 worlds together"):
        rb.rollout_worlds([(scene, state)] * 2, dt=0.1, steps=1000, max_bytes=100_000)
    with pytest.raises(InvalidInput, match="dt is -1"):
        rb.rollout_worlds([(scene, state)], dt=-1.0, steps=1)
