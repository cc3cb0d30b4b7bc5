"""Hard cases in other engines: the same flight, and the same measure of what became of it."""

import dataclasses
import functools
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrb.accuracy.mujoco_modules import mujoco_modules
from jaxrb.hard import peer_engines

PYTHON = "JAXRB_PEERS_PYTHON"
_PATIENCE = 900  # [s]
NAMES = {"mjx": "MJX", "brax": "Brax"}


@dataclasses.dataclass(frozen=True)
class Flight:
    """What `peer_engines` flies; numbers are told there. `turns` are quaternions wxyz."""

    kind: str
    masses: Sequence[float]
    half: Sequence[float]
    places: Any
    turns: Any = None
    velocities: Any = None
    spins: Any = None
    inertia: Any = None
    dt: float = 1e-3
    steps: int = 100
    friction: float = 0.5
    damping: float = 0.0

    def plain(self) -> dict[str, Any]:
        """As JSON takes it: inertia of a full box, no turn and no speed where nothing is said."""
        count = len(self.masses)
        x, y, z = (float(h) ** 2 for h in self.half)
        box = [[m / 3 * s for s in (y + z, x + z, x + y)] + [0.0] * 3 for m in self.masses]
        still, level = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        parts = {
            "places": self.places,
            "turns": level if self.turns is None else self.turns,
            "velocities": still if self.velocities is None else self.velocities,
            "spins": still if self.spins is None else self.spins,
            "inertia": box if self.inertia is None else self.inertia,
            "masses": self.masses,
            "half": self.half,
        }
        plain = {name: np.asarray(part, float).tolist() for name, part in parts.items()}
        numbers = {"dt": self.dt, "steps": self.steps, "friction": self.friction, "damping": self.damping}
        return plain | {"kind": self.kind} | numbers


def figure(flight: Flight, what: str, states: np.ndarray) -> float:
    """What `jaxrb hard-cases` measures of its own runs, of states (k, n, 13) of another engine; NaN stays NaN."""
    place, velocity = states[..., :3], states[..., 7:10]
    speed = np.linalg.norm(velocity, axis=-1)
    if what == "drift":
        return float(np.abs(place - place[0]).max())
    if what in ("speed", "rest"):
        return float((speed if what == "speed" else speed[-1]).max())
    if what == "sink":  # of upright boxes in a pile
        height = place[-1, :, 2]
        gaps = np.concatenate([height[:1] - flight.half[2], np.diff(height) - 2 * flight.half[2]])
        return float(np.maximum(-gaps, 0.0).max())
    with np.errstate(invalid="ignore", over="ignore"):  # of states that are no numbers
        energy = _energy(flight.plain(), states)
        if what == "lies":  # on a face whose height is that of no turn
            least = -np.sum(flight.masses) * peer_engines.GRAVITY * flight.half[2]
            worst = np.maximum(np.abs(energy[-1] - least), (energy - energy[0]).max())
            return float(worst / (energy[0] - least))
        return float((energy - energy[0]).max() / (np.abs(energy[0]) + 0.5 * speed.max() ** 2))


def _energy(plain: dict[str, Any], states: np.ndarray) -> np.ndarray:
    """(k,) [J]"""
    mass, six = np.asarray(plain["masses"]), np.asarray(plain["inertia"])
    spin = states[..., 10:]
    turning = (six[:, :3] * spin**2).sum(-1)
    for column, (i, j) in zip((3, 4, 5), ((0, 1), (0, 2), (1, 2)), strict=True):
        turning = turning + 2 * six[:, column] * spin[..., i] * spin[..., j]
    kinetic = 0.5 * (mass * (states[..., 7:10] ** 2).sum(-1) + turning)
    return (kinetic - mass * peer_engines.GRAVITY * states[..., 2]).sum(-1)


def peers_of(flight: Flight, what: str) -> dict[str, Any]:
    """What a `Case` has for its peers: the flight, its figure in MuJoCo, and the measure for other engines."""

    def run() -> float:
        mujoco_modules()
        (states,) = peer_engines.in_mujoco([flight.plain()])
        return figure(flight, what, states)

    return {"flight": flight, "peer": run, "of_peer": functools.partial(figure, flight, what)}


def flown(engine: str, flights: Sequence[Flight]) -> list[np.ndarray | None] | str:
    """The states of each flight in an engine, None where it lacks the shape; or in words why there are none.

    They are computed in float32, the engine's own habit, by the Python that the environment variable
    JAXRB_PEERS_PYTHON names, or this one.
    """
    python = os.environ.get(PYTHON, sys.executable)
    command, text = (
        [python, peer_engines.__file__, engine],
        json.dumps([flight.plain() for flight in flights]),
    )
    environment = os.environ | {"JAX_ENABLE_X64": "0"}
    try:
        done = subprocess.run(
            command,
            input=text,
            capture_output=True,
            text=True,
            check=False,
            env=environment,
            timeout=_PATIENCE,
        )
    except subprocess.TimeoutExpired:
        return f"not measured: more than {_PATIENCE} s"
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        return f"not measured: {last[:120]}"
    answers = json.loads(done.stdout.splitlines()[-1])
    return [None if answer is None else np.asarray(answer, float) for answer in answers]
