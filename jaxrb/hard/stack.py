"""A hard case of contact: twenty boxes on each other, of which the lowest bears nineteen."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import Box, HalfSpace
from jaxrb.hard.case import QUICK, Case, Measured, precision, unannounced
from jaxrb.hard.contact_peers import Flight, peers_of
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

COUNT, HALF, DENSITY = 20, 0.05, 700.0
DT, STEPS, EVERY = 5e-3, 40, 5
_NAME = "stack of twenty"


def places() -> list[tuple[float, float, float]]:
    """Of the boxes [m]: each up to 1 cm off the middle."""
    off = drawn(0).uniform(-0.01, 0.01, (COUNT, 2))
    return [(x, y, HALF * (2 * i + 1)) for i, (x, y) in enumerate(off.tolist())]


@functools.cache
def _ran(kind: str) -> tuple[Path, Any]:
    """The path, and the derivative of its end along a change of the velocities at the start."""
    box = replicate(Body.from_shape(Box((HALF, HALF, HALF)), density=DENSITY), COUNT)
    laws = (RigidContact(HalfSpace(), friction=0.5), RigidContact(friction=0.5))
    scene = Scene(box, (UniformGravity(), *laws))
    start = scene.state(position=places())
    assert start.dtype == kind

    def run(velocity: Any) -> tuple[State, Path]:
        state = State(start.position, start.orientation, velocity, start.angular_velocity, start.time)
        path = rollout(scene, state, dt=DT, steps=STEPS, save_every=EVERY, on_error="flag")
        return path.final, path

    @functools.partial(jax.jit, compiler_options=QUICK)
    def both(velocity: Any) -> tuple[Path, Any]:
        change = jnp.broadcast_to(jnp.asarray((0.48, 0.6, 0.64), velocity.dtype), velocity.shape)
        _, slope, path = jax.jvp(run, (velocity,), (change,), has_aux=True)
        return path, slope

    return both(start.velocity)


def _standing() -> Measured:
    path, slope = _ran(precision())
    count, status = unannounced(path)
    place = np.asarray(path.states.position, float)
    figure = np.nan if count else float(np.abs(place - place[0]).max())
    return Measured(figure, slope, status=status)


def cases() -> tuple[Case, ...]:
    """The case of this file."""
    flight = Flight("boxes", [DENSITY * (2 * HALF) ** 3] * COUNT, [HALF] * 3, places(), dt=DT, steps=STEPS)
    return (
        Case(
            _NAME,
            "the lowest bears nineteen; forces not unique",
            "farthest that a box strays from where it rests in 0.2 s [m]; the derivative finite",
            {"float64": 1e-9, "float32": 1e-4},
            _standing,
            **peers_of(flight, "drift"),
        ),
    )
