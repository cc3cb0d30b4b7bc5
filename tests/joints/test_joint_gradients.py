"""Derivatives through joints, forward and reverse, against differences; systems that are not of full rank."""

import jax
import jax.numpy as jnp
import joint_scenes as js
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.joints.banded import Banded, blocked, ordered, unblocked

X64 = pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="differences need float64")


def tip(numbers):
    """Where the end of a double pendulum with a spring is after some steps from where it was assembled.

    Numbers: gravity, mass, anchor (height of the second hinge in the first rod), stiffness, tilt of the rough start.
    """
    rod = js.rod(1.0, 1.0)
    second = rb.Body(numbers["mass"], rod.inertia)
    y = (0, 1.0, 0)
    down = jnp.stack([0.0 * numbers["gravity"], 0.0 * numbers["gravity"], -numbers["gravity"]])
    anchor = jnp.stack([0.0 * numbers["anchor"], 0.0 * numbers["anchor"], -numbers["anchor"]])
    spring = rb.JointSpring(numbers["stiffness"], 0.3)
    effects = (
        rb.UniformGravity(down),
        rb.Hinge(y, (0, 0, 0.5), bodies=(0, None)),
        rb.Hinge(y, (0, 0, 0.5), (0, 0, 0), bodies=(0, None)),  # says the same once more
        rb.Hinge(y, (0, 0, 0.5), anchor, bodies=(1, 0), drives=spring),
    )
    scene = rb.Scene((rod, second), effects)
    tilt = 0.5 * numbers["tilt"]
    turn = jnp.stack([jnp.cos(tilt), 0.0 * tilt, jnp.sin(tilt), 0.0 * tilt])
    wxyz = jnp.stack([turn, jnp.asarray([1.0, 0, 0, 0])])
    state = rb.State(
        jnp.asarray([[-0.3, 0, -0.4], [-0.5, 0, -1.4]]),
        rb.Quaternion(wxyz),
        jnp.zeros((2, 3)),
        jnp.asarray([[0, 1.0, 0], [0, -2.0, 0]]),
        jnp.zeros(()),
    )
    state = rb.assembled(scene, state)

    def step(state, _):  # one evaluation a step: a smaller program than that of `rollout`
        return rb.step(scene, state, None, 0.02, method="SemiImplicitEuler"), None

    final, _ = jax.lax.scan(step, state, length=15)
    return final.point_position(jnp.asarray([0.1, 0.0, -0.5]))[1] @ jnp.asarray([1.0, 0.3, 0.7])


@X64
def test_gradients_through_joints_are_those_of_differences():
    """Of masses, gravity, anchors, springs and of a rough start, through assembly and doubled joints."""
    at = {"gravity": 9.81, "mass": 1.3, "anchor": 0.45, "stiffness": 2.0, "tilt": 0.6}
    at = {key: jnp.asarray(value) for key, value in at.items()}
    names = list(at)

    def all_ways(at):
        reverse = jax.grad(tip)(at)
        steps = jnp.asarray(
            [[h * s * (i == j) for j in range(5)] for i in range(5) for s in (-1, 1) for h in (1e-4,)]
        )
        moved = jax.vmap(lambda d: tip({k: at[k] + d[i] for i, k in enumerate(names)}))(steps)
        along = {k: jnp.asarray(1.0 + i) for i, k in enumerate(names)}
        return reverse, jax.jvp(tip, (at,), (along,))[1], (moved[1::2] - moved[::2]) / 2e-4

    reverse, forward, differences = jax.jit(all_ways, compiler_options=rb.compiler_options())(at)
    found = np.array([reverse[k] for k in names])
    assert (np.abs(found) > 1e-3).all()
    np.testing.assert_allclose(found, differences, rtol=2e-7, atol=2e-8)
    np.testing.assert_allclose(forward, found @ np.arange(1.0, 6.0), rtol=1e-9)


def system(rank, rows, band, dtype):
    """A banded A = B Bᵀ with its pairs of rows, and a right-hand side in its range."""
    random = np.random.default_rng(rank)
    b = np.where(np.abs(np.subtract.outer(np.arange(rows), np.arange(rows))) <= band // 2, 1.0, 0.0)
    b = b * random.normal(size=(rows, rows))
    b[:, rank:] = 0.0
    a = b @ b.T
    one, other = np.nonzero(a)
    return (
        jnp.asarray(a, dtype),
        one.astype(np.int32),
        other.astype(np.int32),
        jnp.asarray(b @ np.ones(rows), dtype),
    )


@pytest.mark.parametrize(("rows", "rank"), [(12, 12), (12, 7), (90, 90), (90, 80)])
def test_systems_are_solved_whatever_their_rank(rows, rank, dtype, tolerance):
    a, one, other, right = system(rank, rows, 8, dtype)
    place, width = ordered(one, other, rows)
    assert sorted(place) == list(range(rows))
    assert (width == rows) == (rows == 12)
    matrix = Banded.of_entries(one, other, a[one, other], place, width)
    x = unblocked(matrix.solve(blocked(right, place, width)), place)
    np.testing.assert_allclose(a @ x, right, atol=tolerance(float64=1e-6, float32=5e-2) * np.abs(right).max())
    np.testing.assert_allclose(
        unblocked(matrix.times(blocked(x, place, width)), place),
        a @ x,
        atol=tolerance(float64=1e-9, float32=1e-2),
    )
