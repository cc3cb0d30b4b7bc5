"""An accelerated projected gradient on the impulses: the rounds with which every solve of bodies that meet begins.

The impulses λ minimise ½ λᵀ N λ + λᵀ (J free − b), N = J M⁻¹ Jᵀ, within the cones, with the disc of friction held at
μ λₙ of the round itself: at the fixed point they fulfil the hard law of Coulomb. A round is one product with J and one
with Jᵀ. Each point steps by a bound of its own, since N ⪯ diag(cₐ Wₐ + c_b W_b), where W is what an impulse at the
point does to one of its bodies and c in how many points that body takes part (a body shared among its contacts: Tonge,
Benevolenski, Voroshilov 2012, "Mass splitting for jitter-free parallel rigid body simulation"). Momentum is
Nesterov's (Mazhar, Heyn, Negrut, Tasora 2015, "Using Nesterov's method to accelerate multibody dynamics with friction
and contact"), with no more of it than 0.9, and forgotten where the error grows: friction whose bound follows the normal
impulse is the gradient of no function, and on a heap of 1000 the whole momentum, restarted where it leads uphill
(O'Donoghue and Candès 2015), stays at 1e-1 where this is at 2e-2 after 400 rounds. Steps twice as long diverge.
"""

from typing import Any

import jax.numpy as jnp
from jax import lax

from jaxrb.contact.columns import columns_of
from jaxrb.contact.problem import Problem
from jaxrb.math.arrays import Array, Scalar, Vector

# Momentum (age − 1)/age at most; and by how much the error may grow before it is forgotten.
_OLDEST, _RISES = 10.0, 1.5
# Rounds end where so many have not brought the error down to this share. A step of Newton costs twenty rounds.
_ROUNDS, _LOOK, _FALLS = 1000, 50, 0.8
_BETTER = 0.01


def projected_gradient(
    problem: Problem,
    start: Vector,
    taken: Scalar,
    asked: Scalar,
    rounds: int = _ROUNDS,
    better: float = _BETTER,
) -> tuple[Vector, Scalar, Array, Array]:
    """Impulses (k, s, 3) from a start that may be near, how far from the law they are [m/s], the number of rounds, and
    whether that is as near as asked.

    `taken` [m/s] is the velocity that contact has to take, `asked` [m/s] the error that is good enough. A start that is
    good is kept; what is not is made better than was asked for, by the share `better`, so that the next step can begin
    with it.
    """
    points = columns_of(problem)
    begun = points.columns(start)
    # Round-off of an impulse is one of a velocity.
    smallest = jnp.minimum(4 * jnp.finfo(problem.free.dtype).eps, problem.tolerance)

    def good_enough(asked: Scalar, impulse: Any) -> Scalar:
        fastest = jnp.max(jnp.abs(problem.free), initial=0.0)
        return jnp.maximum(asked, smallest * jnp.maximum(fastest, points.felt(impulse)))

    kept, aim = good_enough(asked, begun), good_enough(better * asked, begun)

    def going(carry: Any) -> Any:
        count, *_, error, _, stuck = carry
        return (count < rounds) & (error > jnp.where(count <= 1, kept, aim)) & ~stuck

    def round_(carry: Any) -> Any:
        count, impulse, motion, ahead, seen, age, best, last, goal, _ = carry
        new, error = points.stepped(ahead, seen)
        new_motion = points.moved(new)
        older = jnp.where(error > _RISES * last, 1.0, age)
        age = jnp.minimum(0.5 * (1.0 + jnp.sqrt(1.0 + 4.0 * older * older)), _OLDEST)
        share = (older - 1.0) / age
        ahead = tuple(x + share * (x - y) for x, y in zip(new, impulse, strict=True))
        # The motion is affine in the impulses: no product for the point looked at next.
        seen = new_motion + share * (new_motion - motion)
        best = jnp.minimum(best, error)
        look = (count + 1) % _LOOK == 0
        stuck, goal = look & (best > goal), jnp.where(look | (count == 0), _FALLS * best, goal)
        return count + 1, new, new_motion, ahead, seen, age, best, error, goal, stuck

    motion = points.moved(begun)
    far = jnp.full((), jnp.inf, motion.dtype)
    unknown = jnp.where(taken > 0, far, 0.0)
    first = (begun, motion, begun, motion, jnp.ones_like(far), far, unknown, far, jnp.zeros((), bool))
    count, found, *_, error, _, _ = lax.while_loop(going, round_, (jnp.zeros((), jnp.int32), *first))
    # By what was found: a start much too large, as after a blow, knows less.
    return points.rows(found), error, count, error <= good_enough(asked, found)
