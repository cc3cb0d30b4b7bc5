"""Balls that fall into a heap in a box: what a step costs against their number, and how well it holds them apart.

All sizes use the sparse solve, so that the exponent is that of one method. Run times are those of a whole settling,
free fall, impacts and rest; sizes are run in turn and medians taken. The program is compiled by `jax.jit`, not with
`rb.compiler_options()`: for crowds XLA's slower compiler gives loops that run 0.7 times as long.
"""

import math
import time
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from jaxrb.accuracy.timing import cpu_of_first
from jaxrb.scene.contact_library import sphere_box
from jaxrb.scene.rollout import rollout

COUNTS = (100, 1000, 10_000)
_STEPS, _ROUNDS = 200, 3
_RADIUS = 0.05


def rows(counts: tuple[int, ...] = COUNTS) -> Iterator[dict[str, Any]]:
    """One row a number of balls; the last names the exponents of cost from the fewest to the most."""
    runs = [_Run(count) for count in counts]
    samples: list[list[tuple[float, float]]] = [[] for _ in runs]
    for _ in range(_ROUNDS):
        for run, own in zip(runs, samples, strict=True):
            own.append(run.seconds_a_step())
    medians = [np.median(own, axis=0) for own in samples]
    for run, (wall, cpu) in zip(runs, medians, strict=True):
        yield {
            "balls": run.count,
            "step [ms]": 1e3 * float(wall),
            "step [CPU ms]": 1e3 * float(cpu),
            "exponent": _exponent(runs[0].count, medians[0][1], run.count, cpu),
        } | run.report()


def _exponent(few: int, cost: float, many: int, more: float) -> float | None:
    return None if many == few else math.log(more / cost) / math.log(many / few)


class _Run:
    """One size: settled once, with its figures, and as long again at rest."""

    def __init__(self, count: int):
        self.count = count
        self.example = sphere_box(count)
        self.state = self.example.state()
        self.run = jax.jit(self._rollout)
        self.first = cpu_of_first(lambda: self.run(self.state).final)
        self.path = self.run(self.state)

    def _rollout(self, state: Any) -> Any:
        dt = self.example.dt or 5e-3
        return rollout(self.example.scene, state, dt=dt, steps=_STEPS, save_every=_STEPS, on_error="flag")

    def seconds_a_step(self) -> tuple[float, float]:
        """Wall and CPU seconds of a step, over the whole settling."""
        wall, cpu = time.perf_counter(), time.process_time()
        jax.block_until_ready(self.run(self.state).final)
        return (time.perf_counter() - wall) / _STEPS, (time.process_time() - cpu) / _STEPS

    def report(self) -> dict[str, Any]:
        """How the heap was held: from the start, and at its end, where every pair is looked at on the host."""
        wall = time.perf_counter()
        rest, contact = jax.block_until_ready(self.run(self.path.final)), self.path.contact
        wall = (time.perf_counter() - wall) / _STEPS
        lost = bool(contact.overflow[-1] >= 0) or bool(rest.contact.overflow[-1] >= 0)
        return {
            "at rest [ms]": 1e3 * wall,
            "first call [CPU s]": self.first,
            "deepest [mm]": 1e3 * float(contact.penetration[-1]),
            "at the end [mm]": 1e3 * deepest_pair(np.asarray(rest.final.position)),
            "rounds a step": float(contact.products[-1]) / _STEPS,
            "at rest": float(rest.contact.products[-1]) / _STEPS,
            "poor steps": int(contact.poor[-1]),
            "poor at rest": int(rest.contact.poor[-1]),
            "pairs lost": "yes" if lost else 0,
        }


def deepest_pair(position: np.ndarray) -> float:
    """The deepest overlap [m] of any two balls, found on the host without the broad phase."""
    deepest, order = 0.0, np.argsort(position[:, 2])
    place = position[order].astype(float)
    for i in range(len(place) - 1):
        end = np.searchsorted(place[:, 2], place[i, 2] + 2 * _RADIUS)
        if end > i + 1:
            gap = np.linalg.norm(place[i + 1 : end] - place[i], axis=1).min() - 2 * _RADIUS
            deepest = max(deepest, -float(gap))
    return deepest
