"""The contact solve: a proximal Newton method on the motion of the bodies.

A compliance R is laid in series with the hard law (R is a small share of what the point itself gives way), and the
method of multipliers takes it out again: each round solves for the motion u with λ(u) = P(λ_k − (J u − b)/R), the disc
of friction held at μ λ_k, which is the gradient of a convex function, by Newton's method; then λ_k ← λ(u). At the fixed
point u and λ fulfil the hard law of Coulomb whatever R is, and a warm start that was right is left as it is. Newton's
equations are solved by conjugate gradients preconditioned by each body's own 6×6 block.
(Rockafellar 1976 for the multipliers; Castro, Permenter, Han 2022, "An unconstrained convex formulation of compliant
contact", for Newton on the primal; Acary and Brogliato 2008, chapter 13, for friction with a lagged bound.)
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxrb.contact.law import Bounds, curvature
from jaxrb.contact.linear import conjugate_gradients, inverted, multiplied
from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import speed_to_take
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide
from jaxrb.math.settled import settled


def compliance(dtype: Any) -> float:
    """R over the effective inverse mass of a point.

    A stack of ten, from a cold start to 1e-9: 1e-3 takes more than 2000 products, 1e-4 1240, 1e-5 860, 1e-6 1010. In
    float32 firmer than 2e-3 makes impulses of the round-off of velocities, and 1e-2 takes three times the rounds.
    """
    return 1e-5 if jnp.finfo(dtype).bits == 64 else 2e-3


# The most steps of Newton, and products of the matrix in each. Of a row of falling dominoes 60 steps leave one step in
# eight poor, 200 one in 500, for 2 % more time.
_NEWTON_STEPS, _PRODUCTS = 200, 100
_ROUGH, _EXACT = 1e-2, 1e-6  # relative errors of Newton's direction
_SOFT = 1e-2  # compliance where the start is far from the answer


def newton(
    problem: Problem, start: Vector, taken: Scalar, tolerance: Scalar, unknown: Scalar
) -> tuple[Vector, Scalar, Array, Array]:
    """Impulses (k, s, 3) from a start that may be near, how far from the law they are [m/s], the number of steps and of
    products with the matrix.

    `taken` [m/s] is the velocity that contact has to take, `tolerance` [m/s] that of `newton_tolerance`; `unknown` the
    error of the start, 0 where it is good enough.
    """
    c = problem.contacts
    firm = compliance(problem.free.dtype)
    unit = problem.stiffness(1.0)
    motion = problem.moved_by(start)
    velocity = c.relative_velocity(motion)
    # Far from the answer a soft law finds sooner who presses whom: its equations are better conditioned.
    far = speed_to_take(problem, motion) > 0.1 * taken
    softness = jnp.where(far, _SOFT, firm).astype(motion.dtype)

    def going(carry: Any) -> Any:
        return (carry[0] < _NEWTON_STEPS) & (carry[-3] > tolerance)

    def step(carry: Any) -> Any:
        count, motion, velocity, held, whole, softness, *_, products = carry
        stiffness = unit / softness
        given = _Given(problem, unit, stiffness, motion, velocity)
        first = count == 0
        held, gap, wanted, impulse, change, off, follows = given.with_multipliers(held, tolerance, first)
        broken = given.broken(held)
        # What is found here is better than the law asks by 1/R, for nothing: it goes on until a round changes
        # nothing, so that the next step can begin with it.
        residual = jnp.maximum(jnp.maximum(change, off), jnp.where(follows, 0.0, 2 * tolerance))
        left = jnp.where(first, broken, jnp.maximum(broken, off))
        bounds = problem.bounds(held)
        bend = settled(curvature(wanted, c.normal[:, None], bounds, stiffness))
        # While points still open and close, a rough direction is as good as any; then one exact solve ends it.
        rough = jnp.where(whole, jnp.clip(0.1 * tolerance / problem.felt(gap), _EXACT, _ROUGH), _ROUGH)
        right = jnp.where(residual > tolerance, -gap, 0.0)
        direction, used = _newton_direction(problem, bend, right, rough)
        rate = c.relative_velocity(direction)
        length = given.line_search(held, bounds, impulse, gap, direction, rate)
        motion, velocity = motion + length * direction, velocity + length * rate
        # A round made with this compliance is done; the next may be firmer. (The law above must not change within it.)
        softness = jnp.where(follows, jnp.maximum(firm, 0.1 * softness), softness)
        return count + 1, motion, velocity, held, length >= 1, softness, residual, left, products + used

    none = jnp.zeros((), jnp.int32)
    unknown = unknown.astype(motion.dtype)
    carry = (none, motion, velocity, start, jnp.ones((), bool), softness, unknown, unknown, none)
    count, _, _, held, _, _, _, residual, products = lax.while_loop(going, step, carry)
    return held, residual, count, products


def newton_tolerance(problem: Problem, asked: Scalar) -> Scalar:
    """What is asked for, or can be told [m/s]: round-off of a velocity is an impulse by 1/R."""
    dtype = problem.free.dtype
    known = 4 * jnp.finfo(dtype).eps * jnp.max(jnp.abs(problem.free), initial=0.0)
    return jnp.maximum(asked, known / compliance(dtype))


class _Given(NamedTuple):
    """Where a Newton step starts."""

    problem: Problem
    unit: Scalar
    stiffness: Scalar
    motion: Array
    velocity: Vector

    def with_multipliers(
        self, held: Vector, tolerance: Scalar, first: Array
    ) -> tuple[Vector, Array, Vector, Vector, Scalar, Scalar, Array]:
        """The multipliers, which follow once the motion is right for those held; what the motion is then not explained
        by, M (u − free) − Jᵀ λ (n, 6); the impulses before and after projection; by how much the impulses changed, and
        how much was unexplained, as bodies feel it [m/s]; and whether they followed.

        At `first` the motion is that of the multipliers held, and these are the answer if they fulfil the law.
        """
        problem = self.problem

        def look(round_: Any, carry: Any) -> Any:
            held, _, wanted, impulse, *before, followed = carry
            wanted = problem.wanted(held, self.velocity, self.stiffness)
            impulse = problem.projected(wanted, problem.bounds(held))
            gap = problem.momentum(self.motion - problem.free) - problem.contacts.impulse_on_bodies(impulse)
            gap = problem.borne(gap)  # of what is held, or joints bear, only round-off would be seen below
            # As velocities of the points: impulses that share a load in another way move nothing.
            change = problem.felt(problem.contacts.impulse_on_bodies(impulse - held))
            off = problem.felt(gap)
            # At first the gap is the change itself, and they follow only a motion that they did not make.
            follow = (round_ == 0) & ~first & (off <= jnp.maximum(tolerance, 0.1 * change))
            return (
                jnp.where(follow, impulse, held), gap, wanted, impulse,
                jnp.where(round_ == 0, change, before[0]), jnp.where(round_ == 0, off, before[1]), followed | follow,
            )  # fmt: skip

        none = jnp.zeros_like(tolerance)
        start = (held, self.motion, held, held, none, none, jnp.zeros((), bool))
        # A loop of two rounds, so that the law stands in the program once: compile time is waiting time.
        return lax.fori_loop(0, 2, look, start)

    def broken(self, impulse: Vector) -> Scalar:
        """By how much impulses and the velocity break the law at any point [m/s]; no compliance is in it.

        Measured by the change of the impulses in a round instead, a velocity off by 1e-11 would count 1/R as much: a
        stack at rest then never begins with its answer. As what the bodies feel of that change, a light body between
        a heavy one and the floor would feel nothing, pushed from both sides, while all three overlap.
        """
        problem = self.problem
        lawful = problem.projected(problem.wanted(impulse, self.velocity, self.unit), problem.bounds(impulse))
        return jnp.max(divide(jnp.abs(lawful - impulse), self.unit[..., None]), initial=0.0)

    def line_search(
        self, held: Vector, bounds: Bounds, impulse: Vector, gap: Array, direction: Array, rate: Vector
    ) -> Scalar:
        """Where the function's slope along the direction vanishes, in (0, 1]; the whole step unless it goes too far."""
        problem = self.problem
        slope0 = jnp.sum(direction * gap)
        inertial = jnp.sum(direction * problem.momentum(direction))
        zero = jnp.zeros((), rate.dtype)

        def going(carry: Any) -> Any:
            k, *_, value = carry
            # The whole step comes first; a slope that still falls there ends the search.
            return (k < 20) & (jnp.where(k == 1, value, jnp.abs(value)) > -0.1 * slope0)

        def closer(carry: Any) -> Any:
            k, low, at_low, high, at_high, _, _ = carry
            # The secant, kept away from the ends so that each round takes a tenth of the interval at least.
            share = jnp.clip(at_low / (at_low - at_high), 0.1, 0.9)
            middle = jnp.where(k == 0, 1.0, low + share * (high - low))
            wanted = problem.wanted(held, self.velocity + middle * rate, self.stiffness)
            pushed = problem.projected(wanted, bounds) - impulse
            value = slope0 + middle * inertial - jnp.sum(rate * pushed)
            left = (value < 0) & (k > 0)
            right = ~left
            return (
                k + 1,
                jnp.where(left, middle, low), jnp.where(left, value, at_low),
                jnp.where(right, middle, high), jnp.where(right, value, at_high),
                middle, value,
            )  # fmt: skip

        carry = (jnp.zeros((), jnp.int32), zero, slope0, 1 + zero, -slope0, 1 + zero, zero + jnp.inf)
        return lax.while_loop(going, closer, carry)[-2]


def _newton_direction(problem: Problem, bend: Array, right: Array, tolerance: Scalar) -> tuple[Array, Array]:
    """(M + Jᵀ G J)⁻¹ right, with G (k, s, 3, 3); and how many products of the matrix it took."""
    c = problem.contacts

    def apply(direction: Array) -> Array:
        pull = jnp.sum(bend * c.relative_velocity(direction)[:, :, None, :], axis=-1)
        return problem.momentum(direction) + problem.on_bodies(pull)

    inverse = inverted(problem.blocks(bend))
    if problem.joints is not None:
        # Among motions that open no joint: these are kept by the blocks, once a residual is rid of the joints' part.
        joints = problem.joints.against(inverse)
        right = joints.borne(right)
        free = apply
        apply = lambda direction: joints.borne(free(direction))  # noqa: E731
    if c.lever_back is None:
        # Bodies that touch only what stands still do not know of each other.
        return multiplied(inverse, right), jnp.zeros((), jnp.int32)
    return conjugate_gradients(
        apply, lambda r: multiplied(inverse, r), right, tolerance=tolerance, most=_PRODUCTS
    )
