"""The contact solve of crowds: an accelerated projected gradient on the impulses, at linear cost and memory.

The impulses λ minimise ½ λᵀ N λ + λᵀ (J free − b), N = J M⁻¹ Jᵀ, within the cones, with the disc of friction held at
μ λₙ of the round itself: at the fixed point they fulfil the hard law of Coulomb. A round is one product with J and one
with Jᵀ. Each point steps by a bound of its own, since N ⪯ diag(cₐ Wₐ + c_b W_b), where W is what an impulse at the
point does to one of its bodies and c in how many points that body takes part (a body shared among its contacts: Tonge,
Benevolenski, Voroshilov 2012, "Mass splitting for jitter-free parallel rigid body simulation"). Momentum is
Nesterov's (Mazhar, Heyn, Negrut, Tasora 2015, "Using Nesterov's method to accelerate multibody dynamics with friction
and contact"), with no more of it than 0.9, and forgotten where the error grows: friction whose bound follows the normal
impulse is the gradient of no function, and on a heap of 1000 the whole momentum, restarted where it leads uphill
(O'Donoghue and Candès 2015), stays at 1e-1 where this is at 2e-2 after 400 rounds. Steps twice as long diverge.

Arithmetic runs over columns, one long axis of points, and bodies are looked up by columns too: as rows of three a round
takes four times as long. XLA's scatter on CPU is not slow in one long axis: 4 ns a row; lists of a body's points, to be
gathered instead, take four times that.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxrb.body.inertia import symmetric_of
from jaxrb.contact.law import within
from jaxrb.contact.problem import Problem
from jaxrb.contact.solver import POOR, Solution, passive_share, speed_to_take
from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.safe import divide, safe_sqrt
from jaxrb.math.vector import cross_of, dot_of

# A heap that has settled takes 10 to 15 from the impulses of the step before; one that
# falls together would take hundreds. With 20, 30, 40 a thousand balls overlap by 1.7, 1.7, 1.3 mm of 100 at most.
_ROUNDS = 30
# Momentum (age − 1)/age at most; and by how much the error may grow before it is forgotten.
_OLDEST, _RISES = 10.0, 1.5


def solve_sparse(problem: Problem, start: Vector) -> Solution:
    """The motion and impulses of one world, from impulses (k, s, 3) that may be near.

    A `Solution` as `solve_contacts` gives it; `newton_steps` is 0, `products` the number of rounds.
    """
    points = _points_of(problem)
    taken = speed_to_take(problem, problem.free)
    begun = jnp.where(problem.contacts.active[..., None] & (taken > 0), start, 0.0)
    impulse = tuple(components(begun.reshape(-1, 3)))
    free, masses = components(problem.free), _masses(problem)

    def moved(impulse: Any) -> Array:
        given = points.on_bodies(impulse)
        return _columns([f + r for f, r in zip(free, _response(masses, given), strict=True)])

    # Round-off of a velocity: nothing below that can be told.
    known = 4 * jnp.finfo(problem.free.dtype).eps * jnp.max(jnp.abs(problem.free), initial=0.0)
    tolerance = jnp.maximum(problem.tolerance * taken, known)

    def going(carry: Any) -> Any:
        return (carry[0] < _ROUNDS) & (carry[-1] > tolerance)

    def round_(carry: Any) -> Any:
        k, impulse, motion, ahead, seen, age, last = carry
        new, residual = points.stepped(ahead, seen)
        new_motion = moved(new)
        older = jnp.where(residual > _RISES * last, 1.0, age)
        age = jnp.minimum(0.5 * (1.0 + jnp.sqrt(1.0 + 4.0 * older * older)), _OLDEST)
        share = (older - 1.0) / age
        ahead = tuple(x + share * (x - y) for x, y in zip(new, impulse, strict=True))
        # The motion is affine in the impulses: no product for the point looked at next.
        seen = new_motion + share * (new_motion - motion)
        return k + 1, new, new_motion, ahead, seen, age, residual

    motion = moved(impulse)
    unknown = jnp.where(taken > 0, jnp.inf, 0.0).astype(motion.dtype)
    carry = (jnp.zeros((), jnp.int32), impulse, motion, impulse, motion, jnp.ones_like(unknown), unknown)
    count, impulse, *_, residual = lax.while_loop(going, round_, carry)
    poor = residual > jnp.maximum(POOR * taken, tolerance)
    found = stack(*impulse).reshape(start.shape)
    found = jnp.where(poor, passive_share(problem, found), 1.0) * found
    none = jnp.zeros((), jnp.int32)
    return Solution(problem.moved_by(found), found, residual, poor, none, count)


class _Points(NamedTuple):
    """Points (m,) in columns: bodies pushed and pushed back (`count` is nobody), their levers, the normal and bound.

    `along`, `across` [kg]: 1 over the bound of N along the normal and across it, 0 where there is no contact.
    """

    count: int
    pushed: Array
    back: Array | None
    lever: Any
    lever_back: Any
    normal: Any
    bias: Scalar
    friction: Scalar | None
    along: Scalar
    across: Scalar

    def velocity(self, motion: Array) -> Any:
        """Of the pushed body against the other at each point, of motions (6, n)."""
        own = _at(motion, self.pushed, self.lever)
        if self.back is None:
            return own
        # Nobody stands still.
        padded = jnp.pad(motion, ((0, 0), (0, 1)))
        other = _at(padded, self.back, self.lever_back)
        return tuple(a - b for a, b in zip(own, other, strict=True))

    def on_bodies(self, impulse: Any) -> Any:
        """Impulse and angular impulse on each body, six columns (n,)."""
        total = jnp.zeros((6, self.count), impulse[0].dtype)
        total = total.at[:, self.pushed].add(_wrench(impulse, self.lever), mode="drop")
        if self.back is not None:
            total = total.at[:, self.back].add(-_wrench(impulse, self.lever_back), mode="drop")
        return components(total.T)

    def stepped(self, impulse: Any, motion: Array) -> tuple[Any, Scalar]:
        """The impulses after a projected step from where bodies move with `motion`; how far from the law those were."""
        velocity, normal = self.velocity(motion), self.normal
        missing = dot_of(velocity, normal) - self.bias
        held, closing = dot_of(impulse, normal), missing + self.bias
        pressing = jnp.maximum(held - self.along * missing, 0.0)
        side = [
            y - held * n - self.across * (v - closing * n)
            for y, n, v in zip(impulse, normal, velocity, strict=True)
        ]
        if self.friction is None:
            new = tuple(pressing * n for n in normal)
        else:
            length, most = safe_sqrt(dot_of(side, side)), self.friction * pressing
            cut = within(length, most)
            new = tuple(pressing * n + cut * t for n, t in zip(normal, side, strict=True))
        change = tuple(x - y for x, y in zip(new, impulse, strict=True))
        normally = dot_of(change, normal)
        sideways = safe_sqrt(dot_of(change, change) - normally * normally)
        off = jnp.maximum(divide(jnp.abs(normally), self.along), divide(sideways, self.across))
        return new, jnp.max(off, initial=0.0)


def _points_of(problem: Problem) -> _Points:
    c = problem.contacts
    incidence, slots = c.incidence, c.active.shape[1]

    def each(blocks: Array) -> Array:
        return jnp.repeat(blocks, slots, axis=0) if slots > 1 else blocks

    lone = jnp.asarray(incidence.lone, jnp.int32)
    pushed = each(jnp.concatenate([lone, incidence.second]))
    back, lever_back = None, None
    if c.lever_back is not None:
        back = each(jnp.concatenate([jnp.full_like(lone, incidence.count), incidence.first]))
        lever_back = components(jnp.pad(c.lever_back.reshape(-1, 3), ((slots * len(lone), 0), (0, 0))))
    lever = components(c.lever.reshape(-1, 3))
    normal = components(each(c.normal))
    active = c.active.ravel()
    along, across = _bounds(problem, active, pushed, back, lever, lever_back, normal)
    friction = None if c.friction is None else each(c.friction)
    bias = jnp.where(active, problem.bias.ravel(), 0.0)
    return _Points(incidence.count, pushed, back, lever, lever_back, normal, bias, friction, along, across)


def _bounds(
    problem: Problem, active: Array, pushed: Array, back: Any, lever: Any, lever_back: Any, normal: Any
) -> tuple[Scalar, Scalar]:
    """1 over the bounds of N at each point along its normal and across: by Gershgorin's rows of the 3×3 parts."""
    first = _tangent(normal)
    frame = (normal, first, cross_of(normal, first))
    count, here = problem.contacts.incidence.count, active.astype(normal[0].dtype)
    shared = jnp.zeros(count, here.dtype).at[pushed].add(here, mode="drop")
    if back is not None:
        shared = shared.at[back].add(here, mode="drop")
    six = _masses(problem)
    total = [[jnp.zeros_like(here)] * 3 for _ in range(3)]
    for bodies, arm in ((pushed, lever), (back, lever_back)):
        if bodies is None:
            continue
        times, *own = (column.at[bodies].get(mode="fill", fill_value=0) for column in (shared, *six))
        turned = [cross_of(arm, axis) for axis in frame]
        answers = [symmetric_of(own[1:], x) for x in turned]
        for i in range(3):
            for j in range(3):
                part = dot_of(turned[i], answers[j]) + (own[0] if i == j else 0.0)
                total[i][j] = total[i][j] + times * part
    rows = [sum(jnp.abs(x) for x in row) for row in total]
    along, across = rows[0], jnp.maximum(rows[1], rows[2])
    return divide(here, along), divide(here, across)


def _tangent(normal: Any) -> Any:
    """A unit vector across (Duff et al. 2017, "Building an orthonormal basis, revisited")."""
    x, y, z = normal
    sign = jnp.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    return 1.0 + sign * x * x * a, sign * x * y * a, -sign * x


def _masses(problem: Problem) -> tuple[Array, ...]:
    """1/m and the six entries xx, yy, zz, xy, xz, yz of the inverse inertia, columns (n,)."""
    xx, xy, xz, _, yy, yz, _, _, zz = components(problem.inverse_inertia.reshape(-1, 9))
    return problem.inverse_mass, xx, yy, zz, xy, xz, yz


def _response(masses: Any, impulse: Any) -> tuple[Array, ...]:
    """M⁻¹ p, six columns."""
    return (*(masses[0] * p for p in impulse[:3]), *symmetric_of(masses[1:], impulse[3:]))


def _at(motion: Array, bodies: Array, lever: Any) -> Any:
    own = [column.at[bodies].get(mode="clip") for column in motion]
    return tuple(v + t for v, t in zip(own[:3], cross_of(own[3:], lever), strict=True))


def _wrench(impulse: Any, lever: Any) -> Array:
    return jnp.stack([*impulse, *cross_of(lever, impulse)])


def _columns(parts: Any) -> Array:
    return jnp.stack(list(parts))
