"""Scenes of rigid contact that several tests share, as functions of their numbers, and programs that run them.

Each runs many worlds in one program (`jax.vmap` over numbers and states): what these tests cost is compiling.
"""

import jax
import jax.numpy as jnp
import numpy as np
from rotation_samples import QUICK

import jaxrb as rb

G = 9.81
DOWN = (0.0, 0.0, -G)


def on_device(tree, dtype):
    """Numbers of the host in the floating type of this run."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), tree)


def _host(numbers):
    return {name: np.asarray(value, float) for name, value in numbers.items()}


def worlds(cases, dtype):
    """A list of equal trees of numbers as one tree with a leading axis."""
    return jax.tree.map(lambda *x: jnp.asarray(np.stack([np.asarray(v, float) for v in x]), dtype), *cases)


def state(scene, motion):
    """The state of a scene from `position`, `turn` (rotation vectors), `velocity`, `spin` (in the body), all (n, 3)."""
    turned = jax.vmap(rb.Quaternion.exp)(motion["turn"])
    return scene.state(motion["position"], turned, motion["velocity"], motion["spin"])


def motion(position, velocity=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    """Numbers of a state for `state`; rows missing are zero."""
    position = np.atleast_2d(np.asarray(position, float))
    rest = {"velocity": velocity, "spin": spin, "turn": turn}
    rest = {name: np.broadcast_to(np.asarray(v, float), position.shape) for name, v in rest.items()}
    return {"position": position, **rest}


def runner(scene_of, steps, save_every=1, method="RungeKutta4", batched=True):
    """`run(numbers, motions, dt)` -> path of each world; compiled once for each number of worlds."""

    def run(numbers, moves, dt):
        scene = scene_of(numbers)
        return rb.rollout(
            scene,
            state(scene, moves),
            dt=dt,
            steps=steps,
            save_every=save_every,
            method=method,
            on_error="flag",
        )

    return jax.jit(jax.vmap(run) if batched else run, compiler_options=QUICK)


def continued(scene_of, steps, method="RungeKutta4"):
    """`run(numbers, state, dt)`: as `runner`, from where another run ended."""

    def run(numbers, start, dt):
        return rb.rollout(scene_of(numbers), start, dt=dt, steps=steps, method=method, on_error="flag")

    return jax.jit(jax.vmap(run), compiler_options=QUICK)


def long_run(program, numbers, start, dt, times):
    """States (worlds, times · steps + 1, ...) of a run made in several goes, in float64 on the host."""
    parts = []
    for k in range(times):
        path = program(numbers, start, dt)
        assert bool(path.status.ok.all()) if path.status.ok.ndim else bool(path.status.ok)
        start = path.final
        parts.append(jax.tree.map(lambda x, k=k: np.asarray(x, float)[:, (k > 0) :], path.states))
    return jax.tree.map(lambda *x: np.concatenate(x, axis=1), *parts)


def block(numbers):
    """A box on a floor with friction, pushed by A cos(w t) along x.

    Numbers: mu, gravity (3,), half (3,) [m], mass [kg], push (A, w).
    """

    def push(_body, now, parameters):
        size = parameters[0] * jnp.cos(parameters[1] * now.time)
        return rb.Wrench(force=jnp.stack([size, 0 * size, 0 * size]))

    shape = rb.Box(numbers["half"])
    volume = 8.0 * jnp.prod(numbers["half"])
    body = rb.Body.from_shape(shape, density=numbers["mass"] / volume)
    effects = (
        rb.UniformGravity(numbers["gravity"]),
        rb.CustomForce(push, parameters=numbers["push"]),
        rb.RigidContact(rb.HalfSpace(), friction=numbers["mu"]),
    )
    return rb.Scene(body, effects)


def block_numbers(mu=0.5, gravity=DOWN, half=(0.1, 0.08, 0.02), mass=1.0, push=(0.0, 0.0)):
    """Numbers of a `block`."""
    return _host({"mu": mu, "gravity": gravity, "half": half, "mass": mass, "push": push})


def pile(friction, restitution, tolerance=None):
    """Two boxes, a ball and, without restitution, a capsule, over a floor and one another, as a function of numbers.

    Numbers: mu, e, gravity (3,), normal (3,) and offset of the floor. `friction` and `restitution`: whether it has any.
    """

    def scene(numbers):
        laws = {
            "friction": numbers["mu"] if friction else None,
            "restitution": numbers["e"] if restitution else None,
        }
        boxes = rb.replicate(rb.Body.from_shape(rb.Box((0.12, 0.1, 0.07)), 500.0), 2)
        bodies = (boxes, rb.Body.from_shape(rb.Sphere(0.1), 500.0))
        if not restitution:  # the rounds of impacts are compiled for long enough as it is
            bodies = (*bodies, rb.Body.from_shape(rb.Capsule(0.07, 0.1), 500.0))
        floor = rb.HalfSpace(numbers["normal"], numbers["offset"])
        effects = (
            rb.UniformGravity(numbers["gravity"]),
            rb.RigidContact(floor, **laws, tolerance=tolerance),
            rb.RigidContact(**laws, tolerance=tolerance),
        )
        return rb.Scene(bodies, effects)

    return scene


def pile_numbers(mu=0.5, e=0.5, gravity=DOWN, normal=(0.0, 0.0, 1.0), offset=0.0):
    """Numbers of a `pile`."""
    return _host({"mu": mu, "e": e, "gravity": gravity, "normal": normal, "offset": offset})


def toss(seed, height=0.3, speed=2.0, inward=0.0):
    """A random start of a `pile` without overlap: bodies on a lattice, thrown; `inward` toward their middle."""
    random = np.random.default_rng(seed)
    places = np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.4, 0], [0, 0, 0.4]], float)
    places = random.permutation(places) + 0.02 * random.normal(size=(4, 3)) + [0, 0, height]
    velocity = speed * random.normal(size=(4, 3)) + inward * (places.mean(axis=0) - places)
    return motion(places, velocity, 5.0 * random.normal(size=(4, 3)), random.normal(size=(4, 3)))


def stack(count, half=0.1):
    """Boxes over a floor with friction, numbers: mu, mass (n,), gravity (3,)."""

    def scene(numbers):
        mass = jnp.broadcast_to(numbers["mass"], (count,))
        side = 2 * half
        body = rb.Body(
            mass,
            rb.SphericalInertia(mass * side * side / 6),
            rb.replicate(rb.Body.from_shape(rb.Box((half,) * 3), 1.0), count).shape,
            jnp.zeros((count, 3)),
        )
        effects = (
            rb.UniformGravity(numbers["gravity"]),
            rb.RigidContact(rb.HalfSpace(), friction=numbers["mu"]),
            rb.RigidContact(friction=numbers["mu"]),
        )
        return rb.Scene(body, effects)

    return scene
