"""The contact solve of crowds: the accelerated projected gradient alone, at linear cost and memory."""

import jax.numpy as jnp

from jaxrb.contact.accelerated import projected_gradient
from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import POOR, Solution, passive_share, speed_to_take
from jaxrb.math.arrays import Vector

# A heap that has settled takes 10 to 15 from the impulses of the step before; one that falls together would take
# hundreds. With 20, 30, 40 a thousand balls overlap by 1.7, 1.7, 1.3 mm of 100 at most.
_ROUNDS = 30


def solve_sparse(problem: Problem, start: Vector) -> Solution:
    """The motion and impulses of one world, from impulses (k, s, 3) that may be near.

    A `Solution` as `solve_contacts` gives it; `newton_steps` is 0, `products` the number of rounds.
    """
    taken = speed_to_take(problem, problem.free)
    begun = jnp.where(problem.contacts.active[..., None] & (taken > 0), start, 0.0)
    # Round-off of a velocity: nothing below that can be told.
    known = 4 * jnp.finfo(problem.free.dtype).eps * jnp.max(jnp.abs(problem.free), initial=0.0)
    asked = jnp.maximum(problem.tolerance * taken, known)
    found, residual, count, _ = projected_gradient(problem, begun, taken, asked, _ROUNDS, better=1.0)
    poor = residual > jnp.maximum(POOR * taken, asked)
    found = jnp.where(poor, passive_share(problem, found), 1.0) * found
    none = jnp.zeros((), jnp.int32)
    return Solution(problem.moved_by(found), found, residual, poor, none, count)
