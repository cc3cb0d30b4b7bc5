"""G. Points where derivatives divide zero by zero: numbers 94 to 98 of the project's list of bad inputs.

Value, gradient and second derivative as a batch, at the point where the textbook
formula breaks. The values that are right there are those of jaxrb/hard/derivatives.py, and jaxrb/hard/shapes.py has
hulls in one place and hulls that touch [96].
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb

ONE = np.ones(3)
SPHERES = rb.Sphere(0.5), rb.Sphere(0.25)
CORNERS = np.asarray([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def between(a, b, place):
    here = rb.Pose(jnp.zeros_like(place), rb.Quaternion.identity(place.dtype))
    return rb.separation(a, here, b, rb.Pose(place, here.orientation)).distance


def flight(velocity):
    """A body at rest that drag and a spring of no length act on."""
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 3.0)), (rb.QuadraticDrag(0.5, 0.1), rb.SpringDamper(3.0)))
    zero = jnp.zeros((1, 3), velocity.dtype)
    turn = rb.Quaternion(rb.Quaternion.identity(velocity.dtype).wxyz[None])
    state = rb.body.State(zero, turn, velocity[None], velocity[None], jnp.zeros((), velocity.dtype))
    return jnp.sum(rb.step(scene, state, None, 1e-2).position * jnp.asarray(ONE, velocity.dtype))


def sample(x):
    return jnp.asarray([0.3, -0.2, 0.9], x.dtype)


POINTS = {
    "rotation by nothing [94]": (lambda x: jnp.sum(rb.Quaternion.exp(x).rotate(sample(x))), (0, 0, 0)),
    "logarithm of no rotation [94]": (lambda x: jnp.sum(rb.Quaternion.exp(x).log() * sample(x)), (0, 0, 0)),
    "body at rest [94]": (flight, (0, 0, 0)),
    "spheres that touch [95]": (lambda x: between(*SPHERES, x), (0.75, 0, 0)),
    "spheres in one place [95]": (lambda x: between(*SPHERES, x), (0, 0, 0)),
    "corners equally far along a face's normal [96]": (
        lambda x: jnp.sum(rb.ConvexHull(CORNERS).farthest(x) * sample(x)), (0.0, 0.0, 1.0)
    ),
    "matrix of no rotation [98]": (lambda x: jnp.sum(rb.RotationMatrix.exp(x).log() * sample(x)), (0, 0, 0)),
    "angle between equal turns [98]": (
        lambda x: rb.Quaternion.exp(x).angle_to(rb.Quaternion.identity(x.dtype)), (0, 0, 0)
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def derivatives(dtype):
    """`derivatives(name)`: value, gradient and Hessian at a point and beside it, as a batch of two."""

    @functools.cache
    def at(name):
        f, point = POINTS[name]

        def both(x):
            value, slope = jax.value_and_grad(f)(x)
            return slope, (value, slope)

        batch = jnp.asarray(point, dtype) + jnp.asarray([[0.0], [0.125]], dtype)
        run = jax.jit(jax.vmap(jax.jacfwd(both, has_aux=True)), compiler_options=QUICK)
        hessian, (value, slope) = jax.tree.map(np.asarray, run(batch))
        return value, slope, hessian

    return at


@pytest.mark.parametrize("name", POINTS)
def test_value_gradient_second_derivative_and_batch_are_finite(name, derivatives):
    """[97] is in all of them; [98]: no NaN of the branch that is not taken leaks."""
    value, slope, hessian = derivatives(name)
    for part in (value, slope, hessian):
        assert np.isfinite(part).all()
    assert np.abs(slope).max() < 10.0  # nor the quotient of two numbers that are nearly zero


def test_gradients_that_are_known(derivatives, tolerance):
    near = tolerance(float64=1e-12, float32=1e-5)
    v = np.asarray([0.3, -0.2, 0.9])
    assert derivatives("rotation by nothing [94]")[1][0] == pytest.approx(np.cross(v, ONE), abs=near)
    assert derivatives("logarithm of no rotation [94]")[1][0] == pytest.approx(v, abs=near)
    assert derivatives("matrix of no rotation [98]")[1][0] == pytest.approx(v, abs=near)
    assert derivatives("spheres that touch [95]")[1][0] == pytest.approx((1.0, 0, 0), abs=near)
