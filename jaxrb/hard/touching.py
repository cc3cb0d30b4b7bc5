"""Hard cases of contact: degenerate geometry, unequal masses, and motions that end in infinitely many impacts.

All cases with two boxes run as worlds of one program, and all with one ellipsoid on a floor as worlds of another:
compiling is what they cost. Each is run with its derivative along a change of the velocities at the start.
"""

import functools
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.inertia import FullInertia
from jaxrb.body.state import State
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import Box, Ellipsoid, HalfSpace
from jaxrb.hard.case import QUICK, Case, Measured, precision, unannounced
from jaxrb.hard.contact_peers import Flight, peers_of
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene, energy

STEPS, EVERY = 100, 5
G, HALF = 9.81, 0.1
_EDGE = (0.0, np.pi / 4, 0.0)  # a turn that leaves a box on its edge
_EDGE_ACROSS = (np.pi / 4, 0.0, 0.0)
_CORNER = tuple(np.arccos(1 / np.sqrt(3)) * np.asarray((1.0, -1.0, 0.0)) / np.sqrt(2))
_FLAT, _STILL = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
_R2, _R3 = HALF * np.sqrt(2), HALF * np.sqrt(3)
_ANY = "energy"

# Name: what is hard, masses [kg], places, turns, velocities, what is measured.
BOXES: dict[str, tuple[Any, ...]] = {
    "box on box, faces parallel": (
        "many points of contact, forces not unique", (4, 4), ((0, 0, HALF), (0, 0, 3 * HALF)), (_FLAT, _FLAT), None,
        "drift",
    ),
    "box on box, edge across edge": (
        "the normal is that of no face", (4, 4), ((0, 0, _R2), (0, 0, 3 * _R2)), (_EDGE, _EDGE_ACROSS), None, _ANY
    ),
    "box on box, corner on corner": (
        "every direction nearby separates", (4, 4), ((0, 0, _R3), (0, 0, 3 * _R3)), (_CORNER, _CORNER), None, _ANY
    ),
    "two boxes in one place": (
        "all ways out tie", (4, 4), ((0, 0, HALF), (0, 0, HALF)), (_FLAT, _FLAT), None, "speed"
    ),
    "box deep in the floor": (
        "an overlap of half a body", (4, 4), ((0, 0, 0), (1, 0, HALF)), (_FLAT, _FLAT), None, "speed"
    ),
    "box that grazes the floor": (
        "1 m/s along, 1e-6 m/s down", (4, 4), ((0, 0, HALF + 1e-9), (0, 2, HALF)), (_FLAT, _FLAT),
        ((1, 0, -1e-6), _STILL), _ANY,
    ),
    "mass ratio 1e4 in a stack": (
        "the light box bears ten thousand of its weights", (1, 1e4), ((0, 0, HALF), (0, 0, 3 * HALF)), (_FLAT, _FLAT),
        None, "sink",
    ),
    "mass ratio 1e6 in a stack": (
        "the light box bears a million of its weights", (1, 1e6), ((0, 0, HALF), (0, 0, 3 * HALF)), (_FLAT, _FLAT),
        None, "sink",
    ),
    "mass ratio 1e6 the other way": (
        "the heavy box must not feel the light one", (1e6, 1), ((0, 0, HALF), (0, 0, 3 * HALF)), (_FLAT, _FLAT), None,
        "sink",
    ),
}  # fmt: skip
# Name: what is hard, radii [m], product of inertia, height over touch, turn, velocity, spin, step [s], measure.
ROUND: dict[str, tuple[Any, ...]] = {
    "bounces without end (Zeno)": (
        "infinitely many impacts before 0.1 s", (0.05, 0.05, 0.05), 0.0, 1e-3, _FLAT, _STILL, _STILL, 2e-3, "rest"
    ),
    "ball that grazes the floor": (
        "10 m/s along, 1e-6 m/s down", (0.05, 0.05, 0.05), 0.0, 0.0, _FLAT, (10, 0, -1e-6), _STILL, 1e-3, _ANY
    ),
    "ball in the floor to its centre": (
        "the overlap is its radius", (0.05, 0.05, 0.05), 0.0, -0.05, _FLAT, _STILL, _STILL, 1e-3, "speed"
    ),
    "disc spun on its edge": (
        "it leans and rattles ever faster", (0.05, 0.05, 0.005), 0.0, 0.0, (1.3, 0, 0), _STILL, (0, 25, 8), 1e-3, _ANY
    ),
    "rattleback": (
        "it turns round of itself: axes of inertia and of the surface differ", (0.1, 0.02, 0.015), 0.15, 0.0, _FLAT,
        _STILL, (0.1, 0.0, -8.0), 1e-3, _ANY,
    ),
    "needle dropped on its tip": (
        "a radius of curvature of 1e-5 m", (0.001, 0.001, 0.1), 0.0, 1e-3, (0.02, 0, 0), _STILL, _STILL, 1e-3, _ANY
    ),
}  # fmt: skip


def _box_scene(mass: Any) -> Scene:
    inertia = FullInertia(mass[:, None] * (2 * HALF) ** 2 / 6 * jnp.asarray((1.0, 1, 1, 0, 0, 0), mass.dtype))
    shape = Box(jnp.full((2, 3), HALF, mass.dtype))
    body = Body(mass, inertia, shape, jnp.zeros((2, 3), mass.dtype))
    laws = (RigidContact(HalfSpace(), friction=0.5), RigidContact(friction=0.5))
    return Scene(body, (UniformGravity((0, 0, -G)), *laws))


def _round_scene(numbers: Any) -> Scene:
    radii, product = numbers["radii"], numbers["product"]
    a, b, c = (radii[0] ** 2, radii[1] ** 2, radii[2] ** 2)
    own = jnp.stack([b + c, a + c, a + b]) / 5
    inertia = FullInertia(jnp.concatenate([own, jnp.stack([product * own[0], 0 * a, 0 * a])]))
    law = RigidContact(HalfSpace(), friction=0.4, restitution=0.5)
    return Scene(Body(1.0, inertia, Ellipsoid(radii)), (UniformGravity((0, 0, -G)), law))


def _states(numbers: Any) -> State:
    turned = jax.vmap(Quaternion.exp)(numbers["turn"])
    place = numbers["place"]
    return State(place, turned, numbers["velocity"], numbers["spin"], jnp.zeros((), place.dtype))


def _ran(scene_of: Any, numbers: Any) -> tuple[Path, Any, Any]:
    """Of every world the path, its energies, and the derivative of its end along a change of the velocities.

    Forward mode: half the compile time of the reverse pass, and one step of both agree (tests/contact).
    """

    def run(velocity: Any, given: Any) -> tuple[State, tuple[Path, Any]]:
        given = given | {"velocity": velocity}
        scene = scene_of(given)
        path = rollout(scene, _states(given), dt=given["dt"], steps=STEPS, save_every=EVERY, on_error="flag")
        return path.final, (path, jax.vmap(lambda s: energy(scene, s))(path.states))

    def one(given: Any) -> tuple[Path, Any, Any]:
        change = jnp.broadcast_to(
            jnp.asarray((0.48, 0.6, 0.64), given["velocity"].dtype), given["velocity"].shape
        )
        start = given["velocity"]
        _, slope, (path, energies) = jax.jvp(lambda v: run(v, given), (start,), (change,), has_aux=True)
        return path, energies, slope

    return jax.jit(jax.vmap(one), compiler_options=QUICK)(numbers)


def _worlds(rows: list[dict[str, Any]], kind: str) -> Any:
    return {
        name: jnp.asarray(np.stack([np.asarray(row[name], float) for row in rows]), kind) for name in rows[0]
    }


@functools.cache
def _boxes(kind: str) -> tuple[Path, Any, Any]:
    rows = [
        {
            "mass": mass, "place": place, "turn": turn, "velocity": np.zeros((2, 3)) if speed is None else speed,
            "spin": np.zeros((2, 3)), "dt": 2e-3,
        }
        for _, mass, place, turn, speed, _ in BOXES.values()
    ]  # fmt: skip
    return _ran(lambda given: _box_scene(given["mass"]), _worlds(rows, kind))


def _lowest(radii: Any, turn: Any) -> float:
    """How far below its centre a turned ellipsoid reaches: √(dᵀ A² d), d the vertical as the body sees it."""
    w, *u = _wxyz(turn)
    down = np.asarray((0.0, 0.0, 1.0))
    down = down + 2 * np.cross(np.cross(down, u) + w * down, u)
    return float(np.linalg.norm(np.asarray(radii) * down))


@functools.cache
def _rounds(kind: str) -> tuple[Path, Any, Any]:
    rows = [
        {
            "radii": radii, "product": product, "place": [(0, 0, _lowest(radii, turn) + over)], "turn": [turn],
            "velocity": [velocity], "spin": [spin], "dt": dt,
        }
        for _, radii, product, over, turn, velocity, spin, dt, _ in ROUND.values()
    ]  # fmt: skip
    return _ran(_round_scene, _worlds(rows, kind))


def _measured(found: tuple[Path, Any, Any], world: int, what: str) -> Measured:
    path, energies, slope = jax.tree.map(lambda leaf: np.asarray(leaf)[world], found)
    count, status = unannounced(path)
    velocity = np.linalg.norm(np.asarray(path.states.velocity, float), axis=-1)
    place = np.asarray(path.states.position, float)
    report = jax.tree.map(lambda leaf: leaf[-1], path.contact)
    note = ""
    if what == "drift":
        figure = np.abs(place - place[0]).max()
    elif what == "speed":
        figure = velocity.max()
    elif what == "rest":
        figure = velocity[-1].max()
    elif what == "sink":
        figure = float(report.penetration)
        if said := _announced(path, int(report.poor)):
            note, figure = f"overlap {figure:.1e} m, and the run {said}", 0.0
            if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope)):
                # No law was met that could be differentiated; said here, since a derivative carries no status.
                note, slope = f"{note}; its derivative is not finite", None
    else:
        scale = np.abs(energies[0]) + 0.5 * velocity.max() ** 2
        figure = (np.asarray(energies, float) - float(energies[0])).max() / scale
    return Measured(np.nan if count else float(figure), slope, status=status, note=note)


def _announced(path: Path, poor: int) -> str:
    """How a run says that its bodies sink into each other; empty where it does not."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        path.raise_if_bad()
    deep = any("overlapped" in str(w.message) for w in caught)
    return " and ".join(
        ([f"calls {poor} steps poor"] if poor else []) + (["warns of overlap"] if deep else [])
    )


_SAYS = {
    "drift": "farthest that a body strays from where it rests [m]",
    "speed": "fastest that overlap is pushed apart [m/s]",
    "rest": "speed that is left at the end [m/s]",
    "sink": "overlap [m], 0 where the run itself says that it is deep or that its steps are poor",
    _ANY: "largest rise of the energy above that of the start, relative",
}
_LIMITS = {
    "drift": {"float64": 1e-9, "float32": 1e-4},
    "speed": {"float64": 0.2, "float32": 0.2},
    "rest": {"float64": 1e-6, "float32": 1e-3},
    "sink": {"float64": 1e-3, "float32": 1e-3},
    _ANY: {"float64": 1e-6, "float32": 1e-4},
}


def _case(name: str, hard: str, what: str, run: Any, flight: Flight) -> Case:
    stable = _SAYS[what] + "; every state a number, or the status says where not; the derivative finite"
    return Case(name, hard, stable, _LIMITS[what], run, **peers_of(flight, what))


def _box_flight(row: tuple) -> Flight:
    _, mass, place, turn, velocity, _ = row
    return Flight("boxes", mass, [HALF] * 3, place, [_wxyz(t) for t in turn], velocity, dt=2e-3, steps=STEPS)


def _round_flight(row: tuple) -> Flight:
    _, radii, product, over, turn, velocity, spin, dt, _ = row
    a, b, c = (r * r for r in radii)
    inertia = [(b + c) / 5, (a + c) / 5, (a + b) / 5, product * (b + c) / 5, 0.0, 0.0]
    return Flight(
        "ellipsoid", [1.0], radii, [(0, 0, _lowest(radii, turn) + over)], [_wxyz(turn)], [velocity], [spin], [inertia],
        dt, STEPS, 0.4,
    )  # fmt: skip


def _wxyz(turn: Any) -> np.ndarray:
    """Of a rotation vector."""
    angle = np.linalg.norm(turn)
    axis = np.asarray(turn) / (angle or 1.0)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


def cases() -> tuple[Case, ...]:
    """The cases of this file."""

    def boxes(world: int, what: str) -> Measured:
        return _measured(_boxes(precision()), world, what)

    def rounds(world: int, what: str) -> Measured:
        return _measured(_rounds(precision()), world, what)

    return (
        *(
            _case(n, r[0], r[-1], functools.partial(boxes, i, r[-1]), _box_flight(r))
            for i, (n, r) in enumerate(BOXES.items())
        ),
        *(
            _case(n, r[0], r[-1], functools.partial(rounds, i, r[-1]), _round_flight(r))
            for i, (n, r) in enumerate(ROUND.items())
        ),
    )
