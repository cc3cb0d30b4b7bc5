"""Contacts of one world as arrays: blocks of a few points, one block for each pair that may touch.

All points of a block join the same two things, so a body's velocity is looked up once a block, and the points' forces
are summed before they are handed to the body: gathering and scattering are what costs time here, not arithmetic.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrb.contact.resistance import Resistance
from jaxrb.math.arrays import Array, Scalar, Vector, components, entries, stack
from jaxrb.math.vector import cross, cross_of


class Incidence(eqx.Module):
    """Which bodies meet in which block.

    The first blocks join a body with what stands still: their bodies `lone` are known when the program is traced. The
    others join body `first` (p,) with body `second` (p,), numbers found at run time; `count` itself is nobody.
    """

    lone: tuple[int, ...] = eqx.field(static=True)
    first: Array
    second: Array
    count: int = eqx.field(static=True)

    def take(self, motion: Array) -> tuple[Array, Array | None]:
        """Rows (blocks, k) of the bodies that are pushed, and rows (p, k) of those that are pushed back."""
        lone = self._of_lone(motion)
        if not len(self.first):
            return lone, None
        padded = jnp.concatenate([motion, jnp.zeros_like(motion[:1])])
        both = padded[jnp.concatenate([self.second, self.first])]
        second, first = both[: len(self.first)], both[len(self.first) :]
        return (jnp.concatenate([lone, second]) if self.lone else second), first

    def give(self, pushed: Array, back: Array | None) -> Array:
        """Rows added up over the blocks of each body (count, k)."""
        lone = pushed[: len(self.lone)]
        if self.lone == tuple(range(self.count)):
            total = lone
        elif self.lone:
            total = (
                jnp.zeros((self.count, pushed.shape[-1]), pushed.dtype).at[np.asarray(self.lone)].add(lone)
            )
        else:
            total = jnp.zeros((self.count, pushed.shape[-1]), pushed.dtype)
        if back is None:
            return total
        rows = jnp.concatenate([pushed[len(self.lone) :], back])
        # Nobody's rows fall outside, where they are dropped.
        return total.at[jnp.concatenate([self.second, self.first])].add(rows, mode="drop")

    def _of_lone(self, motion: Array) -> Array:
        if self.lone == tuple(range(self.count)):
            return motion
        return motion[np.asarray(self.lone, int)]


class Contacts(eqx.Module):
    """Points of contact: blocks (k) of slots (s).

    * `normal` (k, 3): unit vector in W toward the body that is pushed.
    * `lever` (k, s, 3) [m]: from that body's centre of mass to the point, in W; `lever_back` (p, s, 3) from the centre
      of the body that is pushed back, None where none is.
    * `distance` (k, s) [m]: negative where they overlap. `active` (k, s): which slots hold a point near enough.
    * `friction` (k,), `restitution` (k,): None where the scene has none.
    * `feature` (k, s): whole numbers that name the point within its pair.
    * `resistance`: where there is any, the last slot of each block is no point, but the pair's couple.
    """

    incidence: Incidence
    normal: Vector
    lever: Vector
    lever_back: Vector | None
    distance: Scalar
    active: Array
    friction: Scalar | None
    restitution: Scalar | None
    feature: Array
    resistance: Resistance | None = None

    @property
    def lone(self) -> int:
        """Number of blocks of bodies against what stands still; they come first."""
        return len(self.incidence.lone)

    def relative_velocity(self, motion: Array) -> Vector:
        """Velocity (k, s, 3) [m/s] of the pushed body against the other at each point, of (v, ω) (n, 6) in W."""
        pushed, back = self.incidence.take(motion)
        velocity = self._at_slots(pushed, self.lever, 0)
        if back is None or self.lever_back is None:
            return velocity
        other = self._at_slots(back, self.lever_back, self.lone)
        return velocity.at[self.lone :].add(-other) if self.lone else velocity - other

    def impulse_on_bodies(self, impulse: Vector) -> Array:
        """Sum (n, 6) of impulse [N s] and angular impulse [N m s] on each body, of impulses (k, s, 3) in W."""
        pushed = self._wrench(impulse, self.lever, 0)
        back = None if self.lever_back is None else -self._wrench(impulse, self.lever_back, self.lone)
        return self.incidence.give(pushed, back)

    def blocks(self, bend: Array) -> Array:
        """Each body's own part (n, 6, 6) of Jᵀ G J, with G (k, s, 3, 3)."""
        pushed = self._block(self.lever, bend, 0)
        back = None if self.lever_back is None else self._block(self.lever_back, bend, self.lone)
        return self.incidence.give(pushed, back)[:, _WHOLE]

    def at_points(self, values: Array, couples: Any) -> Array:
        """Values (k, s) of the points, and what stands for the couples where there are any."""
        return values if self.resistance is None else values.at[:, -1].set(couples)

    # Of one side of the blocks from `first` on.

    def _at_slots(self, motion: Array, lever: Vector, first: int) -> Vector:
        velocity = _point_velocity(motion, lever)
        if self.resistance is None:
            return velocity
        return velocity.at[:, -1].set(self.resistance.arm[first:, None] * motion[:, 3:])

    def _wrench(self, impulse: Vector, lever: Vector, first: int) -> Array:
        impulse = impulse[first:]
        if self.resistance is None:
            return _summed_wrench(impulse, lever)
        points = _summed_wrench(impulse[:, :-1], lever[:, :-1])
        return points.at[:, 3:].add(self.resistance.arm[first:, None] * impulse[:, -1])

    def _block(self, lever: Vector, bend: Array, first: int) -> Array:
        bend = bend[first:]
        if self.resistance is None:
            return _block(lever, bend)
        arm = self.resistance.arm[first:]
        # A lever of zero: what is the couple's own goes to the forces' rows, and is moved to those of turning.
        points, couple = _block(lever[:, :-1], bend[:, :-1]), _block(lever[:, -1:], bend[:, -1:])
        return points.at[:, _TURNING].add((arm * arm)[:, None] * couple[:, _STRAIGHT])


def _point_velocity(motion: Array, lever: Vector) -> Vector:
    v1, v2, v3, w1, w2, w3 = (part[:, None] for part in components(motion))
    r1, r2, r3 = components(lever)
    return stack(v1 + (w2 * r3 - w3 * r2), v2 + (w3 * r1 - w1 * r3), v3 + (w1 * r2 - w2 * r1))


def _summed_wrench(impulse: Vector, lever: Vector) -> Array:
    turning = cross(lever, impulse)
    return jnp.sum(stack(*components(impulse), *components(turning)), axis=-2)


def _block(lever: Vector, bend: Array) -> Array:
    """Σ Jᵀ G J (k, 21) over the slots, J = (1, −r*), G symmetric: its lower triangle, row by row.

    By components 0.3 µs a body in a crowd; as products of small arrays 0.6 to 1.6, but half a second less to compile.
    """
    g = entries(bend)
    r = components(lever)
    # Columns of −r* are e × r; forces G (e × r) and their moments.
    turned = [cross_of(row, r) for row in g]  # turned[i][j]: force i for a turn about j, up to the sign
    full: dict[tuple[int, int], Any] = {}
    moments = [cross_of(r, [turned[i][j] for i in range(3)]) for j in range(3)]
    for i in range(3):
        for j in range(i + 1):
            full[i, j], full[3 + i, 3 + j] = g[i][j], -moments[j][i]
        for j in range(3):
            full[3 + i, j] = -turned[j][i]
    return jnp.sum(stack(*(full[entry] for entry in _LOWER)), axis=-2)


_LOWER = tuple((i, j) for i in range(6) for j in range(i + 1))
_STRAIGHT = np.array([_LOWER.index((i, j)) for i in range(3) for j in range(i + 1)], np.int32)
_TURNING = np.array([_LOWER.index((3 + i, 3 + j)) for i in range(3) for j in range(i + 1)], np.int32)
_WHOLE = np.array(
    [[_LOWER.index((max(i, j), min(i, j))) for j in range(6)] for i in range(6)],
    np.int32,  # of one type in both precisions: jax keeps constants of a process that runs both, and mixes them up
)
