"""Crowds: no pair is lost, the heap is held apart as few bodies are, and what does not fit or cannot be is said."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.collision.broadphase import body_pairs
from jaxrb.collision.grid import grid_pairs
from jaxrb.contact.point_memory import first_points, recalled_points, remembered_points
from jaxrb.scene.contact_library import sphere_box

COUNT, DT, STEPS = 60, 5e-3, 60
QUICK = rb.compiler_options()


@pytest.fixture(scope="module")
def heap(dtype):
    """A box of balls that fell for 0.3 s, and where they came to."""
    example = sphere_box(COUNT)
    path = rb.rollout(example.scene, example.state(dtype=dtype), dt=DT, steps=STEPS, save_every=10)
    return example, path


def test_crowd_settles_with_less_energy_each_time_and_little_overlap(heap):
    _, path = heap
    energy = np.asarray(path.diagnostics.energy)
    assert (np.diff(energy) < 1e-5 * energy[0]).all()
    assert energy[-1] < 0.99 * energy[0]
    assert path.contact.points[-1] > COUNT
    place = np.asarray(path.final.position, float)
    apart = np.linalg.norm(place[:, None] - place[None], axis=-1)[np.triu_indices(COUNT, 1)]
    assert 0.1 - apart.min() < 2e-3  # [m]; a ball is 0.1 m thick, and the report speaks of the same
    assert float(path.contact.penetration[-1]) < 2e-3
    assert place[:, 2].min() > 0.05 - 2e-3


def test_crowd_without_ground_keeps_momentum_and_angular_momentum(dtype, tolerance):
    random = np.random.default_rng(0)
    place = 0.1 * np.array([(i, j, k) for i in range(3) for j in range(3) for k in range(3)], float)
    body = rb.Body.from_shape(rb.Sphere(0.05), density=1000.0)
    scene = rb.Scene(rb.replicate(body, 27), (rb.RigidContact(friction=0.5, solver="sparse"),))
    state = scene.state(
        position=place + random.uniform(-1e-3, 1e-3, place.shape),
        velocity=random.normal(size=place.shape) - 10 * (place - place.mean(axis=0)),
        angular_velocity=random.normal(size=place.shape),
        dtype=dtype,
    )
    path = rb.rollout(scene, state, dt=1e-3, steps=20, save_every=20, on_error="flag")
    assert path.contact.points[-1] > 20
    found = path.diagnostics
    most = 27 * float(body.mass)
    limit = most * tolerance(float64=1e-13, float32=1e-5)
    np.testing.assert_allclose(found.momentum[-1], found.momentum[0], atol=limit)
    np.testing.assert_allclose(found.angular_momentum[-1], found.angular_momentum[0], atol=limit)


def test_balls_of_a_crowd_go_from_sliding_to_rolling_with_five_sevenths_of_their_speed(dtype):
    ball = rb.Body.from_shape(rb.Sphere(0.05), density=1000.0)
    effects = (
        rb.UniformGravity(),
        rb.RigidContact(rb.HalfSpace(), friction=0.2),
        rb.RigidContact(friction=0.2, solver="sparse"),
    )
    scene = rb.Scene(rb.replicate(ball, 2), effects)
    start = {"position": [(0, 0, 0.05), (0.3, 0, 0.05)], "velocity": [(1, 0, 0), (0, 1, 0)]}
    path = rb.rollout(scene, scene.state(**start, dtype=dtype), dt=DT, steps=100, save_every=100)
    np.testing.assert_allclose(np.abs(path.final.velocity[:, :2]).max(axis=1), 5 / 7, rtol=2e-3)
    assert path.contact.poor[-1] == 0


def test_too_little_room_for_pairs_is_told(dtype):
    example = sphere_box(COUNT)
    effects = (*example.scene.effects[:2], rb.RigidContact(friction=0.3, solver="sparse", capacity=5))
    scene = rb.Scene(example.scene.bodies, effects)
    with pytest.raises(rb.RunFailed, match="raise capacity"):
        rb.rollout(scene, example.state(dtype=dtype), dt=DT, steps=STEPS, save_every=STEPS)


def test_what_a_crowd_cannot_do_is_refused_by_name(heap):
    example, path = heap

    def height(speed):
        state = dataclasses.replace(path.final, velocity=path.final.velocity + speed)
        return rb.rollout(example.scene, state, dt=DT, steps=1, on_error="flag").final.position[:, 2].sum()

    with pytest.raises(rb.WrongStructure, match="no derivative through the sparse solve"):
        jax.grad(height)(0.0)
    with pytest.raises(rb.WrongStructure, match="solver: 'fast'"):
        rb.RigidContact(solver="fast")
    touch = (rb.RigidContact(solver="sparse"), rb.RigidContact(solver="newton"))
    divided = rb.Scene(example.scene.bodies, touch)
    with pytest.raises(rb.WrongStructure, match="both newton and sparse"):
        divided.prepared(jnp.float32)
    with pytest.raises(rb.WrongStructure, match="crowd"):
        _ = example.scene.prepared(jnp.float32).contact.meetings


def test_grid_finds_all_pairs_that_overlap(dtype):
    random = np.random.default_rng(1)
    search = jax.jit(lambda low, high: grid_pairs(low, high, 4000), compiler_options=QUICK)
    for spread in ((1.0, 1.0, 1.0), (4.0, 0.1, 0.1), (1e-3, 1e-3, 1e3), (0.0, 0.0, 4.0)):
        middle = random.uniform(-1, 1, (400, 3)) * spread
        half = random.uniform(0.02, 0.04, (400, 3)) * (0.5 if min(spread) == 0 else 1.0)
        low, high = (np.asarray(side, dtype) for side in (middle - half, middle + half))
        meets = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=-1)
        truth = set(zip(*np.nonzero(np.triu(meets, 1)), strict=True))
        found = search(low, high)
        if bool(found.crowded):
            both = jax.jit(lambda low, high: body_pairs(low, high, 40_000), compiler_options=QUICK)(low, high)
            found = found._replace(first=both.first, second=both.second, count=both.count)
        pairs = {(int(i), int(j)) for i, j in zip(found.first, found.second, strict=True) if i >= 0}
        assert pairs == truth
        assert int(found.count) == len(truth)


def test_points_remember_their_impulses_whatever_their_order(dtype):
    random = np.random.default_rng(2)
    names = random.permutation(np.array([(i, j, k) for i in range(20) for j in range(30) for k in range(2)]))
    old, new = names[:600].astype(np.int32), random.permutation(names)[:900].astype(np.int32)
    impulse = random.normal(size=(600, 1, 3)).astype(dtype)
    memory = remembered_points(tuple(jnp.asarray(old.T)), jnp.asarray(impulse))
    found = np.asarray(jax.jit(recalled_points)(tuple(jnp.asarray(new.T)), memory))
    known = {tuple(name): push for name, push in zip(old.tolist(), impulse, strict=True)}
    lost = 0
    for name, push in zip(new.tolist(), found, strict=True):
        expected = known.get(tuple(name), np.zeros((1, 3)))
        lost += int(np.any(expected != push) and not push.any())
        assert np.array_equal(push, expected) or not push.any()
    assert lost <= 0.02 * len(old)
    assert not recalled_points(tuple(jnp.asarray(new.T)), first_points(600, dtype)).any()
