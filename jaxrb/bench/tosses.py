"""Row F of the scoreboard: tosses of a real cube, predicted from their first recorded state.

Half of the recordings are fitted (friction, restitution, the length of the recording's metre, the cube's side and its
inertia), the other half is predicted. (Recordings: Pfrommer, Halm, Posa 2020, "ContactNets"; BSD-3-Clause.)
"""

import os
import pathlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.bench.published import CUBE_TOSSES
from jaxrb.body.body import Body
from jaxrb.body.inertia import SphericalInertia
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.fit.metre import METRIC_SCALE
from jaxrb.fit.predictions import recorded, toss_errors
from jaxrb.fit.tosses import Search, fit_tosses
from jaxrb.geometry.primitives import Box, HalfSpace
from jaxrb.io.recording_files import read_recording
from jaxrb.scene.scene import Scene

FILE = "JAXRB_CUBE_TOSSES"  # environment: where the recordings are
_PLACE, _NAME = "shared/data/cube_tosses", "cube_tosses_*.npz"
GOAL_MM, GOAL_DEG = 20.0, 16.0
COLUMNS = {
    "position_mm": "position, mean [mm]",
    "attitude_deg": "attitude, mean [°]",
    "median_mm": "median [mm]",
    "median_deg": "median [°]",
    "goal": "goal",
    "verdict": "",
}
_SIDE, _MASS = 0.1048, 0.37  # [m], [kg]
# Where the search begins, and how wide; the side is a share of that above, the inertia over that of a full cube (a
# shell has 5/3).
_SEARCH = {
    "friction": Search(0.2, 0.03, 0.02, 1.0),
    "restitution": Search(0.1, 0.05, 0.0, 0.5),
    METRIC_SCALE: Search(-0.02, 0.015, -0.1, 0.1),
    "size": Search(1.0, 0.015, 0.9, 1.1),
    "inertia": Search(1.3, 0.25, 0.6, 5.0 / 3.0),
}
_ROUNDS = {"quick": (2, 6), "default": (6, 12), "long": (10, 16)}

Entry = dict[str, Any]


def tosses_row(length: str = "default") -> Iterator[Entry]:
    """150 tosses: every second one fitted, the others predicted; means over each toss, then over the tosses."""
    yield from (result.entry() for result in CUBE_TOSSES)
    file = recordings()
    if file is None:
        yield {
            "who": "jaxrb",
            "setting": f"the recordings are not here; set {FILE} to cube_tosses_150.npz (made of DAIRLab/contact-nets)",
        }
        return
    tosses, rate = recorded(read_recording(file))
    fitted, kept = (tosses.some(np.arange(start, len(tosses.there), 2)) for start in (0, 1))
    began = time.process_time(), time.perf_counter()
    rounds, samples = _ROUNDS[length]
    # 4 steps a frame; twice as many change the means by 0.2 mm and 0.5°.
    found = fit_tosses(
        (fitted, rate), scene_of, _SEARCH, length=0.5 * _SIDE, rounds=rounds, samples=samples
    ).values
    costs = {
        "cpu_s": time.process_time() - began[0],
        "wall_s": time.perf_counter() - began[1],
    }
    numbers = ", ".join(f"{name} {value:.3f}" for name, value in found.items())
    for name, some in (("fitted", fitted), ("predicted", kept)):
        off = toss_errors(some, rate, scene_of, found)
        figures = _figures(*off)
        judged = figures["position_mm"] <= GOAL_MM and figures["attitude_deg"] <= GOAL_DEG
        told = {"goal": f"≤ {GOAL_MM:g} mm, {GOAL_DEG:g}°", "verdict": "met" if judged else "missed"}
        setting = f"{len(some.there)} tosses {name}: {numbers}"
        yield {
            "who": "jaxrb",
            "setting": setting,
            **figures,
            **(told if name == "predicted" else {}),
            **costs,
        }


def recordings() -> pathlib.Path | None:
    """The file of recordings, if there is one."""
    named = os.environ.get(FILE)
    if named:
        return pathlib.Path(named)
    here = pathlib.Path.cwd()
    found = (file for folder in (here, *here.parents) for file in sorted((folder / _PLACE).glob(_NAME)))
    return next(found, None)


def scene_of(numbers: Mapping[str, Any]) -> Scene:
    """The cube and the table for the numbers."""
    side = numbers["size"] * _SIDE
    moment = SphericalInertia(numbers["inertia"] * _MASS * side**2 / 6.0)
    cube = Body(_MASS, moment, Box(0.5 * side * jnp.ones(3)))
    contact = RigidContact(HalfSpace(), numbers["friction"], numbers["restitution"])
    return Scene(cube, (UniformGravity(), contact))


def _figures(position: np.ndarray, angle: np.ndarray) -> dict[str, float]:
    position, angle = 1e3 * position, np.rad2deg(angle)
    return {
        "position_mm": float(position.mean()),
        "attitude_deg": float(angle.mean()),
        "median_mm": float(np.median(position)),
        "median_deg": float(np.median(angle)),
    }
