"""The search for the best trajectory fit: multiple shooting from several starts, then noise scales and misfits."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.compilation import jit
from jaxrb.fit.least_squares import MEANING, levenberg_marquardt
from jaxrb.fit.packing import pack, rounded, spin_noise, turn_per_sample
from jaxrb.fit.problem import Prior, Solution
from jaxrb.fit.residuals import RATIO_COORDINATES, FlightData, TrajectoryResidual
from jaxrb.fit.segments import Flights
from jaxrb.fit.shooting import schedule, tighten
from jaxrb.io.recording import Recording

_WINDOW_TURN = 0.6  # [rad] of a window
_SHORTEST_WINDOW = 4  # intervals
_SUBSTEP_TURN = (
    0.2  # [rad] a Runge–Kutta step may span: its error is then 1e-6 of the turn; checked after the fit
)
_OUTLIER = 4.0  # times the usual misfit
_ENOUGH_TO_JUDGE = 8  # flights
_FIRST_ATTITUDE_SCALE = 1e-3  # [rad], a guess that the fit corrects
_FIRST_FORCE_SCALE = 0.1  # [m/s²], another


@dataclass
class Problem:
    """What is fitted to what, and how."""

    recording: Recording
    flights: Flights
    spin: np.ndarray  # (N, 3) [rad/s] measured, or differentiated from the attitude
    residual: TrajectoryResidual
    free: np.ndarray  # (P,) 1 for shared unknowns to be fitted, 0 for those held
    progress: Callable[[str], None]
    unit: float = 1.0  # [kg m²] the first guess of tr(I)
    huber: float = np.inf
    prior: Prior | None = None
    max_iterations: int = 200
    masked: np.ndarray | None = None  # (N,) True for samples that are not compared

    def pack(self, scales: np.ndarray, count: int | None = None) -> tuple[FlightData, np.ndarray]:
        """Padded arrays of the flights, in one piece or in windows of `count` intervals."""
        intervals = max(len(flight) for flight in self.flights.flights) - 1
        longest = rounded(intervals) if count is None else count * rounded(-(-intervals // count))
        return pack(
            self.recording, self.flights.flights, self.spin, scales, count,
            longest=longest, unit=self.unit, force=self.residual.use_force, masked=self.masked,
        )  # fmt: skip

    def with_free(self, names: tuple[str, ...]) -> "Problem":
        """The same problem with only the ratios and these unknowns fitted."""
        free = np.zeros(self.residual.shared_size)
        free[:RATIO_COORDINATES] = 1.0
        for name in names:
            free[self.residual.place(name)] = 1.0
        return dataclasses.replace(self, free=free)


@dataclass
class Fitted:
    """The best fit found, with its data. `scales`: of the angular velocity, of the attitude, of the specific force."""

    solution: Solution
    data: FlightData
    weight: np.ndarray  # (S,) 1 or 0
    scales: np.ndarray
    misfit: np.ndarray  # (S,) root mean square residual of each flight, in scales
    integration_error: float
    stages: list[str] = field(default_factory=list)


def substeps_for(recording: Recording, flights: Flights) -> int:
    """Runge–Kutta steps between two samples."""
    needed = max(1, int(np.ceil(turn_per_sample(recording, flights, 1.0) / _SUBSTEP_TURN)))
    return 1 if needed == 1 else rounded(needed)


def first_scales(recording: Recording, flights: Flights) -> np.ndarray:
    """Guesses (3,) of the noise of a sample's angular velocity, attitude and specific force."""
    return np.array([spin_noise(recording, flights), _FIRST_ATTITUDE_SCALE, _FIRST_FORCE_SCALE])


def search(problem: Problem, starts: list[np.ndarray]) -> Fitted:
    """Multiple shooting, then whole flights with noise scales and outliers.

    `starts` are shared unknowns (P,) to begin from, in the order in which they are tried.
    """
    scales = first_scales(problem.recording, problem.flights)
    best, stages = _best_of(problem, starts, scales)
    return refine(problem, best, scales, stages)


def refine(
    problem: Problem, near: Solution, scales: np.ndarray, stages: list[str], rounds: int = 8
) -> Fitted:
    """Whole flights from a solution nearby; noise scales and outliers follow the residuals until they settle."""
    shared, local, count = near.shared, near.local, len(problem.flights)
    weight = np.ones(count)
    for round_ in range(rounds):
        data = _on_device(problem.pack(scales)[0])
        problem.progress(f"whole flights, round {round_ + 1}: {int(weight.sum())} of {count}")
        solution = solve(problem, shared, local, data, weight)
        shared, local = solution.shared, solution.local
        squares, error = _squares(problem.residual, shared, local, data)
        misfit, new_scales, new_weight = _reweigh(problem, data, np.asarray(squares), scales)
        settled = np.all(np.abs(np.log(new_scales / scales)) < 0.01) and np.array_equal(weight, new_weight)
        stages.append(_account("whole flights", count, solution))
        if settled or round_ == rounds - 1:
            break
        scales, weight = new_scales, new_weight
    return Fitted(solution, data, weight, scales, misfit, float(error), stages)


def solve(
    problem: Problem, shared, local, data: FlightData, weight, max_iterations: int | None = None
) -> Solution:
    """The compiled solver on whole flights."""
    return levenberg_marquardt(
        problem.residual, jnp.asarray(shared), jnp.asarray(local), data,
        weight=jnp.asarray(weight), free=jnp.asarray(problem.free), huber=jnp.asarray(problem.huber),
        prior=problem.prior, tolerance=jnp.asarray(1e-8),
        max_iterations=jnp.asarray(problem.max_iterations if max_iterations is None else max_iterations),
    )  # fmt: skip


def _on_device(data: FlightData) -> FlightData:
    return jax.tree.map(jnp.asarray, data)


def window_intervals(recording: Recording, flights: Flights) -> int:
    """Intervals in a window."""
    per_sample = max(turn_per_sample(recording, flights), 1e-12)
    longest = max(map(len, flights.flights))
    return rounded(max(_SHORTEST_WINDOW, int(np.ceil(min(_WINDOW_TURN / per_sample, longest)))))


def _best_of(problem: Problem, starts: list[np.ndarray], scales: np.ndarray) -> tuple[Solution, list[str]]:
    """The lowest end of the starts. When two have ended at the same cost, the others are not tried."""
    count = window_intervals(problem.recording, problem.flights)
    chain, joined = problem.pack(scales, count)
    nodes = np.zeros((*joined.shape, problem.residual.local_size))
    nodes[..., :3] = chain.angular_velocity[:, :, 0]
    whole, centred = _on_device(problem.pack(scales)[0]), np.zeros(problem.residual.shared_size)
    centred[:RATIO_COORDINATES] = 1.0
    chain, weight = _on_device(chain), np.ones(len(nodes))
    plan = schedule(chain.angular_velocity, chain.scales[..., 0], chain.present)
    best, agreed, stages = None, False, []
    for number, shared in enumerate(starts):
        said = f"{joined.size} windows of {count} intervals, start {number + 1}"
        problem.progress(said)
        near = tighten(
            problem.residual, jnp.asarray(shared), jnp.asarray(nodes), chain, jnp.asarray(joined),
            weight=jnp.asarray(weight), free=jnp.asarray(problem.free), stages=plan, centred=jnp.asarray(centred),
            huber=jnp.asarray(problem.huber), prior=problem.prior,
        )  # fmt: skip
        there = solve(problem, near.shared, near.nodes[:, :1], whole, weight)
        stages.append(
            f"{joined.size} windows of {count} intervals, start {number + 1}: {int(near.iterations)} iterations"
        )
        cost = float(there.cost)
        if best is not None:
            agreed = abs(cost - float(best.cost)) <= 1e-3 * min(cost, float(best.cost))
        if best is None or cost < float(best.cost):
            best = there
        if agreed:
            break
    assert best is not None
    return best, stages


@jit
def _squares(residual: TrajectoryResidual, shared, local, data):
    """Sums of squares (channels, S) in scales, and the largest integration error in scales.

    The error is seen by halving the Runge–Kutta steps, which leaves a sixteenth of it.
    """
    finer = dataclasses.replace(residual, substeps=2 * residual.substeps)

    def channels(which):
        return jax.vmap(jax.vmap(lambda phi, d: jnp.stack(which.channels(shared, phi, d))))(local, data)

    coarse = channels(residual)
    error = jnp.max(jnp.abs(coarse - channels(finer)))
    return jnp.sum(coarse**2, axis=(1, 3, 4)).T, error


def _reweigh(problem: Problem, data: FlightData, squares: np.ndarray, scales: np.ndarray):
    """Misfit of each flight, noise scales by maximum likelihood, and which flights to keep."""
    residual = problem.residual
    samples = 3.0 * np.asarray(data.present).sum(axis=(1, 2))
    misfit = np.sqrt(np.mean(squares / samples, axis=0))
    keep = np.ones(len(misfit))
    if len(misfit) >= _ENOUGH_TO_JUDGE:
        # Each channel against its own usual misfit: the scales themselves may be inflated by the outliers.
        each = np.sqrt(squares / samples)
        usual = np.median(each, axis=1, keepdims=True)
        keep = (np.max(each / np.where(usual > 0, usual, 1.0), axis=0) <= _OUTLIER).astype(float)
    used = keep > 0
    unknowns = used.sum() * residual.local_size + problem.free.sum()
    total = samples[used].sum() * len(squares)
    inflate = total / max(total - unknowns, 1.0)
    new = scales.copy()
    for place, square in zip(residual.channels_used, squares):
        variance = square[used].sum() / samples[used].sum() * inflate
        size = max(float(np.sqrt(np.mean(problem.spin**2))), 1e-9) if place == 0 else 1.0
        new[place] = max(scales[place] * float(np.sqrt(variance)), 1e-10 * size)
    return misfit, new, keep


def _account(name: str, count: int, solution: Solution) -> str:
    return f"{name} ({count}): {int(solution.iterations)} iterations, {MEANING[int(solution.status)]}"
