"""The contact solve of one world: cheap rounds first, and Newton's method where these do not get there.

Neither alone holds everywhere. A projected gradient needs thousands of rounds where a load goes through many bodies;
Newton's method creeps from kink to kink where many points open, close and slide at once. Each takes over what the other
does badly, and where the start is right one round says so. (Figures: `docs/contact.md`.)
"""

import jax.numpy as jnp

from jaxrb.contact.accelerated import projected_gradient
from jaxrb.contact.newton import newton, newton_tolerance
from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import POOR, Solution, passive_share, speed_to_take
from jaxrb.math.arrays import Vector

_GOOD = 0.1 * POOR


def solve_contacts(problem: Problem, start: Vector) -> Solution:
    """The motion and impulses of one world, from impulses (k, s, 3) that may be near."""
    taken = speed_to_take(problem, problem.free)
    asked = problem.tolerance * taken
    enough = newton_tolerance(problem, asked)
    # Where the free motion breaks no law there is nothing to solve, and no impulse.
    impulse = jnp.where(problem.contacts.active[..., None] & (taken > 0), start, 0.0)
    near, error, rounds, done = projected_gradient(problem, impulse, taken, asked)
    unknown = jnp.where(done, 0.0, jnp.inf)
    impulse, residual, steps, products = newton(problem, near, taken, enough, unknown)
    # In float32 Newton's equations may be worse than where the rounds ended. But what these leave pushes a whole stack
    # one way, and what Newton leaves is noise: of twenty boxes the upper ones stray 15 times as far by the former.
    kept = done | (error <= jnp.minimum(residual, _GOOD * taken))
    impulse, residual = jnp.where(kept, near, impulse), jnp.where(kept, error, residual)
    poor = residual > jnp.maximum(POOR * taken, enough)
    impulse = jnp.where(poor, passive_share(problem, impulse), 1.0) * impulse
    # By the impulses themselves, so that momentum is kept to round-off whatever the tolerance.
    return Solution(problem.moved_by(impulse), impulse, residual, poor, steps, rounds + products)
