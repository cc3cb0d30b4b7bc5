"""The order of each method, of a free body against the closed form: halving the step divides the error by 2 to that.

The exact answers of tests/test_oracle.py are not part of the repository; this needs none.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.scene.stretch import begun, stretched

MATRIX = np.asarray([[1.0, 0.1, 0.05], [0.1, 2.0, 0.1], [0.05, 0.1, 2.5]])
SPIN = (0.6, 1.1, -0.7)
# Name: order, steps of the coarser run in one second.
ORDERS = {
    "ExplicitEuler": (1, 200),
    "SemiImplicitEuler": (1, 200),
    "VelocityVerlet": (2, 20),
    "ImplicitMidpoint": (2, 20),
    "RungeKutta4": (4, 10),
    "ThreeAxisSplitting": (2, 20),
    "ThreeAxisSplitting4": (4, 10),
    "MoserVeselov": (2, 20),
    "MoserVeselov4": (4, 8),
    "MoserVeselov6": (6, 4),
}


@pytest.fixture(scope="module")
def flight(dtype):
    """Scene, state, and the exact end."""
    if dtype == jnp.float32:
        pytest.skip("round-off of float32 hides the orders")
    scene = rb.Scene(rb.Body(1.0, MATRIX))
    state = scene.state(angular_velocity=SPIN)
    return scene, state, rb.free_flight(scene, state, t=1.0)


def run(scene, state, method):
    """`run(steps)`: the end after one second; the number of steps is a number of one program."""
    start = begun(scene, state, method)

    def end(dt, steps):
        return stretched(scene, start, None, dt, method, steps, steps, room=2)[0].state

    program = jax.jit(end, compiler_options=QUICK)
    return lambda steps: program(jnp.asarray(1.0 / steps), jnp.int32(steps))


def error(found, exact):
    """Of the attitude [rad], and of the spin [rad/s]."""
    turn = rb.attitude_error(found.orientation.wxyz, exact.orientation.wxyz)
    return np.asarray(turn)[0], np.abs(np.asarray(found.angular_velocity - exact.angular_velocity)).max()


@pytest.mark.parametrize("name", ORDERS)
def test_halving_the_step_divides_the_error_by_two_to_the_order(name, flight):
    scene, state, exact = flight
    order, steps = ORDERS[name]
    end = run(scene, state, rb.METHODS[name]())
    coarse, fine = (error(end(n), exact) for n in (steps, 2 * steps))
    for one, other in zip(coarse, fine):
        assert 1e-10 < other < 0.02
        assert abs(np.log2(one / other) - order) < 0.25


@pytest.mark.parametrize(
    ("name", "order"), [("SemiImplicitEuler", 1), ("VelocityVerlet", 2), ("RungeKutta4", 4)]
)
def test_order_of_a_place_on_a_spring(name, order, dtype):
    """x = cos ω t, in which forces depend on places: the halves of a method that a free body never uses."""
    if dtype == jnp.float32:
        pytest.skip("round-off of float32 hides the orders")
    scene = rb.Scene(rb.Body(2.0, 1.0), rb.SpringDamper(stiffness=18.0))
    state = scene.state(position=(1.0, 0.0, 0.0))
    end = run(scene, state, rb.METHODS[name]())
    coarse, fine = (abs(float(end(n).position[0, 0]) - np.cos(3.0)) for n in (40, 80))
    assert fine < 0.02
    assert abs(np.log2(coarse / fine) - order) < 0.25


@pytest.mark.parametrize("kind", [rb.ExplicitEuler, rb.SemiImplicitEuler])
def test_a_finite_rotation_is_exact_at_a_constant_rate_and_a_tangent_is_not(kind, tolerance):
    scene = rb.Scene(rb.Body(1.0, 1.0))
    spin = (0.4, -0.8, 0.2)
    state = scene.state(angular_velocity=spin, rotation=rb.Quaternion)

    def off(method):
        end = rb.rollout(scene, state, dt=0.5, steps=4, save_every=4, method=method).final
        return float(jnp.abs(end.orientation.log()[0] - 2.0 * jnp.asarray(spin)).max())

    assert off(kind(finite_rotation=True)) < tolerance(float64=1e-15, float32=1e-6)
    assert 5e-3 < off(kind()) < 0.1


def test_euler_angles_serve_the_methods_that_only_add(tolerance):
    scene = rb.Scene(rb.Body(1.0, MATRIX))
    state = scene.state(angular_velocity=SPIN, rotation=rb.EulerAngles)
    path = rb.rollout(scene, state, dt=0.01, steps=50, save_every=50)
    exact = rb.free_flight(scene, scene.state(angular_velocity=SPIN), t=0.5)
    turned = rb.Quaternion.from_rotation(path.final.orientation)
    assert float(turned.angle_to(exact.orientation)[0]) < tolerance(float64=1e-9, float32=2e-6)
    products = {name for name, method in rb.METHODS.items() if method.needs_group}
    assert products == set(ORDERS) - {"ExplicitEuler", "SemiImplicitEuler", "VelocityVerlet", "RungeKutta4"}
    for name in products:
        with pytest.raises(rb.WrongStructure, match="not on Euler angles"):
            rb.rollout(scene, state, dt=0.01, steps=1, method=name)
