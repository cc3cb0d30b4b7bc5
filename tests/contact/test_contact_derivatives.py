"""Derivatives of a step with contact: both modes agree with differences, and are finite where there is none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from contact_scenes import DOWN, G, block, block_numbers, motion, on_device, state, worlds
from jax.flatten_util import ravel_pytree
from rotation_samples import QUICK

import jaxrb as rb

DT = 1e-3


def laws(numbers, restitution, **options):
    """Contact with a floor and between bodies, solved as exactly as the type allows."""
    given = {"friction": numbers["mu"]} | ({"restitution": numbers["e"]} if restitution else {})
    tight = 1e-13 if jax.config.jax_enable_x64 else 1e-6
    return rb.RigidContact(**given, tolerance=tight, **options)


def bodies(numbers, shape):
    return rb.Body(numbers["mass"], rb.PrincipalInertia(numbers["inertia"]), shape)


def box(numbers):
    floor = laws(numbers, False, against=rb.HalfSpace())
    return rb.Scene(bodies(numbers, rb.Box(numbers["half"])), (rb.UniformGravity(numbers["gravity"]), floor))


def ball(numbers):
    floor = laws(numbers, True, against=rb.HalfSpace())
    return rb.Scene(
        bodies(numbers, rb.Sphere(numbers["radius"])), (rb.UniformGravity(numbers["gravity"]), floor)
    )


def three(numbers):
    """Three boxes."""
    shape = rb.Box(numbers["half"])
    body = rb.Body(numbers["mass"], rb.PrincipalInertia(numbers["inertia"]), shape, jnp.zeros((3, 3)))
    effects = (
        rb.UniformGravity(numbers["gravity"]),
        laws(numbers, False, against=rb.HalfSpace()),
        laws(numbers, False),
    )
    return rb.Scene(body, effects)


def numbers(mu=0.5, e=None, radius=None, count=None):
    inertia, half = np.array([0.012, 0.015, 0.018]), np.array([0.1, 0.08, 0.05])
    if radius is not None:
        inertia = np.full(3, 0.016)
    found = {"mu": mu, "mass": 4.0, "inertia": inertia, "gravity": np.array(DOWN)}
    found |= {"half": half} if radius is None else {"radius": radius, "e": e}
    if count is not None:
        found |= {
            "mass": np.full(count, 4.0),
            "inertia": np.tile(inertia, (count, 1)),
            "half": np.tile(half, (count, 1)),
        }
    return {name: np.asarray(value, float) for name, value in found.items()}


# Name: numbers, start, whether a step has a derivative there.
BOX = {
    "free flight": (numbers(), motion((0, 0, 1.0), (1, 2, 0.5), (1, -2, 3), (0.3, 0.2, 0.1)), True),
    "sliding": (numbers(), motion((0, 0, 0.05), (1, 0.3, 0), (0, 0, 0.5)), True),
    "sticking": (numbers(), motion((0, 0, 0.05)), True),
    "sticking, pulled aside": (
        numbers() | {"gravity": np.array([2.0, 1.0, -9.0])},
        motion((0, 0, 0.05)),
        True,
    ),
    "impact of a corner": (
        numbers(),
        motion((0, 0, 0.1268), (0.5, 0.2, -2.0), (1, 2, 0.5), (0.7, 0.6, 0)),
        True,
    ),
    "straight down, not yet there": (numbers(), motion((0, 0, 0.053), (0, 0, -2.0)), True),
    "zero friction": (numbers(0.0), motion((0, 0, 0.05), (1, 0, 0)), False),
    "zero friction at rest": (numbers(0.0), motion((0, 0, 0.05)), False),
    "exact touch without weight": (numbers() | {"gravity": np.zeros(3)}, motion((0, 0, 0.05)), False),
    "deep": (numbers(), motion((0, 0, -0.02)), False),
    "inside out": (numbers(), motion((0, 0, -0.5)), False),
    "fast": (numbers(), motion((0, 0, 0.05), (1e4, 0, -1e4), (1e3, 0, 0)), False),
}
BALL = {
    "free flight": (numbers(e=0.5, radius=0.1), motion((0, 0, 1.0), (1, 2, 0.5), (1, -2, 3)), True),
    "sliding": (numbers(e=0.5, radius=0.1), motion((0, 0, 0.1), (1, 0.3, 0), (0, 0, 0.5)), True),
    "rolling": (numbers(e=0.5, radius=0.1), motion((0, 0, 0.1), (1, 0, 0), (0, 10, 0)), True),
    "impact": (numbers(e=0.5, radius=0.1), motion((0, 0, 0.1005), (0.2, 0.1, -2), (1, 2, 3)), True),
    "sliding impact": (numbers(0.1, e=0.5, radius=0.1), motion((0, 0, 0.1005), (3, 1, -2), (1, 2, 3)), True),
    "straight down, not yet there": (
        numbers(e=0.5, radius=0.1),
        motion((0, 0, 0.103), (0, 0, -2.0)),
        True,
    ),
    "exact touch": (numbers(e=0.5, radius=0.1), motion((0, 0, 0.1)), False),
    "exact touch without weight": (
        numbers(e=0.5, radius=0.1) | {"gravity": np.zeros(3)},
        motion((0, 0, 0.1)),
        False,
    ),
    "zero friction and restitution": (
        numbers(0.0, e=0.0, radius=0.1),
        motion((0, 0, 0.1), (0, 0, -1)),
        False,
    ),
    "elastic": (numbers(0.0, e=1.0, radius=0.1), motion((0, 0, 0.1), (0, 0, -1)), False),
    "centre on the floor": (numbers(e=0.5, radius=0.1), motion((0, 0, 0)), False),
}
THREE = {
    "stack": (numbers(count=3), motion([(0, 0, 0.05), (0.02, 0.01, 0.15), (-0.01, 0.02, 0.25)]), True),
    "stack, pulled aside": (
        numbers(count=3) | {"gravity": np.array([1.0, 0.5, -9.0])},
        motion([(0, 0, 0.05), (0.02, 0.01, 0.15), (-0.01, 0.02, 0.25)]),
        True,
    ),
    "stack in line": (numbers(count=3), motion([(0, 0, 0.05), (0, 0, 0.15), (0, 0, 0.25)]), False),
    "one place": (numbers(count=3), motion([(0, 0, 1.0)] * 3), False),
    "deep": (numbers(count=3), motion([(0, 0, 0.02), (0.02, 0.01, 0.05), (-0.01, 0.02, 0.08)]), False),
    "fast": (
        numbers(count=3),
        motion([(0, 0, 0.05), (0, 0, 0.15), (0, 0, 0.25)], [(0, 0, 0), (1e4, 0, -1e4), (0, 0, 0)]),
        False,
    ),
}
SCENES = {"box": (box, BOX), "ball": (ball, BALL), "three": (three, THREE)}


@pytest.fixture(scope="module", params=SCENES)
def jacobians(request, dtype):
    """The cases, and of each the Jacobian (outputs, inputs) by forward and reverse mode and by differences."""
    scene_of, cases = SCENES[request.param]
    inputs = worlds([(n, m) for n, m, _ in cases.values()], dtype)
    one, unravel = ravel_pytree(jax.tree.map(lambda x: x[0], inputs))

    def step(flat):
        given, start = unravel(flat)
        scene = scene_of(given)
        end = rb.step(scene, state(scene, start), None, DT)
        return ravel_pytree((end.position, end.orientation, end.velocity, end.angular_velocity))[0]

    flat = jax.vmap(lambda x: ravel_pytree(x)[0])(inputs)
    every = jnp.eye(len(one), dtype=dtype)

    def both(x):
        value, along = jax.linearize(step, x)
        back = jax.linear_transpose(along, x)
        rows = jax.vmap(lambda w: back(w)[0])(jnp.eye(len(value), dtype=dtype))
        return jax.vmap(along, out_axes=1)(every), rows

    compiled = jax.jit(jax.vmap(both), compiler_options=QUICK)
    forward, reverse = (np.asarray(v, float) for v in compiled(flat))
    differences = None
    if dtype == jnp.float64:
        h = 1e-7
        many = jax.jit(jax.vmap(jax.vmap(step)), compiler_options=QUICK)
        ends = many(flat[:, None] + h * jnp.concatenate([every, -every]))
        plus, minus = np.split(np.asarray(ends, float), 2, axis=1)
        differences = np.swapaxes(plus - minus, 1, 2) / (2 * h)
    return cases, forward, reverse, differences


def test_derivatives_are_finite_also_where_there_is_none(jacobians):
    """At exact touch, at rest, without friction or weight, in one place, deep inside, absurdly fast."""
    cases, forward, reverse, _ = jacobians
    for k, name in enumerate(cases):
        assert np.isfinite(forward[k]).all(), name
        assert np.isfinite(reverse[k]).all(), name


def test_forward_and_reverse_mode_agree(jacobians, tolerance):
    cases, forward, reverse, _ = jacobians
    for k, name in enumerate(cases):
        off = np.abs(forward[k] - reverse[k]).max() / np.abs(forward[k]).max()
        assert off <= tolerance(float64=1e-6, float32=2e-2), name


def test_derivatives_are_those_of_the_step(jacobians):
    """By central differences, to state, mass, inertia, coefficients, sizes and gravity."""
    cases, forward, _, differences = jacobians
    if differences is None:
        pytest.skip("differences of float32 are all noise")
    off = {}
    for k, (name, (*_, smooth)) in enumerate(cases.items()):
        if smooth:
            off[name] = np.abs(forward[k] - differences[k]).max() / np.abs(forward[k]).max()
    assert off
    assert {name: error for name, error in off.items() if error > 1e-6} == {}


def test_stopping_distance_has_the_derivatives_of_v_squared_over_two_mu_g(dtype, tolerance):
    """Through a whole run, both modes: v/(μ g) and −v²/(2 μ² g) to first order in the step; and those of the run."""
    speed, mu, dt, steps = 0.5, 0.5, 2e-3, 64

    def distance(x):
        given = on_device(block_numbers(), dtype) | {"mu": x[1]}
        scene = block(given)
        still = jnp.zeros_like(x[0])
        start = on_device(motion((0, 0, 0.02)), dtype) | {"velocity": jnp.stack([x[0], still, still])[None]}
        path = rb.rollout(scene, state(scene, start), dt=dt, steps=steps, save_every=steps, on_error="flag")
        return path.final.position[0, 0]

    @jax.jit
    def both(x):
        value, along = jax.linearize(distance, x)
        (back,) = jax.linear_transpose(along, x)(jnp.ones_like(value))
        return value, jax.vmap(along)(jnp.eye(2, dtype=dtype)), back

    compiled = both.lower(jnp.zeros(2, dtype)).compile(compiler_options=QUICK)

    def at(v, mu):
        return [np.asarray(part, float) for part in compiled(jnp.asarray([v, mu], dtype))]

    _, forward, reverse = at(speed, mu)
    exact = np.array([speed / (mu * G), -(speed**2) / (2 * mu**2 * G)])
    assert forward == pytest.approx(reverse, rel=tolerance(float64=1e-6, float32=2e-2))
    # The run's own derivative lies within a step of sliding of the law's.
    assert np.abs(forward - exact) == pytest.approx(0.0, abs=2 * dt * max(1.0, speed / mu))
    if dtype == jnp.float64:
        h = 1e-5
        ends = [(at(speed + a, mu + b)[0] - at(speed - a, mu - b)[0]) / (2 * h) for a, b in ((h, 0), (0, h))]
        assert forward == pytest.approx(np.array(ends), rel=1e-4)
