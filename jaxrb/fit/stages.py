"""The search for the best trajectory fit: short windows first, then whole flights, noise and misfits.

From a poor start, a long trajectory is lost after a few turns and its sum of squares is full of hollows. Over
a window of a few radians there is one hollow. So windows are fitted first, all of them at once with the
inertia in common, and made longer until the inertia is known well enough to follow a whole flight.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.fit.least_squares import MEANING, Solution, levenberg_marquardt
from jaxrb.fit.packing import Pieces, longest_turn, pack, spin_noise, turn_per_sample, whole, windows
from jaxrb.fit.residuals import RATIO_COORDINATES, FlightData, TrajectoryResidual
from jaxrb.fit.segments import Flights
from jaxrb.fit.uncertainty import directions, information
from jaxrb.io.recording import Recording

_WINDOW_TURN = 4.0  # [rad] of the first windows
_WINDOW_GROWTH = 8
_SUBSTEP_TURN = (
    0.2  # [rad] a Runge–Kutta step may span: its error is then 1e-6 of the turn; checked after the fit
)
_SHORTEST_WINDOW = 8  # intervals
_OUTLIER = 4.0  # times the usual misfit
_ENOUGH_TO_JUDGE = 8  # flights
_FIRST_ATTITUDE_SCALE = 1e-3  # [rad], a guess that the fit corrects


@dataclass
class Problem:
    """What is fitted to what."""

    recording: Recording
    flights: Flights
    spin: np.ndarray  # (N, 3) [rad/s] measured, or differentiated from the attitude
    residual: TrajectoryResidual
    progress: Callable[[str], None]

    def pack(self, pieces: Pieces, scales: np.ndarray) -> FlightData:
        """Padded arrays of the pieces, on the device."""
        return jax.tree.map(jnp.asarray, pack(self.recording, pieces, self.spin, (scales[0], scales[1])))

    def first_local(self, pieces: Pieces, known: dict[int, np.ndarray]) -> np.ndarray:
        """(S, Q) start of the pieces' own unknowns: a known angular velocity, else the measured one."""
        local = np.zeros((len(pieces), self.residual.local_size))
        local[:, :3] = [known.get(piece.start, self.spin[piece.start]) for piece in pieces]
        return local


@dataclass
class Fitted:
    """The best fit found, with its data. `scales`: of the angular velocity and of the attitude."""

    solution: Solution
    data: FlightData
    weight: np.ndarray  # (S,) 1 or 0
    scales: np.ndarray
    misfit: np.ndarray  # (S,) root mean square residual of each flight, in scales
    integration_error: float
    stages: list[str] = field(default_factory=list)


def substeps_for(recording: Recording, flights: Flights) -> int:
    """Runge–Kutta steps between two samples."""
    return max(1, int(np.ceil(turn_per_sample(recording, flights, 1.0) / _SUBSTEP_TURN)))


def search(problem: Problem, starts: list[np.ndarray], max_iterations: int) -> Fitted:
    """Fit windows of growing length, then whole flights with noise scales and outliers.

    `starts` are coordinates (P,) to begin from, in the order in which they are tried.
    """
    scales = np.array([spin_noise(problem.recording, problem.flights), _FIRST_ATTITUDE_SCALE])
    stages: list[str] = []
    starts, known = _through_windows(problem, starts, scales, max_iterations, stages)
    pieces = whole(problem.flights)
    first = _best_of(problem, starts, pieces, problem.first_local(pieces, known), scales, max_iterations)
    shared, local = np.asarray(first.shared), np.asarray(first.local)
    weight = np.ones(len(pieces))
    for round_ in range(8):
        data = problem.pack(pieces, scales)
        problem.progress(f"whole flights, round {round_ + 1}: {int(weight.sum())} of {len(pieces)}")
        solution = solve(problem.residual, shared, local, data, weight, max_iterations)
        shared, local = np.asarray(solution.shared), np.asarray(solution.local)
        squares, error = _squares(problem.residual, shared, local, data)
        misfit, new_scales, new_weight = _reweigh(problem, data, np.asarray(squares), scales)
        settled = np.all(np.abs(np.log(new_scales / scales)) < 0.01) and np.array_equal(weight, new_weight)
        stages.append(_account("whole flights", len(pieces), solution))
        if settled or round_ == 7:
            break
        scales, weight = new_scales, new_weight
    return Fitted(solution, data, weight, scales, misfit, float(error), stages)


def solve(residual, shared, local, data, weight, max_iterations: int, free=None) -> Solution:
    """The compiled solver with everything as device arrays."""
    shared = jnp.asarray(shared)
    free = jnp.ones_like(shared) if free is None else jnp.asarray(free)
    return levenberg_marquardt(
        residual, shared, jnp.asarray(local), data, weight=jnp.asarray(weight), free=free,
        max_iterations=jnp.asarray(max_iterations), tolerance=jnp.asarray(1e-8),
    )  # fmt: skip


def _best_of(problem: Problem, starts: list[np.ndarray], pieces: Pieces, local, scales, max_iterations: int):
    """The lowest end of the starts. When two have ended at the same cost, the others are not tried."""
    data = problem.pack(pieces, scales)
    best, agreed = None, False
    for shared in starts:
        there = solve(problem.residual, shared, local, data, np.ones(len(pieces)), max_iterations)
        cost = float(there.cost)
        if best is not None:
            agreed = abs(cost - float(best.cost)) <= 1e-3 * min(cost, float(best.cost))
        if best is None or cost < float(best.cost):
            best = there
        if agreed:
            break
    assert best is not None
    return best


def _through_windows(problem: Problem, starts, scales, max_iterations: int, stages: list[str]):
    """Starts that follow whole flights, and the angular velocity at each window's start."""
    longest = longest_turn(problem.recording, problem.flights)
    per_sample = max(turn_per_sample(problem.recording, problem.flights), 1e-12)
    count = max(_SHORTEST_WINDOW, int(np.ceil(_WINDOW_TURN / per_sample)))
    known: dict[int, np.ndarray] = {}
    while count * per_sample * 1.5 < longest and count * 1.5 < max(map(len, problem.flights.flights)):
        pieces = windows(problem.flights, count)
        problem.progress(f"{len(pieces)} windows of {count} samples")
        local = problem.first_local(pieces, known)
        solution = _best_of(problem, starts, pieces, local, scales, max_iterations)
        stages.append(_account(f"windows of {count} intervals", len(pieces), solution))
        shared, local = np.asarray(solution.shared), np.asarray(solution.local)
        starts, known = [shared], {piece.start: spin[:3] for piece, spin in zip(pieces, local)}
        if _phase_error(problem, solution, pieces, scales, count) < 0.3:
            break
        count *= _WINDOW_GROWTH
    return starts, known


def _phase_error(problem: Problem, solution: Solution, pieces: Pieces, scales, count: int) -> float:
    """Error [rad] to be expected at the end of the longest flight; at a radian or so the track is lost."""
    longest = longest_turn(problem.recording, problem.flights)
    duration = max(np.ptp(problem.recording.time[f.start : f.stop]) for f in problem.flights.flights)
    channels = problem.residual.use_spin + problem.residual.use_attitude
    values = 3.0 * channels * sum(map(len, pieces))
    misfit = np.sqrt(2.0 * float(solution.cost) / values)
    found = directions(information(solution.normal, np.ones(len(pieces))), np.asarray(solution.shared))
    start = scales[0] / np.sqrt(count) if problem.residual.use_spin else 0.0
    return float(misfit * (found.deviation[0] * longest + start * duration))


@eqx.filter_jit
def _squares(residual: TrajectoryResidual, shared, local, data):
    """Sums of squares (channels, S) in scales, and the largest integration error in scales.

    The error is seen by halving the Runge–Kutta steps, which leaves a sixteenth of it.
    """
    finer = dataclasses.replace(residual, substeps=2 * residual.substeps)

    def channels(which):
        return jax.vmap(lambda phi, d: jnp.stack(which.channels(shared, phi, d)))(local, data)

    coarse = channels(residual)
    error = jnp.max(jnp.abs(coarse - channels(finer)))
    return jnp.sum(coarse**2, axis=(2, 3)).T, error


def _reweigh(problem: Problem, data: FlightData, squares: np.ndarray, scales: np.ndarray):
    """Misfit of each flight, noise scales by maximum likelihood, and which flights to keep."""
    residual = problem.residual
    samples = 3.0 * np.asarray(data.present).sum(axis=1)
    misfit = np.sqrt(np.mean(squares / samples, axis=0))
    keep = np.ones(len(misfit))
    if len(misfit) >= _ENOUGH_TO_JUDGE:
        # Each channel against its own usual misfit: the scales themselves may be inflated by the outliers.
        each = np.sqrt(squares / samples)
        usual = np.median(each, axis=1, keepdims=True)
        keep = (np.max(each / np.where(usual > 0, usual, 1.0), axis=0) <= _OUTLIER).astype(float)
    used = keep > 0
    unknowns = used.sum() * residual.local_size + 5 + residual.drag
    total = samples[used].sum() * len(squares)
    inflate = total / max(total - unknowns, 1.0)
    new = scales.copy()
    places = [place for place, use in enumerate((residual.use_spin, residual.use_attitude)) if use]
    for place, square in zip(places, squares):
        variance = square[used].sum() / samples[used].sum() * inflate
        size = max(float(np.sqrt(np.mean(problem.spin**2))), 1e-9) if place == 0 else 1.0
        new[place] = max(scales[place] * float(np.sqrt(variance)), 1e-10 * size)
    return misfit, new, keep


def _account(name: str, count: int, solution: Solution) -> str:
    return f"{name} ({count}): {int(solution.iterations)} iterations, {MEANING[int(solution.status)]}"


def profile_rises(
    problem: Problem, fitted: Fitted, solution: Solution, moves: np.ndarray, deviations: np.ndarray
) -> list[tuple[float, float]]:
    """How much the cost of `solution` rises far out along each direction, and how much was foretold.

    Noise can pose as information: a wobble fitted to it has a frequency that seems sharp. Twenty deviations
    away a real signal is missed by far, while noise is fitted about as well as before.
    """
    rises: list[tuple[float, float]] = []
    for move, deviation in zip(moves, deviations):
        if not np.isfinite(deviation):
            rises.append((0.0, np.inf))
            continue
        length = min(20.0 * deviation, 2.0 / max(float(np.abs(move).max()), 1e-300))
        away = np.asarray(solution.shared).copy()
        away[:5] += length * move
        there = held(problem, fitted, away)
        rises.append((float(there.cost) - float(solution.cost), 0.5 * (length / deviation) ** 2))
    return rises


def held(problem: Problem, fitted: Fitted, shared: np.ndarray) -> Solution:
    """The fit with the inertia ratios held at `shared`, everything else free."""
    free = np.zeros(len(shared))
    free[RATIO_COORDINATES:] = 1.0
    return solve(problem.residual, shared, fitted.solution.local, fitted.data, fitted.weight, 40, free)
