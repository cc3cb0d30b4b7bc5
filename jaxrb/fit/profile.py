"""How the sum of squares rises when the inertia ratios are held elsewhere, everything else free. Host side."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from jaxrb.fit.problem import Solution
from jaxrb.fit.residuals import RATIO_COORDINATES
from jaxrb.fit.stages import Fitted, Problem, solve


def profile_rises(
    problem: Problem, fitted: Fitted, solution: Solution, moves: np.ndarray, deviations: np.ndarray
) -> list[tuple[float, float]]:
    """How much the cost of `solution` rises far out along each direction, and how much was foretold.

    Noise can pose as information: a wobble fitted to it has a frequency that seems sharp. Twenty deviations
    away a real signal is missed by far, while noise is fitted about as well as before. The mean of both ways counts:
    a solution that is held some deviations beside the optimum rises little on the one side.
    """
    rises: list[tuple[float, float]] = []
    for move, deviation in zip(moves, deviations):
        if not np.isfinite(deviation):
            rises.append((0.0, np.inf))
            continue
        length = min(20.0 * deviation, 2.0 / max(float(np.abs(move).max()), 1e-300))
        step = np.zeros(problem.residual.shared_size)
        step[:RATIO_COORDINATES] = length * move
        costs = [
            float(
                held(
                    problem, fitted, np.asarray(problem.residual.move(solution.shared, jnp.asarray(way)))
                ).cost
            )
            for way in (step, -step)
        ]
        rises.append((float(np.mean(costs)) - float(solution.cost), 0.5 * (length / deviation) ** 2))
    return rises


def held(problem: Problem, fitted: Fitted, shared: np.ndarray) -> Solution:
    """The fit with the inertia ratios held at `shared`, everything else free."""
    free = problem.free.copy()
    free[:RATIO_COORDINATES] = 0.0
    problem = dataclasses.replace(problem, free=free)
    return solve(problem, shared, fitted.solution.local, fitted.data, fitted.weight, 40)
