"""Paths with every shape, made without a run: what a picture shows needs no dynamics."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxrb as rb
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.events import EventPath
from jaxrb.scene.events_loop import Events
from jaxrb.scene.path import Path

EVIL = "</script><img src=x onerror=alert(1)>&\"'"


def tetrahedron():
    return np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float), np.array(
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    )


def solids(scipy=True):
    """A shape of each kind, by name."""
    beside = rb.Pose(np.array([0.3, 0.0, 0.1]), rb.Quaternion(np.array([0.6, 0.0, 0.8, 0.0])))
    found = {
        "sphere": rb.Sphere(0.3),
        "box": rb.Box((0.1, 0.2, 0.3)),
        "capsule": rb.Capsule(0.1, 0.25),
        "cylinder": rb.Cylinder(0.2, 0.1),
        "cone": rb.Cone(0.2, 0.5),
        "ellipsoid": rb.Ellipsoid((0.1, 0.2, 0.3)),
        "mesh": rb.TriangleMesh(*tetrahedron()),
        "composite": rb.Composite(((rb.Box((0.1, 0.1, 0.1)), rb.Pose.identity()), (rb.Sphere(0.1), beside))),
    }
    if scipy:
        found["hull"] = rb.ConvexHull(tetrahedron()[0] * 0.4)
    return found


def scene_of_all(scipy=True):
    """A body of each shape, one without, one with a name that is markup; a floor, a wall and a post stand still."""
    bodies = [rb.Body.from_shape(shape, 500.0, name) for name, shape in solids(scipy).items()]
    bodies += [rb.Body(2.0, (0.1, 0.2, 0.25), name="no shape"), rb.Body.from_shape(rb.Sphere(0.1), 1.0, EVIL)]
    post = (
        rb.Cylinder(0.05, 0.5),
        rb.Pose(np.array([1.0, 1.0, 0.5]), rb.Quaternion(np.array([1.0, 0, 0, 0]))),
    )
    floor, wall = rb.HalfSpace(offset=-1.0), rb.HalfSpace((1.0, 0.0, 0.0), -3.0)
    touch = rb.RigidContact((floor, wall, post), bodies=(0,))
    return rb.Scene(tuple(bodies), (rb.UniformGravity(), touch))


def path_of(scene, saves=21, seed=0):
    """Bodies on curves of their own, turning; unevenly saved."""
    random, n = np.random.default_rng(seed), scene.count
    times = np.sort(np.concatenate([[0.0, 2.0], random.uniform(0.0, 2.0, saves - 2)]))
    start, rate = random.normal(size=(n, 3)), random.normal(size=(n, 3))
    position = start + np.sin(times[:, None, None] * rate) + 0.1 * times[:, None, None]
    turn = random.normal(size=(n, 4)) + times[:, None, None] * random.normal(size=(n, 4))
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    turn[1::2] *= -1.0  # the same rotations
    state = scene.state()
    like = state.position.dtype
    states = type(state)(
        jnp.asarray(position, like),
        Quaternion(jnp.asarray(turn, like)),
        jnp.zeros_like(jnp.asarray(position, like)),
        jnp.zeros_like(jnp.asarray(position, like)),
        jnp.asarray(times, like),
    )
    return Path(states.time, states, state, None, scene)


def with_events(path):
    """The path as `solve_events` would give it, with an impact at 0.5 s and one at 1 s, and room for one more."""
    rows = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
    pairs, points = np.array([[0, -1], [0, -1], [-2, -2]]), np.array([1, 1, 0])
    events = Events(np.array([0.5, 1.0, np.inf]), pairs, rows, rows, points, np.int32(2))
    return EventPath(path.times, path.states, path.final, None, path.scene, events=events)


def resting_tower():
    """A ball that rests on a ball on a floor, saved three times as they are."""
    ball = rb.replicate(rb.Body.from_shape(rb.Sphere(0.1), density=500.0, name="ball"), 2)
    touch = (rb.RigidContact(rb.HalfSpace(), friction=0.5), rb.RigidContact(friction=0.5))
    scene = rb.Scene(ball, (rb.UniformGravity(), *touch))
    state = scene.state(position=[(0, 0, 0.1), (0, 0, 0.3)])
    states = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), state)
    states = eqx.tree_at(lambda s: s.time, states, jnp.asarray([0.0, 0.5, 1.0], state.dtype))
    return Path(states.time, states, state, None, scene)
