"""Multiple shooting: windows first, tied loosely and then ever more tightly, and whole flights at the end.

From a poor start, a long trajectory is lost after a few turns and its sum of squares is full of hollows: single
shooting reached the optimum from half of all starts, and on flipping bodies from none. Over a window of a radian or
two there is one hollow. So each flight is a chain of windows with unknowns of their own, and the squared gaps between
them get a weight that grows in stages; at the end each flight is simulated in one piece. One compiled program.

Source: Bock 1983 (multiple shooting for parameter estimation); the tightening is a penalty method (Nocedal and Wright
2006, section 17.1).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxrb.compilation import jit
from jaxrb.fit.least_squares import levenberg_marquardt
from jaxrb.fit.problem import Prior, Shooting, Solution
from jaxrb.math.arrays import Array, Scalar

# Weights of the squared gaps, in the inverse variance of one sample: from windows that hardly know of each other to
# chains that are trajectories but for a tenth of a sample's noise.
STAGES = (1e-2, 1.0, 1e2)
# Strengths of the pull towards a sphere meanwhile, in the sum of squares of what was measured. Without it two to four
# of a hundred starts ran off to a rod or a plate of no thickness, where the derivative vanishes; with it none of 400.
PULLS = (1e-3, 1e-5, 0.0)


def schedule(measured: Array, scale: Array, present: Array) -> tuple[Array, Array]:
    """Stages for measured values (..., K, 3) in scales (...,), compared where `present` (..., K) is 1."""
    squares = jnp.sum(jnp.square(measured / scale[..., None, None]) * present[..., None])
    return jnp.asarray(STAGES, squares.dtype), jnp.asarray(PULLS, squares.dtype) * squares


class Chained(NamedTuple):
    """Shared parameters and each window's own unknowns where the stages ended, and their iterations together."""

    shared: Array
    nodes: Array
    iterations: Scalar


@jit
def tighten(
    problem: Shooting,
    shared: Array,
    nodes: Array,
    data: Any,
    joined: Array,
    *,
    weight: Array,
    free: Array,
    stages: tuple[Array, Array],
    centred: Array,
    huber: float | Array = jnp.inf,
    prior: Prior | None = None,
    iterations: int | Array = 20,
    tolerance: float | Array = 1e-2,
) -> Chained:
    """Fit chains of windows whose gaps weigh more from stage to stage.

    Args:
        problem: simulates one window.
        shared: (P,) start. nodes: (S, W, Q) start of each window's own unknowns, such as what was measured there.
        data: of the windows, leading axes S, W. joined: (S, W) 1 where a window goes on into the next.
        weight, free, huber, prior: as of `levenberg_marquardt`.
        stages: from `schedule`: weights of the squared gaps, one after the other, and strengths of a pull of the
            shared parameters towards zero, which keeps a poor start from running off.
        centred: (P,) 1 for the shared parameters that are pulled.
        iterations, tolerance: of each stage; they need not converge.
    """
    believed = (
        Prior(jnp.zeros_like(shared), jnp.zeros((shared.size,) * 2, shared.dtype)) if prior is None else prior
    )

    def stage(carry, strengths):
        continuity, pull = strengths
        # Both pulls as one: their precisions add, and so do their pulls.
        precision = believed.precision + pull * jnp.diag(centred)
        idle = jnp.where(jnp.diagonal(precision) > 0, 0.0, 1.0)
        mean = jnp.linalg.solve(precision + jnp.diag(idle), believed.precision @ believed.mean)
        there = levenberg_marquardt(
            problem, carry.shared, carry.nodes, data, weight=weight, free=free, joined=joined, continuity=continuity,
            huber=huber, prior=Prior(mean, precision), max_iterations=iterations, tolerance=tolerance,
        )  # fmt: skip
        return Chained(there.shared, there.local, carry.iterations + there.iterations), None

    return jax.lax.scan(stage, Chained(shared, nodes, jnp.asarray(0)), stages)[0]


def multiple_shooting(
    problem: Shooting,
    shared: Array,
    nodes: Array,
    chain: tuple[Any, Array],
    whole: Any,
    *,
    stages: tuple[Array, Array],
    centred: Array,
    max_iterations: int | Array = 100,
    tolerance: float | Array = 1e-8,
    **shared_options: Any,
) -> tuple[Solution, Scalar]:
    """The least-squares fit of whole flights from a start that need not be near, and the iterations of all stages.

    `chain` is the windows' data and `joined`, `whole` the data of the flights in one piece (leading axes S, 1); the
    rest as of `tighten` and `levenberg_marquardt`. Pure: `jax.jit` and `jax.vmap` it over starts, draws or recordings.
    """
    near = tighten(problem, shared, nodes, *chain, stages=stages, centred=centred, **shared_options)
    solution = levenberg_marquardt(
        problem, near.shared, near.nodes[:, :1], whole, max_iterations=max_iterations, tolerance=tolerance,
        **shared_options,
    )  # fmt: skip
    return solution, near.iterations + solution.iterations
