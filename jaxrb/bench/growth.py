"""How cost grows: time and memory against bodies, contacts, worlds, steps and devices, with measured exponents.

The sizes of one thing are run in turns, five rounds and more; each round gives an exponent of its own, the slope of the
line through the logarithms, and the median and the extremes of those are told. Times are CPU seconds of this process,
or wall seconds on an accelerator; of devices wall seconds, since that is what more of them save. Memory is what the
compiled program says that it takes: what it is given, results and scratch.
"""

import dataclasses
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

from jaxrb.accuracy.timing import clock
from jaxrb.body.body import Body, replicate
from jaxrb.draws import drawn
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import Box, HalfSpace
from jaxrb.scene.contact_library import sphere_box
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.scene.worlds import rollout_worlds

ROUNDS = 5
_DT = 2e-3
_MILLION = 1_000_000


@dataclasses.dataclass(frozen=True)
class Case:
    """What grows, in which numbers. `prepared(n)` is a compiled call, and its memory [B]; `steps(n)` are in a call."""

    name: str
    sizes: tuple[int, ...]
    prepared: Callable[[int], tuple[Callable[[], Any], int]]
    steps: Callable[[int], int]
    per: str = "a step"


def rows(rounds: int = ROUNDS) -> Iterator[dict[str, Any]]:
    """One row a size, the last of each with the exponents; then what a million would take, if it goes on so."""
    last = {}
    for case in CASES:
        found = list(measured(case, rounds))
        yield from found
        last[case.name] = found[-1]
    yield from _devices(rounds)
    for name in ("free bodies", "balls in a heap", "worlds of a free body", "worlds of a box on a floor"):
        yield foretold(last[name])


def measured(case: Case, rounds: int) -> Iterator[dict[str, Any]]:
    """The sizes of a case in turns."""
    runs, room = zip(*(case.prepared(size) for size in case.sizes), strict=True)
    for run in runs:
        jax.block_until_ready(run())
    seconds = np.empty((rounds, len(runs)))
    for i in range(rounds):
        for j, run in enumerate(runs):
            before = clock()
            jax.block_until_ready(run())
            seconds[i, j] = clock() - before
    seconds /= [case.steps(size) if case.per == "a step" else 1 for size in case.sizes]
    yield from _rows(case.name, case.sizes, seconds, room, case.per)


def _rows(
    name: str, sizes: Sequence[int], seconds: np.ndarray, room: Sequence[Any], per: str
) -> Iterator[dict[str, Any]]:
    slopes = [exponent(sizes, row) for row in seconds]
    top = [exponent(sizes[-2:], row[-2:]) for row in seconds]
    held = None if room[-1] is None else exponent(sizes[-2:], np.asarray(room[-2:], float))
    for j, size in enumerate(sizes):
        last = j == len(sizes) - 1
        yield {
            "of": name,
            "number": size,
            "time": 1e3 * float(np.median(seconds[:, j])),
            "unit": f"ms {per}",
            "memory [MB]": None if room[j] is None else 1e-6 * room[j],
            "exponent": float(np.median(slopes)) if last else None,
            "from": min(slopes) if last else None,
            "to": max(slopes) if last else None,
            "of the last two": float(np.median(top)) if last else None,
            "of memory": held if last else None,
        }


def exponent(sizes: Sequence[int], costs: Any) -> float:
    """p of cost ~ size^p: the slope of the line through the logarithms."""
    return float(np.polyfit(np.log(np.asarray(sizes, float)), np.log(np.asarray(costs, float)), 1)[0])


def foretold(largest: dict[str, Any], count: int = _MILLION) -> dict[str, Any]:
    """What `count` would take: the largest that was measured, times their ratio to the exponent of the last two sizes.

    An exponent below one, of sizes whose overhead is still seen, is taken as one, which foretells more.
    """
    ratio = count / largest["number"]
    slope, held = max(largest["of the last two"], 1.0), max(largest["of memory"], 1.0)
    return {
        "of": f"{largest['of']}, foretold",
        "number": count,
        "time": largest["time"] * ratio**slope,
        "unit": largest["unit"],
        "memory [MB]": largest["memory [MB]"] * ratio**held,
        "exponent": slope,
        "from": None,
        "to": None,
        "of the last two": None,
        "of memory": held,
    }


def _body() -> Body:
    return Body.from_shape(Box((0.1, 0.15, 0.2)), 500.0)


def _free(count: int) -> tuple[Scene, Any]:
    scene = Scene(replicate(_body(), count), UniformGravity())
    return scene, scene.state(_random(count, 3), angular_velocity=_random(count, 3))


def _random(*shape: int) -> np.ndarray:
    return drawn(0).normal(size=shape).astype(jax.dtypes.canonicalize_dtype(float))


def _box() -> tuple[Scene, Any]:
    scene = Scene(_body(), (UniformGravity(), RigidContact(HalfSpace(), friction=0.5)))
    return scene, scene.state((0.0, 0.0, 0.3), angular_velocity=(1.0, 2.0, 0.5))


def _heap(count: int) -> tuple[Scene, Any]:
    example = sphere_box(count)
    return example.scene, example.state()


def _single(world: Callable[[int], tuple[Scene, Any]], steps: int) -> Any:
    return lambda count: _compiled(*world(count), steps, lambda run: run)


def _many(world: Callable[[], tuple[Scene, Any]], steps: int) -> Any:
    def prepared(count: int) -> Any:
        scene, state = world()
        states = jax.tree.map(lambda x: np.broadcast_to(x, (count, *np.shape(x))).copy(), state)
        spin = states.angular_velocity + _random(*states.angular_velocity.shape)
        return _compiled(scene, dataclasses.replace(states, angular_velocity=spin), steps, jax.vmap)

    return prepared


def _compiled(
    scene: Scene, state: Any, steps: int, over: Callable[[Any], Any]
) -> tuple[Callable[[], Any], int]:
    def run(state: Any) -> Any:
        return rollout(scene, state, dt=_DT, steps=steps, save_every=steps, on_error="flag").final

    program = jax.jit(over(run)).lower(state).compile()
    said: Any = program.memory_analysis()
    kinds = ("argument", "output", "temp")
    return lambda: program(state), sum(getattr(said, f"{kind}_size_in_bytes", 0) for kind in kinds)


CASES = (
    Case("free bodies", (100, 1000, 10_000, 100_000), _single(_free, 100), lambda n: 100),
    Case("balls in a heap", (100, 700, 4900), _single(_heap, 100), lambda n: 100),
    Case("worlds of a free body", (100, 1000, 10_000, 100_000), _many(lambda: _free(1), 100), lambda n: 100),
    Case("worlds of a box on a floor", (16, 64, 256, 1024), _many(_box, 100), lambda n: 100),
    Case(
        "steps of ten free bodies",
        (1000, 10_000, 100_000),
        lambda n: _single(_free, n)(10),
        lambda n: n,
        "a run",
    ),
)


_DEVICES = """
import json, sys, time
import jax
from jaxrb.bench.growth import on_devices
print(json.dumps(on_devices(json.loads(sys.argv[1]), int(sys.argv[2]))))
"""


def _devices(rounds: int) -> Iterator[dict[str, Any]]:
    """In a process of its own, of as many virtual devices as there are cores; where there are real ones, those."""
    cores = os.cpu_count() or 1
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={cores}"
    most = cores if jax.default_backend() == "cpu" else jax.device_count()
    counts = [n for n in (1, 2, 4, 8, 16, 32, 64) if n <= most]
    if len(counts) < 2:
        return
    wide = str(int(jax.config.read("jax_enable_x64")))
    done = subprocess.run(
        [sys.executable, "-c", _DEVICES, json.dumps(counts), str(rounds)],
        env={**os.environ, "XLA_FLAGS": flags, "JAX_ENABLE_X64": wide}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    seconds = np.asarray(json.loads(done.stdout.splitlines()[-1]))
    yield from _rows("devices, 512 worlds", counts, seconds, [None] * len(counts), "a run, wall")


def on_devices(counts: Sequence[int], rounds: int) -> list[list[float]]:
    """Wall seconds (rounds, counts) of the same worlds over so many of this process's devices, in turns."""
    scene, state = _box()
    worlds = [(scene, state)] * 512
    meshes = [jax.make_mesh((n,), ("worlds",), devices=jax.devices()[:n]) for n in counts]
    found = []
    for i in range(rounds + 1):
        row = []
        for mesh in meshes:
            before = time.perf_counter()
            rollout_worlds(worlds, dt=_DT, steps=500, save_every=500, sharding=mesh, on_error="flag")
            row.append(time.perf_counter() - before)
        if i:  # the first compiles
            found.append(row)
    return found
