"""How many Adams steps a run needs: found by a pilot of some bodies, checked on all."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.integrators.adams_weights import Scheme
from jaxrb.math.arrays import Array, Vector
from jaxrb.scene import adams_lanes as lanes
from jaxrb.scene.scene import Scene

_RATIO = 1.3  # the pilot compares n steps with 1.3 n
_ROOM = 0.5  # the estimate stays below this part of the tolerance
_CROWD = 10.0  # the largest error of 1000 tops was up to 16 times that of a pilot of 48, on chaotic motion
_ATTEMPTS = 16


class Problem(NamedTuple):
    """A run, but for its number of steps."""

    scene: Scene
    state: State
    torque: Vector | None
    t1: Array
    times: Array | None
    scheme: Scheme

    @property
    def traced(self) -> bool:
        values = (self.scene, self.state, self.torque, self.t1, self.times)
        return not all(is_concrete(leaf) for leaf in jax.tree.leaves(values))

    @property
    def index(self) -> np.ndarray:
        return lanes.groups(self.scene.count, lanes.group_size(self.scene, self.state))

    def run(self, index: np.ndarray, used: int, cycles: int) -> lanes.Ends:
        span = self.t1 - self.state.time
        arguments = (self.scene, self.state, self.torque, span, self.times, jnp.asarray(index))
        if self.traced:
            return lanes.differentiable(*arguments, used=used, cycles=cycles, scheme=self.scheme)
        return lanes.compiled()(*arguments, jnp.asarray(used), jnp.asarray(cycles), scheme=self.scheme)

    def all_bodies(self, cycles: int) -> lanes.Ends:
        return self.run(self.index, len(self.index), cycles)

    def few(self, bodies: np.ndarray, cycles: int) -> lanes.Ends:
        """The bodies of a pilot, in the program of all: they fill the first group."""
        index = self.index
        if len(index) > 1:
            index = np.concatenate([np.resize(bodies, (1, index.shape[1])), index[1:]])
        return self.run(index.astype(np.int32), 1, cycles)


class Found(NamedTuple):
    """A run with its number of turns of the ring, the estimate of its error, and whether that meets the tolerance."""

    ends: lanes.Ends
    cycles: int
    error: float | None  # None where steps were given
    met: bool


def planned(problem: Problem, tolerance: float) -> Found:
    """Find the number of cycles with a pilot, run all bodies, and repeat with those that failed in the pilot."""
    scheme = problem.scheme
    size = problem.index.shape[1]
    whole = len(problem.index) == 1
    spin = np.linalg.norm(np.asarray(problem.state.angular_velocity, float), axis=-1)
    bodies = _pilot_bodies(spin, size)
    span = float(problem.t1) - float(problem.state.time)
    cycles = scheme.cycles(min(span * float(np.nan_to_num(spin.max())) / 0.3, 1e7))
    for _ in range(4):
        last = _pilot(problem, bodies, cycles, tolerance)
        if whole:
            return last
        ends = problem.all_bodies(last.cycles)
        finite, drift = np.asarray(ends.finite), np.asarray(ends.drift, float)
        good = finite & (np.maximum(drift, np.asarray(ends.roughness)) <= 10 * tolerance)
        worst = drift.max(initial=0.0, where=finite)
        error = (
            (last.error or 0.0) * max(1.0, worst / max(drift[bodies].max(), 1e-300)) if good.all() else np.inf
        )
        if error <= tolerance or not last.met:
            return Found(ends, last.cycles, error, error <= tolerance)
        suspects = np.argsort(np.where(finite, drift, np.inf))[::-1][: max(size // 2, 1)]
        bodies = np.concatenate([suspects, bodies])[:size]
        last, cycles = Found(ends, last.cycles, error, False), last.cycles
    return last


def _pilot_bodies(spin: np.ndarray, size: int) -> np.ndarray:
    """Half the fastest bodies, half spread over all."""
    count = min(size, len(spin))
    fastest = np.argsort(spin)[::-1][: count // 2]
    return np.concatenate([fastest, np.linspace(0, len(spin) - 1, count - count // 2).astype(int)])


def _pilot(problem: Problem, bodies: np.ndarray, cycles: int, tolerance: float) -> Found:
    """The least number of cycles at which n and 1.3 n steps agree to well below the tolerance.

    The result is the run with 1.3 n steps when the pilot is all there is, else the number n with its error.
    """
    scheme, goal = problem.scheme, _ROOM * tolerance
    whole = len(problem.index) == 1
    size = problem.index.shape[1]
    margin = 1.0 if whole else _CROWD
    best: Found | None = None
    shrunk = False
    for _ in range(_ATTEMPTS):
        finer = scheme.cycles(_RATIO * scheme.steps(cycles))
        coarse, fine = problem.few(bodies, cycles), problem.few(bodies, finer)
        ratio = scheme.steps(finer) / scheme.steps(cycles)
        largest = np.asarray(_differences(coarse.final, fine.final), float)[:size].max()
        error = margin * float(largest) / (1 - ratio**-scheme.order)
        if error <= goal:
            best = Found(fine if whole else coarse, finer if whole else cycles, error, True)
            factor = 1.1 * (max(error, 1e-3 * goal) / goal) ** (1 / scheme.order)
            fewer = scheme.cycles(factor * scheme.steps(cycles))
            if shrunk or fewer > 0.8 * cycles:
                return best
            shrunk, cycles = True, fewer
            continue
        if best is not None and best.met:
            return best
        if best is not None and best.error is not None and 0.5 * best.error < error < 1e3 * tolerance:
            return Found(coarse, cycles, error, error <= tolerance)  # more steps do not help
        best = Found(coarse, cycles, error, False)
        factor = min((error / goal) ** (1 / scheme.order) * 1.05, 2.0) if error < 0.1 else 1.6
        cycles = max(scheme.cycles(factor * scheme.steps(cycles)), cycles + 1)
    assert best is not None
    return best


@jax.jit
def _differences(a: State, b: State) -> Array:
    """Difference of two states of each body (n,), in the measure of the tolerance; infinite where one is not finite."""
    found = a.orientation.angle_to(b.orientation)
    for name in ("position", "velocity", "angular_velocity"):
        x, y = getattr(a, name), getattr(b, name)
        size = jnp.sqrt(jnp.sum(y * y, axis=-1))
        found = jnp.maximum(found, jnp.sqrt(jnp.sum((x - y) ** 2, axis=-1)) / (1 + size))
    return jnp.where(jnp.isfinite(found), found, jnp.inf)
