"""Rounds of projected gradient over columns: blocks of points are the long axis, their slots the short one.

As rows of three numbers a round of a heap of sixteen boxes takes as long, of sixty-four a third more, of a crowd of
balls four times as long. XLA's scatter on CPU is not slow in one long axis: 4 ns a row; lists of a body's points, to be
gathered instead, take four times that.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.inertia import symmetric_of
from jaxrb.contact.block import Incidence
from jaxrb.contact.problem import Problem
from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.safe import divide
from jaxrb.math.vector import cross_of, dot_of


class Columns(NamedTuple):
    """Contact points in columns: slots by blocks (s, k).

    `lever` (s, k), `lever_back` (s, p) and `normal` (k,): three components each. `along`, `across` (s, k) [kg]: 1 over
    a bound of N = J M⁻¹ Jᵀ along the normal and across it, each body divided among its points; 0 where there is no
    contact. `give_along`, `give_across` [1/kg²]: their inverses squared.
    """

    problem: Problem
    lever: Any
    lever_back: Any
    normal: Any
    bias: Scalar
    along: Scalar
    across: Scalar
    give_along: Scalar
    give_across: Scalar

    def moved(self, impulse: Any) -> Array:
        """The motion (6, n) with impulses, three columns (s, k)."""
        given = self.on_bodies(impulse)
        if self.problem.joints is not None or self.problem.allowed is not None:
            return self.problem.free.T + self.problem.response(given.T).T
        answer = _response(_masses(self.problem), given)
        return self.problem.free.T + jnp.stack(answer)

    def velocity(self, motion: Array) -> Any:
        """Of the pushed body against the other at each point (s, k), of motions (6, n)."""
        pushed, back = _taken(self.problem.contacts.incidence, motion)
        own = self._at_slots(pushed, self.lever, 0)
        if back is None:
            return own
        lone = self.problem.contacts.lone
        other = self._at_slots(back, self.lever_back, lone)
        return tuple(a - jnp.pad(b, ((0, 0), (lone, 0))) for a, b in zip(own, other, strict=True))

    def on_bodies(self, impulse: Any) -> Array:
        """Impulse and angular impulse (6, n) on each body."""
        pushed = self._wrench(impulse, self.lever, 0)
        if self.lever_back is None:
            return _given(self.problem.contacts.incidence, pushed, None)
        lone = self.problem.contacts.lone
        back = -self._wrench([part[:, lone:] for part in impulse], self.lever_back, lone)
        return _given(self.problem.contacts.incidence, pushed, back)

    def stepped(self, impulse: Any, motion: Array) -> tuple[Any, Scalar]:
        """The impulses after a projected step from where bodies move with `motion`; how far from the law those were."""
        velocity, normal = self.velocity(motion), self.normal
        held, closing = dot_of(impulse, normal), dot_of(velocity, normal)
        pressing, most = self._pressing(held - self.along * (closing - self.bias))
        if most is None:
            new = tuple(pressing * n for n in normal)
        else:
            side = [
                y - held * n - self.across * (v - closing * n)
                for y, n, v in zip(impulse, normal, velocity, strict=True)
            ]
            # `law.within` with one root and no division: its branches take as long as all the rest.
            square = jnp.maximum(dot_of(side, side), jnp.finfo(held.dtype).tiny)
            cut = jnp.minimum(most * lax.rsqrt(square), 1.0)
            new = tuple(pressing * n + cut * t for n, t in zip(normal, side, strict=True))
        return new, self.felt(tuple(x - y for x, y in zip(new, impulse, strict=True)))

    def _pressing(self, along: Scalar) -> tuple[Scalar, Scalar | None]:
        """The normal parts (s, k) that the law allows, and the greatest length of the tangential ones."""
        friction, resistance = self.problem.contacts.friction, self.problem.contacts.resistance
        pressing = jnp.maximum(along, 0.0)
        most = None if friction is None else friction * pressing
        if resistance is None:
            return pressing, most
        rolling, spinning = resistance.bounds(jnp.sum(pressing[:-1], axis=0))
        most = jnp.zeros_like(pressing) if most is None else most
        return pressing.at[-1].set(jnp.clip(along[-1], -spinning, spinning)), most.at[-1].set(rolling)

    def _at_slots(self, motion: Array, lever: Any, first: int) -> Any:
        """Velocities (s, k) at the slots of one side, whose blocks begin with `first`."""
        velocity, resistance = _at(motion, lever), self.problem.contacts.resistance
        if resistance is None:
            return velocity
        arm = resistance.arm[first:]
        return tuple(v.at[-1].set(arm * w) for v, w in zip(velocity, motion[3:], strict=True))

    def _wrench(self, impulse: Any, lever: Any, first: int) -> Array:
        resistance = self.problem.contacts.resistance
        if resistance is None:
            return _wrench(impulse, lever)
        points = _wrench([part[:-1] for part in impulse], [part[:-1] for part in lever])
        couple = jnp.stack([resistance.arm[first:] * part[-1] for part in impulse])
        return points.at[3:].add(couple)

    def felt(self, impulse: Any) -> Scalar:
        """The greatest velocity [m/s] that is the step's own at a point whose impulse changes so."""
        normally = dot_of(impulse, self.normal)
        sideways = dot_of(impulse, impulse) - normally * normally
        off = jnp.maximum(self.give_along * normally * normally, self.give_across * sideways)
        # In two stages: XLA's own way takes a point after the other.
        most = lax.optimization_barrier(jnp.max(off, axis=0))
        return jnp.sqrt(jnp.max(most, initial=0.0))

    def columns(self, impulse: Vector) -> Any:
        """Impulses (k, s, 3) as three columns (s, k)."""
        return tuple(_columns(impulse))

    def rows(self, impulse: Any) -> Vector:
        """The same back."""
        return stack(*(part.T for part in impulse))


def columns_of(problem: Problem) -> Columns:
    """The problem as columns."""
    c = problem.contacts
    lever = _columns(c.lever)
    back = None if c.lever_back is None else _columns(c.lever_back)
    normal = components(c.normal)
    active = c.active.T
    along, across = _bounds(problem, active, lever, back, normal)
    bias = jnp.where(active, problem.bias.T, 0.0)
    give = (divide(1.0, along) ** 2, divide(1.0, across) ** 2)
    return Columns(problem, lever, back, normal, bias, along, across, *give)


def _bounds(
    problem: Problem, active: Array, lever: Any, lever_back: Any, normal: Any
) -> tuple[Scalar, Scalar]:
    """1 over the bounds of N at each point along its normal and across: by Gershgorin's rows of the 3×3 parts."""
    first = _tangent(normal)
    frame = (normal, first, cross_of(normal, first))
    incidence = problem.contacts.incidence
    here = active.astype(normal[0].dtype)
    each = jnp.sum(here, axis=0)[None]
    shared = _given(incidence, each, None if lever_back is None else each[:, len(incidence.lone) :])
    pushed, back = _taken(incidence, jnp.concatenate([shared, jnp.stack(_masses(problem))]))
    arm = None if problem.contacts.resistance is None else problem.contacts.resistance.arm
    rows = _rows(frame, pushed, lever, arm)
    if back is not None:
        lone = len(incidence.lone)
        own = [[part[lone:] for part in axis] for axis in frame]
        others = _rows(own, back, lever_back, None if arm is None else arm[lone:])
        rows = [a + jnp.pad(b, ((0, 0), (lone, 0))) for a, b in zip(rows, others, strict=True)]
    nn, tt, uu, nt, nu, tu = (jnp.abs(x) for x in rows)
    return divide(here, nn + nt + nu), divide(here, jnp.maximum(nt + tt, nu + uu) + tu)


def _rows(frame: Any, bodies: Array, lever: Any, arm: Scalar | None) -> list[Scalar]:
    """What an impulse at each point does there to one of its bodies, times in how many points that takes part: the
    entries 11, 22, 33, 12, 13, 23 of a symmetric matrix in the point's frame. `arm`: of couples, the last slots."""
    times, mass, *inertia = bodies
    turned = [cross_of(lever, axis) for axis in frame]
    if arm is not None:
        turned = [
            [t.at[-1].set(arm * a) for t, a in zip(x, axis, strict=True)]
            for x, axis in zip(turned, frame, strict=True)
        ]
        mass = jnp.broadcast_to(mass, lever[0].shape).at[-1].set(0.0)
    answers = [symmetric_of(inertia, x) for x in turned]
    own = [times * (mass + dot_of(turned[i], answers[i])) for i in range(3)]
    return own + [times * dot_of(turned[i], answers[j]) for i, j in ((0, 1), (0, 2), (1, 2))]


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


def _taken(incidence: Incidence, motion: Array) -> tuple[Array, Array | None]:
    """Columns (m, k) of the bodies that are pushed and (m, p) of those pushed back, of columns (m, n)."""
    lone = motion if _everybody(incidence) else motion[:, np.asarray(incidence.lone, np.int32)]
    pairs = len(incidence.first)
    if not pairs:
        return lone, None
    # Nobody stands still.
    padded = jnp.pad(motion, ((0, 0), (0, 1)))
    both = padded.at[:, jnp.concatenate([incidence.second, incidence.first])].get(mode="clip")
    return jnp.concatenate([lone, both[:, :pairs]], axis=1), both[:, pairs:]


def _given(incidence: Incidence, pushed: Array, back: Array | None) -> Array:
    """Columns (m, k) and (m, p) added up over the blocks of each body (m, n)."""
    lone = len(incidence.lone)
    if _everybody(incidence):
        total = pushed[:, :lone]
    else:
        total = jnp.zeros((len(pushed), incidence.count), pushed.dtype)
        if lone:
            total = total.at[:, np.asarray(incidence.lone, np.int32)].add(pushed[:, :lone])
    if back is None:
        return total
    at = jnp.concatenate([incidence.second, incidence.first])
    # Nobody's fall outside, where they are dropped.
    return total.at[:, at].add(jnp.concatenate([pushed[:, lone:], back], axis=1), mode="drop")


def _everybody(incidence: Incidence) -> bool:
    return incidence.lone == tuple(range(incidence.count))


def _at(motion: Array, lever: Any) -> Any:
    own = components(motion.T)
    return tuple(v + t for v, t in zip(own[:3], cross_of(own[3:], lever), strict=True))


def _wrench(impulse: Any, lever: Any) -> Array:
    return jnp.stack([jnp.sum(part, axis=0) for part in (*impulse, *cross_of(lever, impulse))])


def _columns(rows: Vector) -> list[Array]:
    return [part.T for part in components(rows)]
