"""What a run is said to need of memory, before it runs."""

import jax.numpy as jnp
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, WrongStructure

SCENE = rb.Scene(rb.Body(1.0, (1.0, 2.0, 2.5)), rb.UniformGravity())
RUN = {"dt": 1e-3, "steps": 1000, "save_every": 10}


def test_saved_states_are_counted(dtype):
    found = rb.memory(SCENE, SCENE.state(), **RUN)
    a_state = 14 * jnp.dtype(dtype).itemsize  # position, quaternion, two velocities, time
    assert 102 * a_state <= found.results <= 102 * a_state + 512  # the start, a hundred more, the end
    assert (
        found.working <= 100 * a_state + 512
    )  # the hundred, before the start is put before them; and a step's own
    assert found.total == found.given + found.results + found.working
    assert "at the peak" in found.summary()


def test_worlds_multiply_it():
    one, many = (rb.memory(SCENE, SCENE.state(), worlds=n, **RUN) for n in (1, 50))
    assert many.results == pytest.approx(50 * one.results, rel=0.02)  # but for the list of results itself


@pytest.mark.parametrize(("few", "many", "least", "most"), [(400, 6400, 8, 18), (20_000, 320_000, 3, 6)])
def test_a_gradient_keeps_what_it_needs_on_the_way(few, many, least, most):
    """The start of each step, which is linear; of long runs the ends and one block of about √n steps."""
    fewer, more = (
        rb.memory(SCENE, SCENE.state(), dt=1e-3, steps=n, save_every=n, gradient=True) for n in (few, many)
    )
    assert fewer.results < 1000  # a number for each of scene and state
    assert least < more.working / fewer.working < most


def test_bad_numbers_are_refused():
    with pytest.raises((InvalidInput, WrongStructure), match="worlds"):
        rb.memory(SCENE, SCENE.state(), worlds=0, **RUN)
