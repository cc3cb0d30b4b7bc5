"""The joints of a scene, solved together.

At each evaluation of the equations of motion the constraint forces λ are those with which the joints' second
derivatives vanish, J (a₀ + M⁻¹ Jᵀ λ) + bias = 0 (index 1; Hairer and Wanner 1996, section VII.1). After each step
positions are projected onto the joints by Newton's method and velocities onto their tangent, both along M⁻¹ Jᵀ: the
smallest change in the metric of the kinetic energy (Lubich 1991; Eich 1993, SIAM J. Numer. Anal. 30, 1467).

Only rows that share a body have an entry in J M⁻¹ Jᵀ; which they are is known when the program is traced.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.freedom import Freedom, angular_mask, linear_mask
from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.effects.effect import Wrench, add
from jaxrb.joints.banded import Banded, blocked, unblocked
from jaxrb.joints.pattern import Pattern, pattern_of
from jaxrb.joints.reactions import JointReactions, reactions
from jaxrb.joints.rows import LengthRows, PointRows, Rows, TurnRows, joined, places
from jaxrb.math.arrays import Array, Scalar, Vector

# Of the size of a joint: what Newton's first round may leave. It squares the error, so the second leaves 1e-6 of it.
_CLOSED = 1e-3
_ASSEMBLING = 30  # rounds of Newton's method from a rough start


class JointSystem(eqx.Module):
    """All joints of a scene as rows, and what of them shares bodies."""

    parts: tuple[Any, ...]
    scale: Scalar  # (rows,) to which a row's error is compared: [m] the size of the largest joint or body; 1 for angles
    count: int = eqx.field(static=True)
    freedoms: tuple[Freedom, ...] = eqx.field(static=True)
    owners: tuple[tuple[int, int], ...] = eqx.field(
        static=True
    )  # of each row: which joint effect, which of its joints

    @property
    def pattern(self) -> Pattern:
        """Which rows meet, and in which order they are solved."""
        return pattern_of(self._pairs, self.count)

    @property
    def _pairs(self) -> tuple[tuple[int, int], ...]:
        return tuple(pair for part in self.parts for pair in part.bodies)

    def wrench(self, dynamics: Any, state: State, free: Wrench) -> Wrench:
        """What acts on the bodies (n, 3), the constraint forces with the rest."""
        with jax.named_scope("joints"):
            rows = self.rows(state)
            push = rows.pushed(self.bodies, self.count, self.forces(dynamics, state, free, rows))
        return Wrench(add(free.force, push[0]), add(free.torque, push[1]))

    def forces(self, dynamics: Any, state: State, free: Wrench, rows: Rows) -> Scalar:
        """λ (rows,) where everything else is `free`."""
        still = jnp.zeros((self.count, 3), state.dtype)
        linear = still if free.force is None else dynamics.linear_acceleration(free)
        angular = dynamics.inertia.acceleration(state.angular_velocity, free.torque)
        angular = still if angular is None else angular
        wanted = -(self._rate(rows, linear, angular) + rows.bias)
        return self.solver(dynamics, rows)(wanted)

    def complete(self, dynamics: Any, state: State) -> State:
        """The state with joints closed; one that two rounds of Newton's method do not close becomes NaN."""
        with jax.named_scope("joints"):
            state = self._closer(dynamics, state)
            rows = self.rows(state)
            solve = self.solver(dynamics, rows)
            open_by = lax.stop_gradient(jnp.max(jnp.abs(rows.value) / self.scale))
            new = self._shifted(dynamics, state, rows, solve(rows.value))
            new = self._braked(dynamics, new, rows, solve)
            lost = jnp.where(open_by <= _CLOSED, 0.0, jnp.nan)
            return eqx.tree_at(lambda s: s.position, new, new.position + lost.astype(state.dtype))

    def assembled(self, dynamics: Any, state: State) -> State:
        """The state with joints closed from a rough start by `_ASSEMBLING` rounds, then the velocities."""
        state, _ = lax.scan(lambda s, _: (self._closer(dynamics, s), None), state, length=_ASSEMBLING)
        rows = self.rows(state)
        return self._braked(dynamics, state, rows, self.solver(dynamics, rows))

    def opening(self, state: State) -> Scalar:
        """The rates (rows,) at which constraints open [m/s or rad/s]."""
        return self._rate(self.rows(state), state.velocity, state.angular_velocity)

    @property
    def bodies(self) -> np.ndarray:
        """(rows, 2): bodies a and b; `count` is the world."""
        return self.pattern.bodies

    def rows(self, state: State) -> Rows:
        """All rows at a state; what cannot move is not in their derivatives."""
        a, b = places(state, self.bodies)
        ends = np.cumsum([0, *(len(part.bodies) for part in self.parts)]).tolist()
        rows = joined([
            part.rows(*jax.tree.map(lambda leaf, i=i, j=j: leaf[i:j], (a, b)))
            for part, i, j in zip(self.parts, ends, ends[1:])
        ])  # fmt: skip
        still = np.zeros((1, 3), bool)
        masks = (np.concatenate([mask(self.freedoms), still]) for mask in (linear_mask, angular_mask))
        linear, angular = (
            part if mask[self.bodies].all() else jnp.where(mask[self.bodies], part, 0.0)
            for part, mask in zip((rows.linear, rows.angular), masks)
        )
        # Without a barrier XLA forms the rows anew for each of their many uses.
        return lax.optimization_barrier(Rows(rows.value, linear, angular, rows.bias))

    def solver(self, dynamics: Any, rows: Rows) -> Callable[[Scalar], Scalar]:
        """x -> (J M⁻¹ Jᵀ)⁻¹ x, factorised once."""
        one, other, side_of_one, side_of_other = self.pattern.pairs
        linear, angular = self._responses(dynamics, rows)
        entry = jnp.sum(
            rows.linear[one, side_of_one] * linear[other, side_of_other]
            + rows.angular[one, side_of_one] * angular[other, side_of_other],
            axis=-1,
        )
        place, width = self.pattern.place, self.pattern.width
        matrix = Banded.of_entries(one, other, entry, place, width)
        return lambda right: unblocked(matrix.solve(blocked(right, place, width)), place)

    def reactions(self, state: State, inverse: Array) -> JointReactions:
        """How the joints pass on impulses at a state; `inverse` (n, 6, 6) of each body's mass matrix, in W."""
        rows = self.rows(state)
        index = np.minimum(self.bodies, self.count - 1)  # the world's derivatives are zero
        turned = jax.tree.map(lambda leaf: leaf[index], state.orientation).rotate(rows.angular)
        derivative = jnp.concatenate([rows.linear, turned], axis=-1)
        return reactions(derivative, inverse, self._pairs, self.count, often=True)

    def _responses(self, dynamics: Any, rows: Rows) -> tuple[Vector, Vector]:
        """M⁻¹ Jᵀ (rows, 2, 3): how each row's unit force accelerates its two bodies."""
        index = np.minimum(self.bodies, self.count - 1)  # the world's derivatives are zero
        inverse = jax.tree.map(lambda leaf: jnp.asarray(leaf)[index], dynamics.inertia.inverted())
        return dynamics.inverse_mass[index][..., None] * rows.linear, inverse.apply(rows.angular)

    def _rate(self, rows: Rows, linear: Vector, angular: Vector) -> Scalar:
        still = jnp.zeros((1, 3), linear.dtype)
        return rows.rate(self.bodies, jnp.concatenate([linear, still]), jnp.concatenate([angular, still]))

    def _closer(self, dynamics: Any, state: State) -> State:
        """One round of Newton's method on the positions."""
        rows = self.rows(state)
        return self._shifted(dynamics, state, rows, self.solver(dynamics, rows)(rows.value))

    def _shifted(self, dynamics: Any, state: State, rows: Rows, size: Scalar) -> State:
        """The state moved by −M⁻¹ Jᵀ `size`."""
        shift, turn = self._change(dynamics, rows, size)
        orientation = state.orientation @ type(state.orientation).exp(-turn)
        return State(state.position - shift, orientation, state.velocity, state.angular_velocity, state.time)

    def _braked(self, dynamics: Any, state: State, rows: Rows, solve: Callable) -> State:
        """The state without the velocities that would open joints."""
        size = solve(self._rate(rows, state.velocity, state.angular_velocity))
        slower, turning = self._change(dynamics, rows, size)
        return State(
            state.position,
            state.orientation,
            state.velocity - slower,
            state.angular_velocity - turning,
            state.time,
        )

    def _change(self, dynamics: Any, rows: Rows, size: Scalar) -> tuple[Vector, Vector]:
        force, torque = rows.pushed(self.bodies, self.count, size)
        return force * dynamics.inverse_mass[:, None], dynamics.inertia.response(torque)


def joints_of(effects: tuple[Any, ...], freedoms: tuple[Freedom, ...], bodies: MassProperties) -> JointSystem:
    """The joints among the effects of bodies of these freedoms."""
    joints = [effect for effect in effects if effect.joins]
    world = len(freedoms)
    by_kind: dict[type, list[Any]] = {PointRows: [], TurnRows: [], LengthRows: []}
    owners: dict[type, list[tuple[int, int]]] = {kind: [] for kind in by_kind}
    lengths = [jnp.max(jnp.sqrt(bodies.inertia.trace() / (2.0 * jnp.asarray(bodies.mass))))]
    for number, joint in enumerate(joints):
        for part, own in joint.parts(world):
            by_kind[type(part)].append(part)
            owners[type(part)] += [(number, int(i)) for i in own]
            for name in ("anchor_a", "anchor_b", "length"):
                if hasattr(part, name):
                    lengths.append(jnp.max(jnp.abs(getattr(part, name))))
    parts = tuple(_together(found) for found in by_kind.values() if found)
    size = jnp.max(jnp.stack([jnp.asarray(length, float) for length in lengths]))
    size = jnp.where(size > 0, size, 1.0)  # points on guides through the origin
    scale = [
        jnp.broadcast_to(1.0 if isinstance(part, TurnRows) else size, (len(part.bodies),)) for part in parts
    ]
    return JointSystem(
        parts,
        lax.stop_gradient(jnp.concatenate(scale)),
        world,
        freedoms,
        tuple(owner for kind in by_kind for owner in owners[kind]),
    )


def _together(parts: list[Any]) -> Any:
    """Rows of one kind as one."""
    if len(parts) == 1:
        return parts[0]
    numbers = jax.tree.map(lambda *x: jnp.concatenate(x), *(_without_bodies(part) for part in parts))
    return type(parts[0])(**numbers, bodies=tuple(pair for part in parts for pair in part.bodies))


def _without_bodies(part: Any) -> dict[str, Array]:
    return {name: value for name, value in vars(part).items() if name != "bodies"}
