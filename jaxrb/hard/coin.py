"""A hard case of contact: a coin that whirls on its edge until it lies.

The lower it leans the faster it whirls, without end for an ideal one (Moffatt, Nature 404, 2000: Ω² = 4 g / (a sin α)):
sooner or later no step resolves it.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.state import State
from jaxrb.effects.drag import LinearDrag
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import Cylinder, HalfSpace
from jaxrb.hard.case import QUICK, Case, Measured, precision, unannounced
from jaxrb.hard.contact_peers import Flight, figure, peers_of
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

RADIUS, HALF, DENSITY = 0.0125, 0.001, 8900.0  # of a coin of 1 cm³ of brass
LEAN, DRAG, FRICTION = (
    0.2,
    1e-5,
    0.4,
)  # [rad], [N s/m and N m s/rad]: air of so many times the drag that it takes 0.3 s
G, DT, STEPS = 9.81, 1e-3, 400
_LIES = "lies"


@functools.cache
def flight() -> Flight:
    """As it whirls in one place, leaning: it turns about the line from its lowest point through its centre."""
    mass = DENSITY * np.pi * RADIUS**2 * 2 * HALF
    across = mass * (3 * RADIUS**2 + (2 * HALF) ** 2) / 12
    spin = np.sqrt(4 * G * np.sin(LEAN) / RADIUS)
    place = (0.0, 0.0, RADIUS * np.sin(LEAN) + HALF * np.cos(LEAN))
    turn = (np.cos(LEAN / 2), np.sin(LEAN / 2), 0.0, 0.0)
    inertia = (across, across, mass * RADIUS**2 / 2, 0.0, 0.0, 0.0)
    return Flight(
        "cylinder", [mass], [RADIUS, RADIUS, HALF], [place], [turn], None, [(0.0, spin, 0.0)], [inertia], DT, STEPS,
        FRICTION, DRAG,
    )  # fmt: skip


@functools.cache
def _ran(kind: str) -> tuple[Path, Any]:
    """The path, and the derivative of its end along a change of the velocity at the start."""
    plain = flight().plain()
    coin = Body.from_shape(Cylinder(RADIUS, HALF), density=DENSITY)
    law = RigidContact(HalfSpace(), friction=FRICTION)
    scene = Scene((coin,), (UniformGravity((0, 0, -G)), LinearDrag(DRAG, angular_coefficient=DRAG), law))
    start = scene.state(position=plain["places"], orientation=plain["turns"], angular_velocity=plain["spins"])
    assert start.dtype == kind

    def run(velocity: Any) -> tuple[State, Path]:
        state = State(start.position, start.orientation, velocity, start.angular_velocity, start.time)
        path = rollout(scene, state, dt=DT, steps=STEPS, on_error="flag")
        return path.final, path

    @functools.partial(jax.jit, compiler_options=QUICK)
    def both(velocity: Any) -> tuple[Path, Any]:
        change = jnp.asarray([(0.48, 0.6, 0.64)], velocity.dtype)
        _, slope, path = jax.jvp(run, (velocity,), (change,), has_aux=True)
        return path, slope

    return both(start.velocity)


def states_of(path: Path) -> np.ndarray:
    """(k, n, 13) as other engines give them: place, turn, velocity, spin."""
    s = path.states
    parts = (s.position, s.orientation.wxyz, s.velocity, s.angular_velocity)  # pyright: ignore[reportAttributeAccessIssue] - a Quaternion
    return np.concatenate([np.asarray(part, float) for part in parts], axis=-1)


def _lying() -> Measured:
    path, slope = _ran(precision())
    count, status = unannounced(path)
    found = figure(flight(), _LIES, states_of(path))
    poor = int(path.contact.poor[-1])
    note = f"{poor} of {STEPS} steps poor" if poor else ""
    return Measured(np.nan if count else found, slope, status=status, note=note)


def cases() -> tuple[Case, ...]:
    """The case of this file."""
    return (
        Case(
            "coin spun until it lies",
            "it whirls ever faster as it sinks: no step resolves its end",
            "energy after 0.4 s off that of lying flat, or risen above that of the start, relative; every state a "
            "number; the derivative finite",
            {"float64": 1e-9, "float32": 1e-5},
            _lying,
            **peers_of(flight(), _LIES),
        ),
    )
