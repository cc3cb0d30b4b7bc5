"""Memory of runs: what `rb.memory` says before they start, beside what they take.

Each runs in a process of its own. What it takes is the largest resident set while it runs over that just before
(Linux); the runs are large enough that the compiler's own memory does not hide them.
"""

import dataclasses
import multiprocessing
import pathlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from jaxrb.accuracy.memory import compiled_run, memory
from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.effects.drag import LinearDrag
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import Box, HalfSpace
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.scene import Scene

_DT, _STATUS = 1e-3, pathlib.Path("/proc/self/status")


@dataclasses.dataclass(frozen=True)
class Workload:
    """A run: `bodies` in each of `worlds` (None: one, not vmapped), `steps`, saved every `save_every`."""

    name: str
    bodies: int
    steps: int
    save_every: int = 1
    worlds: int | None = None
    gradient: bool = False
    contact: bool = False
    matrices: bool = False


WORKLOADS = (
    Workload("one body, all states saved", 1, 1_000_000),
    Workload("1000 bodies, all states saved", 1000, 1500),
    Workload("1000 bodies as matrices", 1000, 1000, matrices=True),
    Workload("10000 bodies, every tenth state", 10_000, 1500, 10),
    Workload("1000 worlds of a body", 1, 1500, worlds=1000),
    Workload("100 worlds of 50 bodies, every fifth state", 50, 1500, 5, worlds=100),
    Workload("64 boxes on a floor", 64, 10_000, contact=True),
    Workload("256 worlds of a box on a floor", 1, 3000, worlds=256, contact=True),
    Workload("gradient, 20000 bodies", 20_000, 400, 20, gradient=True),
    Workload(
        "gradient, 512 worlds of a box on a floor", 1, 500, 500, worlds=512, gradient=True, contact=True
    ),
)


def rows() -> Iterator[dict[str, Any]]:
    """One row a workload: megabytes said, taken, and their ratio."""
    context = multiprocessing.get_context("spawn")
    for workload in WORKLOADS:
        with context.Pool(1) as pool:
            said, taken = pool.apply(measured, (workload,))
        yield {
            "run": workload.name,
            "said [MB]": 1e-6 * said,
            "taken [MB]": None if taken is None else 1e-6 * taken,
            "said/taken": None if taken is None else said / taken,
        }


def measured(workload: Workload) -> tuple[int, int | None]:
    """Bytes that a run is said to take beyond what it is given, and those that it takes."""
    scene, state = _world(workload)
    how = {"worlds": workload.worlds, "gradient": workload.gradient, "save_every": workload.save_every}
    said = memory(scene, state, dt=_DT, steps=workload.steps, **how)
    program, numbers = compiled_run(scene, state, _DT, workload.steps, RungeKutta4(), **how)
    if workload.worlds is not None:
        count = workload.worlds
        state = jax.tree.map(lambda x: np.broadcast_to(x, (count, *x.shape)).copy(), state)
    numbers, state = jax.tree.map(jax.numpy.asarray, (numbers, state))
    if not _STATUS.exists():
        return said.results + said.working, None
    pathlib.Path("/proc/self/clear_refs").write_text("5")  # the peak begins here
    before = _kilobytes("VmRSS")
    found = jax.block_until_ready(program(numbers, state))
    after = _kilobytes("VmHWM")
    del found
    return said.results + said.working, 1024 * (after - before)


def _kilobytes(name: str) -> int:
    (line,) = (row for row in _STATUS.read_text().splitlines() if row.startswith(name + ":"))
    return int(line.split()[1])


def _world(workload: Workload) -> tuple[Scene, State]:
    random = drawn(0)
    body = Body.from_shape(Box((0.1, 0.2, 0.3)), 500.0)
    gravity = UniformGravity((0.0, 0.0, -9.81))
    other = RigidContact(HalfSpace(), friction=0.5) if workload.contact else LinearDrag(0.1, 0.01)
    bodies = body if workload.bodies == 1 else replicate(body, workload.bodies)
    scene = Scene(bodies, (gravity, other))
    spin = random.normal(size=(workload.bodies, 3))
    place = random.uniform(0.4, 0.6, (workload.bodies, 3))
    rotation = RotationMatrix if workload.matrices else Quaternion
    return scene, scene.state(place, angular_velocity=spin, rotation=rotation)
