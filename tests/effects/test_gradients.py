"""Derivatives of a run with respect to every number in it: coefficients, masses, inertias, initial state, torque.

Scene, state and torque are laid out as one vector. The derivative of a loss of the final state in reverse mode, in
forward mode and by central differences must agree in every component, for every effect.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from rotation_samples import QUICK

import jaxrb as rb

BRICK = rb.Body(1.3, (0.4, 0.5, 0.7))
LUMP = rb.Body(0.9, np.asarray([[0.6, 0.05, -0.1], [0.05, 0.5, 0.02], [-0.1, 0.02, 0.4]]))
BALL = rb.Body(0.7, 0.3)


def _gust(body, state, wind):
    relative = wind["speed"] * jnp.cos(state.time) - state.velocity
    return rb.Wrench(wind["factor"] * relative, -wind["factor"] * state.angular_velocity)


# Bodies, effects, method, representation: each effect once, and among them every method and kind of inertia.
CASES = {
    "free": ((BRICK, LUMP), (), rb.RungeKutta4(), rb.Quaternion),
    "gravity": ((BALL,), rb.UniformGravity((0.1, 0.2, -9.0)), rb.VelocityVerlet(), rb.RotationMatrix),
    "linear drag": (
        (BRICK, LUMP),
        rb.LinearDrag([0.3, 0.5], angular_coefficient=0.2),
        rb.SemiImplicitEuler(finite_rotation=True),
        rb.Quaternion,
    ),
    "quadratic drag": (
        (BRICK, BALL),
        rb.QuadraticDrag(0.4, 0.5, bodies=(1,)),
        rb.ExplicitEuler(finite_rotation=True),
        rb.Quaternion,
    ),
    "spring to the world": (
        (LUMP,),
        rb.SpringDamper(20.0, 0.5, 0.3, point_a=(0.1, 0.0, -0.2), point_b=(0.5, 0.0, 1.0)),
        rb.SemiImplicitEuler(),
        rb.RotationMatrix,
    ),
    "springs between bodies": (
        (BRICK, BALL),
        rb.SpringDamper([20.0, 9.0], [0.5, 0.1], 0.3, (0.1, 0.0, -0.2), (0.0, 0.3, 0.0), (0, 1), (1, 0)),
        rb.SemiImplicitEuler(),
        rb.Quaternion,
    ),
    "thruster": (
        (BRICK,),
        rb.BodyThruster((1.0, 0.2, 0.1), (0.1, -0.2, 0.3)),
        rb.ExplicitEuler(),
        rb.Quaternion,
    ),
    "constant torque": (
        (BRICK,),
        rb.PrescribedTorque((0.3, -0.2, 0.5)),
        rb.ImplicitMidpoint(sweeps=3),
        rb.Quaternion,
    ),
    "torque course": (
        (BRICK,),
        rb.PrescribedTorque([[0.3, -0.2, 0.5], [1.0, 0.0, 0.2]], times=[-0.1, 0.7]),
        rb.SemiImplicitEuler(),
        rb.EulerAngles,
    ),
    "gravity of a centre and of each other": (
        (BRICK, LUMP),
        (
            rb.CentralGravity(0.3, (2.0, 0.1, -1.5)),
            rb.GravityGradient(0.5, (2.0, 0.1, -1.5)),
            rb.MutualGravity(0.2),
        ),
        rb.SemiImplicitEuler(),
        rb.Quaternion,
    ),
    "fluid": (
        (BRICK,),
        (
            rb.Buoyancy(0.4, 2.0, point=(0.1, 0.0, 0.2)),
            rb.MagnusForce(0.2, wind=(0.3, 0.1, 0.0)),
            rb.PlateAerodynamics((0.2, 0.1, 1.0), 0.4, (0.3, 0.1, 0.0), wind=(0.3, 0.1, 0.0)),
        ),
        rb.SemiImplicitEuler(),
        rb.Quaternion,
    ),
    "torques of attitude and rate": (
        (BRICK, LUMP),
        (
            rb.MagneticTorque((1.0, 0.2, 0.1), (0.1, 0.5, 0.3)),
            rb.AngularSpring(1.2, 0.3, body_a=0, body_b=1),
            rb.Motor((0.1, 0.2, 1.0), 2.0, 0.3, bodies=(1,)),
        ),
        rb.SemiImplicitEuler(),
        rb.Quaternion,
    ),
    "fixed point": (
        (BRICK, LUMP),
        (rb.UniformGravity(), rb.FixedPoint((0.0, 0.1, 0.3), (0.0, 0.0, 1.0), bodies=(0,))),
        rb.VelocityVerlet(),
        rb.Quaternion,
    ),
    "custom force": (
        (BALL,),
        rb.CustomForce(_gust, {"speed": np.asarray([3.0, 0.0, 1.0]), "factor": np.asarray(0.4)}),
        rb.VelocityVerlet(),
        rb.Quaternion,
    ),
}


def problem(case: str, dtype):
    """The loss of a 50-step run as a function of one vector, and that vector."""
    bodies, effects, method, rotation = CASES[case]
    scene = rb.Scene(bodies, effects)
    n = scene.count
    draw = np.random.default_rng(0)
    position, velocity, omega = draw.normal(size=(3, n, 3))
    held = "fixed" in case
    state = scene.state(
        None if held else position.tolist(),
        rb.Quaternion.exp(draw.normal(size=(n, 3)).astype(dtype)),
        velocity.tolist(),
        omega.tolist(),
        rotation=rotation,
    )
    numbers, unravel = ravel_pytree((scene, state, jnp.asarray(draw.normal(size=(n, 3)), dtype)))

    def loss(numbers):
        scene, state, torque = unravel(numbers)
        final = rb.rollout(scene, state, dt=0.01, steps=50, torque=torque, method=method, save_every=50).final
        flat = ravel_pytree(final)[0]
        return jnp.sum(jnp.sin(flat) + jnp.linspace(0.5, 1.5, flat.size, dtype=flat.dtype) * flat)

    return loss, numbers.astype(dtype)


@pytest.mark.parametrize("case", CASES)
def test_derivatives_of_a_run_agree_in_both_modes_and_with_differences(case, dtype, tolerance):
    loss, numbers = problem(case, dtype)
    h = 1e-5

    @functools.partial(jax.jit, compiler_options=QUICK)
    def all_three(numbers):
        steps = jnp.concatenate([numbers + h * jnp.eye(numbers.size, dtype=dtype) * sign for sign in (1, -1)])
        ahead, behind = jnp.split(jax.vmap(loss)(steps), 2)
        return jax.grad(loss)(numbers), jax.jacfwd(loss)(numbers), (ahead - behind) / (2 * h)

    reverse, forward, differences = (np.asarray(part, np.float64) for part in all_three(numbers))
    size = np.maximum(np.abs(forward), 1.0)
    assert np.isfinite(reverse).all()
    assert (np.abs(reverse - forward) / size).max() < tolerance(float64=1e-11, float32=1e-3)
    if dtype == jnp.float64:
        assert (np.abs(reverse - differences) / size).max() < 1e-6
    assert (np.abs(forward) > 1e-6).mean() > 0.7  # nearly every number has a say in where the bodies end


EDGES = {
    "drag at rest": (rb.QuadraticDrag(0.4, 0.5), {}),
    "spring of zero length": (rb.SpringDamper(20.0, 0.5, 0.3), {}),
    "spring at its rest length": (rb.SpringDamper(20.0, 0.5, 1.0), {"position": (1.0, 0.0, 0.0)}),
    "half a turn": (rb.UniformGravity(), {"orientation": (0.0, 1.0, 0.0, 0.0)}),
    "no spin": (rb.FixedPoint((0.0, 0.0, 0.3)), {}),
}


@pytest.mark.parametrize("rotation", [rb.Quaternion, rb.RotationMatrix])
def test_gradients_are_finite_where_directions_vanish(rotation, dtype):
    """At rest, without spin, at zero length, with finite rotations."""
    runs = []
    edges = EDGES if rotation is rb.Quaternion else {name: EDGES[name] for name in ("half a turn", "no spin")}
    for effect, start in edges.values():
        scene = rb.Scene(BRICK, effect)
        runs.append((scene, scene.state(**start, rotation=rotation)))

    @functools.partial(jax.jit, compiler_options=QUICK)
    def gradients(runs):
        def loss(run, method):
            final = rb.rollout(*run, dt=0.01, steps=50, method=method).final
            return jnp.sum(final.position**2) + jnp.sum(final.orientation.log() ** 2)

        method = (
            rb.VelocityVerlet() if rotation is rb.Quaternion else rb.SemiImplicitEuler(finite_rotation=True)
        )
        return [jax.grad(loss)(run, method) for run in runs]

    cast = jax.tree.map(lambda x: jnp.asarray(x, dtype), runs)
    for name, found in zip(edges, gradients(cast), strict=True):
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found)), name
