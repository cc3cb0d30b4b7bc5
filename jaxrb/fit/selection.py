"""Which nuisances a recording needs: likelihood ratios, weighed by the Bayesian information criterion.

Source: Schwarz 1978. The noise is unknown too, so the ratio is N log(S₀/S₁) of the sums of squares.
"""

from typing import NamedTuple

import numpy as np

from jaxrb.fit.residuals import UNKNOWNS
from jaxrb.fit.stages import Fitted, Problem, refine, solve


class Tried(NamedTuple):
    """A nuisance that was tried: twice the gain of the log-likelihood, what chance alone may give, and the verdict."""

    name: str
    likelihood_ratio: float
    threshold: float
    needed: bool


def candidates(spin: bool, attitude: bool, position: bool = False) -> tuple[str, ...]:
    """Nuisances that such a recording could tell apart."""
    drag = ("linear_drag", "quadratic_drag")
    gyroscope = ("gyro_bias", "gyro_scale") if spin else ()
    metre = ("metric_scale",) if position else ()
    return (*drag, *gyroscope, *(("tilt", "delay") if spin and attitude else ()), *metre)


def choose(
    problem: Problem,
    fitted: Fitted,
    always: tuple[str, ...],
    among: tuple[str, ...],
    correlation: float = 1.0,
) -> tuple[Problem, Fitted, list[Tried]]:
    """Add the nuisance that gains most until none gains more than its threshold; each by one fit from the last.

    `correlation`: samples that tell as much as one would if noise were white; so many fewer are counted.
    """
    chosen, tried = always, {}
    kept = np.asarray(fitted.data.present) * (fitted.weight > 0)[:, None, None]
    count = 3.0 * kept.sum() * len(problem.residual.channels_used) / correlation
    while True:
        base, gains = max(float(fitted.solution.cost), 1e-300), {}
        for name in (name for name in among if name not in chosen):
            problem.progress(f"is there {name}?")
            there = solve(
                problem.with_free((*chosen, name)), fitted.solution.shared, fitted.solution.local, fitted.data,
                fitted.weight,
            )  # fmt: skip
            ratio = float(count * np.log(base / max(min(float(there.cost), base), 1e-300)))
            threshold = UNKNOWNS[name][0] * float(np.log(count))
            gains[name] = (ratio - threshold, there)
            tried[name] = Tried(name, ratio, threshold, bool(ratio > threshold))
        best = max(gains, key=lambda name: gains[name][0], default=None)
        if best is None or gains[best][0] <= 0:
            return problem.with_free(chosen), fitted, list(tried.values())
        chosen = (*chosen, best)
        problem = problem.with_free(chosen)
        fitted = refine(problem, gains[best][1], fitted.scales, fitted.stages)


def start_of(problem: Problem, ratios: np.ndarray) -> np.ndarray:
    """Shared unknowns (P,) from coordinates (5,), the others at zero."""
    return np.concatenate([ratios, np.zeros(problem.residual.shared_size - len(ratios))])


def values(
    problem: Problem, fitted: Fitted, covariance: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Value and standard error of each unknown that was fitted beside the ratios, by name."""
    residual, shared = problem.residual, np.asarray(fitted.solution.shared)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found = {}
    for name in residual.unknowns:
        place = residual.place(name)
        if np.all(problem.free[place] > 0):
            found[name] = (shared[place].copy(), deviation[place].copy())
    return found
