"""Where bodies press on each other at saved states, and how much: what a rollout's report tells only in total.

A step is made from each saved state and its solve is looked at, so that runs that nobody looks at pay nothing.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.state import State
from jaxrb.compilation import jit
from jaxrb.errors import InvalidInput
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Array
from jaxrb.scene.scene import Scene

STEP = 1e-3  # [s] of the step looked at, where nobody says which


class SavedContacts(NamedTuple):
    """Points at which contact presses. Those of saved state k are rows `first[k]` to `first[k + 1]`.

    `point` (p, 3) [m] and `force` (p, 3) [N] in the world frame; `pair` (p, 2): the body that the force acts on, and
    the one that feels its opposite, −1 for what stands still.
    """

    first: np.ndarray
    point: np.ndarray
    force: np.ndarray
    pair: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """As a file holds them."""
        return {f"touch_{name}": value for name, value in self._asdict().items()}

    @classmethod
    def of_arrays(cls, where: str, arrays: Any, saves: int) -> "SavedContacts | None":
        """From a file's arrays; None where it has none.

        Raises:
            InvalidInput: arrays that do not fit each other.
        """
        names = [f"touch_{name}" for name in cls._fields]
        if not any(name in arrays for name in names):
            return None
        if missing := [name for name in names if name not in arrays]:
            raise InvalidInput(
                f"{where}: holds no {missing[0]!r} beside the others of contact; save the run again"
            )
        first, point, force, pair = (np.asarray(arrays[name]) for name in names)
        count = len(point)
        fits = (
            first.shape == (saves + 1,)
            and point.shape == force.shape == (count, 3)
            and pair.shape == (count, 2)
        )
        if not fits or first[0] != 0 or first[-1] != count or (np.diff(first) < 0).any():
            raise InvalidInput(
                f"{where}: points of contact {point.shape}, forces {force.shape} and pairs {pair.shape} do not fit "
                f"{saves} saved states; save the run again"
            )
        return cls(first, point, force, pair)


def contacts_of(
    scene: Scene, states: State, dt: float = STEP, method: Method | None = None
) -> SavedContacts | None:
    """Points and forces of rigid contact in the step of `dt` [s] after each saved state; None without contact.

    Forces are impulses of the step over its length. A blow that bounces within a step has no force to speak of; what
    is told is what rests, slides or stops.
    """
    point, force, pair = _pressed(scene, states, jnp.asarray(dt, states.dtype), method or RungeKutta4())
    if point is None:
        return None
    point, force, pair = (np.asarray(x) for x in (point, force, pair))
    pressing = np.any(force != 0, axis=-1) & np.isfinite(force).all(axis=-1) & np.isfinite(point).all(axis=-1)
    first = np.concatenate([[0], np.cumsum(pressing.sum(axis=1))])
    return SavedContacts(
        first.astype(np.int32), point[pressing].astype(float), force[pressing].astype(float), pair[pressing]
    )


@jit
def _pressed(scene: Scene, states: State, dt: Array, method: Method) -> tuple[Any, Any, Any]:
    dynamics = scene.prepared(states.dtype)
    contact = dynamics.contact
    if contact is None:
        return None, None, None
    alone = eqx.tree_at(lambda d: d.contact, dynamics, None)

    def at(state: State) -> tuple[Array, Array, Array]:
        free = method.step(alone, state, dt)
        _, carried = contact.resolved(dynamics, state, free, dt, contact.first_memory(state))
        found = contact.detected(state, free, dt, carried.memory)
        # Started from what the step left, the solve's start is the step's answer, point by point.
        c = found.contacts
        pushed, _ = c.incidence.take(state.position)
        still = jnp.full(c.lone, -1, jnp.int32)
        acted = jnp.concatenate(
            [jnp.asarray(c.incidence.lone, jnp.int32), c.incidence.second.astype(jnp.int32)]
        )
        first = jnp.where(
            c.incidence.first == c.incidence.count, -1, c.incidence.first
        )  # nobody stands still
        other = jnp.concatenate([still, first.astype(jnp.int32)])
        pair = jnp.broadcast_to(jnp.stack([acted, other], axis=1)[:, None], (*c.active.shape, 2))
        shown = c.at_points(c.active, False)  # couples are no forces
        force = jnp.where(shown[..., None], found.start, 0.0) / dt
        rows = (pushed[:, None] + c.lever, force, pair)
        return jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), rows)

    return lax.map(at, states)
