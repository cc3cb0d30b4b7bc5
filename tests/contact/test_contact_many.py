"""Many contact problems at once have the answers that each has alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.contact.detection import detect
from jaxrb.contact.many import solve_all
from jaxrb.contact.problem import Problem
from jaxrb.contact.solver import solve_contacts

COUNT, WORLDS, DT = 40, 2, 1e-2


@pytest.fixture(scope="module")
def problems(dtype) -> tuple[Problem, jax.Array]:
    """Worlds of boxes that lie on a floor, lean against a wall, fall into the corner, or fly; with their starts.

    Without friction, so that the motion is unique: a body wedged between two planes may stick in more ways than one.
    """
    floor = rb.HalfSpace()
    wall = rb.HalfSpace(normal=(1.0, 0.0, 0.0))
    body = rb.Body.from_shape(rb.Box((0.1, 0.2, 0.3)), 1000.0)
    scene = rb.Scene(rb.replicate(body, COUNT), (rb.RigidContact((floor, wall)),))
    random = np.random.default_rng(0)
    place = random.uniform(0.1, 0.6, (WORLDS, COUNT, 3))
    turn = random.normal(size=(WORLDS, COUNT, 4))
    turn[:, ::4] = 1, 0, 0, 0
    rows = (
        place,
        turn / np.linalg.norm(turn, axis=-1, keepdims=True),
        *random.normal(size=(2, *place.shape)),
    )
    states = jax.vmap(scene.state)(*(jnp.asarray(row, dtype) for row in rows))

    def problem(state):
        dynamics = scene.prepared(dtype)
        contact = dynamics.contact
        parts = (contact.rules, contact.kinds, contact.obstacles, contact.meetings)
        memory = contact.first_memory(state).memory
        detected = detect(*parts, state, jnp.full(COUNT, 0.02, dtype), memory)
        return contact._problem(dynamics, state, state, detected, DT)[0], detected.start

    return jax.jit(jax.vmap(problem))(states)


def test_bodies_that_touch_only_what_stands_still_are_solved_one_by_one(problems, tolerance):
    together = jax.jit(jax.vmap(solve_contacts))(*problems)
    rows = jax.jit(jax.vmap(solve_all))(*problems)
    impulse = np.abs(together.impulse).sum((-1, -2))
    assert (impulse > 0).any(axis=1).all()
    assert (impulse == 0).any(axis=1).all()
    np.testing.assert_allclose(rows.motion, together.motion, atol=tolerance(float64=1e-7, float32=3e-3))
    assert not rows.poor.any()


def test_a_world_is_solved_as_it_is_alone(problems, dtype):
    solve = jax.jit(solve_all)
    both = jax.jit(jax.vmap(solve_all))(*problems)
    for number in range(WORLDS):
        alone = solve(*jax.tree.map(lambda leaf, i=number: leaf[i], problems))
        np.testing.assert_allclose(both.motion[number], alone.motion, atol=64 * float(jnp.finfo(dtype).eps))
