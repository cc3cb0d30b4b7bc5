"""The passes of a fit: what is free flight, and what else is in the recording, found in turns. Host side, float64."""

import dataclasses

import numpy as np

from jaxrb.fit.packing import spin_noise
from jaxrb.fit.parametrise import coordinates_from_ratios
from jaxrb.fit.quality import correlation_time, not_free_ends, saturated, trimmed
from jaxrb.fit.segments import Flights
from jaxrb.fit.selection import Tried, choose, start_of
from jaxrb.fit.stages import Fitted, Problem, refine, search, solve
from jaxrb.fit.torque_free import torque_free
from jaxrb.fit.wishes import Wishes, problem_of
from jaxrb.io.recording import Recording

# Residuals this many times the scatter from sample to sample are more than noise; a tracker's smoothing alone
# makes it 3.
MISFIT = 6.0
DOUBTFUL = 1.5  # where it goes with a refusal: what is not in the model may be why
_BETTER = 0.7  # of the misfit, where flights found by the motion are taken in place of those declared
_TRIMS = 2  # rounds in which the ends of flights are trimmed


def free_flights_fitted(
    recording: Recording,
    flights: Flights,
    wishes: Wishes,
    start: np.ndarray | None,
    progress,
    minimum_samples: int,
) -> tuple[Problem, Fitted, list[Tried], float]:
    """The fit on what turns out to be free flight, the nuisances that were tried, and the residuals' correlation."""
    masked = saturated(recording)

    def fit(flights: Flights) -> tuple[Problem, Fitted]:
        problem = problem_of(recording, flights, wishes, progress, masked)
        return _with_nuisances(problem, wishes, _starts(problem, start))

    problem, fitted = fit(flights)
    # Where the caller chose the nuisances, a drag that was forgotten must show, and not be trimmed away.
    doubt = DOUBTFUL if wishes.among else MISFIT
    if flights.cut_by == "declared" and misfit_of(problem, fitted) > doubt:
        progress("looking for stretches without torque")
        found = torque_free(recording, minimum_samples)
        if found is not None:
            other, there = fit(found)
            if misfit_of(other, there) < _BETTER * misfit_of(problem, fitted):
                problem, fitted = other, there
    # Flights cut by positions have lost their ends already; a further 3 samples of 12 brought nothing on real cubes.
    for _ in range(_TRIMS if wishes.among and problem.flights.cut_by != "position" else 0):
        ends = not_free_ends(problem, fitted)
        shorter = trimmed(problem.flights, ends, minimum_samples)
        if not any(ends) or not len(shorter):
            break
        problem = dataclasses.replace(problem, flights=shorter)
        fitted = search(problem, [np.asarray(fitted.solution.shared)])
    if masked.any():
        problem.flights.rejected["samples at full scale"] = int(masked.sum())
    correlation = correlation_time(problem, fitted)
    tried: list[Tried] = []
    if wishes.among:
        without = problem.with_free(wishes.always)
        base = refine(without, solve(without, fitted.solution.shared * without.free, fitted.solution.local,
                                     fitted.data, fitted.weight), fitted.scales, [])  # fmt: skip
        tried = choose(without, base, wishes.always, wishes.among, correlation)[2]
    return problem, fitted, tried, correlation


def _with_nuisances(problem: Problem, wishes: Wishes, starts: list[np.ndarray]) -> tuple[Problem, Fitted]:
    """All nuisances in question at once: as far as the data leave them open, beliefs hold them.

    Adding only those that a criterion asks for gave the same errors, and error bars up to nine times too small: the
    bias that it left at zero was as uncertain as before. And a search without drag first lost two of six flipping
    rackets, whose tracks drag bends by more than a sphere is off.
    """
    if not wishes.among:
        return problem, search(problem, starts)
    everything = problem.with_free((*wishes.always, *wishes.among))
    there = search(everything, starts)
    if misfit_of(everything, there) > DOUBTFUL:
        plain = search(problem, starts)
        other = refine(everything, plain.solution, plain.scales, plain.stages)
        there = other if other.scales[0] < there.scales[0] else there
    return everything, there


def _starts(problem: Problem, start: np.ndarray | None) -> list[np.ndarray]:
    """Coordinates to begin from: the caller's, a sphere, and three discs."""
    # A disc's moments obey A + B = C; this one has a little thickness.
    discs = [np.eye(3) + 0.9 * np.diag(row) for row in np.eye(3)]
    inertias = [*([] if start is None else [np.asarray(start, float)]), np.eye(3), *discs]
    return [start_of(problem, np.asarray(coordinates_from_ratios(i))) for i in inertias]


def misfit_of(problem: Problem, fitted: Fitted) -> float:
    """Residuals of the angular velocity over what they scatter by from one sample to the next."""
    if not problem.residual.use_spin:
        return 0.0
    return float(fitted.scales[0] / spin_noise(problem.recording, problem.flights))
