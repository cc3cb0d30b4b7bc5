"""The equations of motion of a scene as rates of rows of numbers, one row a number, one column a body."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
from jax import lax

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.adams_rows import ByRows
from jaxrb.integrators.method import rates
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.stacking import components, stack


class Motion(eqx.Module):
    """The equations of motion of a scene in rows: what moves is stepped, what is known beforehand is not.

    Without a force nothing of the translation is stepped; without a torque on spheres only the orientation is.
    """

    dynamics: Dynamics
    start: State
    torque: Vector | None
    linear: bool = eqx.field(static=True)
    angular: bool = eqx.field(static=True)

    @staticmethod
    def of(dynamics: Dynamics, start: State, torque: Vector | None) -> "Motion":
        """The motion from `start` under the dynamics and an applied body torque (n, 3) [N m], or None."""
        found = jax.eval_shape(lambda: dynamics.acceleration(start, torque))
        return Motion(dynamics, start, torque, found.linear is not None, found.angular is not None)

    def parts(self, moving: Any) -> list[Array]:
        """The moving numbers (n,) of a state, or of the rates of one."""
        leaves = jax.tree.leaves(moving.orientation)
        leaves += [moving.angular_velocity] if self.angular else []
        leaves += [moving.position, moving.velocity] if self.linear else []
        return [part for leaf in leaves for part in _flat(leaf)]

    def state(self, time: Scalar, parts: Sequence[Array]) -> State:
        """The state with these numbers, before projection; constraints put in their place."""
        rest = iter(parts)
        start = self.start
        orientation = jax.tree.map(lambda leaf: _like(leaf, rest), start.orientation)
        omega = _like(start.angular_velocity, rest) if self.angular else start.angular_velocity
        if self.linear:
            position, velocity = _like(start.position, rest), _like(start.velocity, rest)
        else:
            velocity = start.velocity
            position = start.position + (time - start.time) * velocity
        return self.dynamics.complete(State(position, orientation, velocity, omega, time))

    def rates(self, time: Scalar, parts: Sequence[Array]) -> list[Array]:
        """Time derivatives (n,) of the moving numbers."""
        now = self.state(time, parts)
        return self.parts(rates(now, self.dynamics.acceleration(now, self.torque)))

    def field(self) -> "Field":
        """The rates of the rows as a function."""
        run = ByRows(lambda motion, *at: motion.rates(*at), self, self.start.time, self.parts(self.start))
        return Field(run)


class Field:
    """Time derivative of rows (rows, n), in two parts: what depends on the time alone, and the rest."""

    def __init__(self, run: ByRows):
        self._run = run

    def schedule(self, times: Array) -> list[Array]:
        """What the rates need of each of the times, with the times' axes in front."""
        schedule = self._run.schedule
        for _ in range(times.ndim):
            schedule = jax.vmap(schedule)
        return schedule(times)

    def __call__(self, time: Scalar, scheduled: list[Array], rows: Array) -> Array:
        return joined(self._run(time, scheduled, list(rows)))


def joined(parts: Sequence[Array]) -> Array:
    """Numbers (n,) as rows (rows, n)."""
    return lax.concatenate([part[None] for part in parts], 0)


def _flat(leaf: Array) -> list[Array]:
    """The numbers of one body, each as (n,)."""
    return [leaf] if leaf.ndim == 1 else [part for slice_ in components(leaf) for part in _flat(slice_)]


def _like(leaf: Array, parts: Any) -> Array:
    """The inverse of `_flat`: the next parts as an array shaped like `leaf`."""
    if leaf.ndim == 1:
        return next(parts)
    return stack(*(_like(leaf[..., 0], parts) for _ in range(leaf.shape[-1])))
