"""A run in stretches of one compiled program: whatever the stretches, the same steps with the same bits.

How many steps a stretch has is a number of the program, not its structure, and all that a step hands to the next is
handed from stretch to stretch: contact's memory, compensated remainders, the count of steps that the time comes from.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State
from jaxrb.body.unturned import shown
from jaxrb.integrators.method import Method, contact_report
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.scene import watch
from jaxrb.scene.scene import Scene
from jaxrb.scene.status import Status, sound, status_after, with_contact


class Progress(eqx.Module):
    """All that the next step needs: `held`, the state as the method holds it, what it carries beside (`carry`), and the
    counts of the run.

    `start` () [s]; `done` () steps; `finite_steps` (n,); `unsound` (n,): reason code of the state at the start.
    """

    held: State
    carry: Any
    start: Scalar
    done: Array
    finite_steps: Array
    unsound: Array

    @property
    def state(self) -> State:
        """Where the run is."""
        return shown(self.held)


class Stretch(eqx.Module):
    """States and reports of contact that a stretch saved, the first `saved` rows of each; and the run's status."""

    states: State
    contact: Any
    saved: Array
    status: Status


@jax.jit
def begun(scene: Scene, state: State, method: Method) -> Progress:
    """A run before its first step."""
    unsound = sound(state, method.renormalise)
    dynamics = scene.prepared(state.dtype)
    carry = method.first_carry(dynamics, state)
    return Progress(
        method.held(dynamics, state),
        carry,
        state.time,
        jnp.zeros((), jnp.int32),
        jnp.zeros_like(unsound),
        unsound,
    )


def report_of(progress: Progress) -> Any:
    """What contact did so far; None in a scene without contact."""
    return contact_report(progress.carry)


def room_for(states: int) -> int:
    """Rows of a buffer for so many saved states: few different numbers, since each is a program of its own."""
    return 2 ** (states + 1).bit_length()


def _stretched(
    scene: Scene,
    progress: Progress,
    torque: Vector | None,
    dt: Scalar,
    method: Method,
    end: Array,
    save_every: Array,
    *,
    room: int,
) -> tuple[Progress, Stretch]:
    """The run up to step `end`, with the states of every `save_every`-th step, `room` of them at most."""
    dynamics = scene.prepared(progress.held.dtype)
    varying = torque is not None and torque.ndim == 3

    def one(_: Any, now: Progress) -> Progress:
        given = torque[now.done] if varying else torque  # pyright: ignore[reportOptionalSubscript]
        new, carry = method.carried_step(dynamics, now.held, now.carry, dt, given)
        done = now.done + 1
        # Counted as `rollout` counts it.
        new = eqx.tree_at(lambda s: s.time, new, now.start + done.astype(dt.dtype) * dt)
        finite_steps = watch.counted(now.finite_steps, now.held, new)
        return Progress(new, carry, now.start, done, finite_steps, now.unsound)

    def to_next_save(carried: tuple) -> tuple:
        now, kept, saved = carried
        here = jnp.minimum(save_every - now.done % save_every, end - now.done)
        now = lax.fori_loop(0, here, one, now)
        # A row that is not due is written too, and overwritten by the next.
        row = (now.state, report_of(now))
        kept = jax.tree.map(lambda rows, x: rows.at[saved].set(x), kept, row)
        return now, kept, saved + (now.done % save_every == 0)

    rows = jax.tree.map(lambda x: jnp.zeros((room, *x.shape), x.dtype), (progress.state, report_of(progress)))
    carried = (_counting(watch.opened, progress), rows, jnp.zeros((), jnp.int32))
    progress, kept, saved = lax.while_loop(lambda c: c[0].done < end, to_next_save, carried)
    progress = _counting(watch.closed, progress)
    status = status_after(
        progress.unsound, progress.finite_steps, progress.done, progress.state, method.renormalise
    )
    return progress, Stretch(kept[0], kept[1], saved, with_contact(status, report_of(progress)))


def _counting(change: Callable[[Array, State], Array], progress: Progress) -> Progress:
    """With `finite_steps` as between stretches, or as within one."""
    return eqx.tree_at(lambda p: p.finite_steps, progress, change(progress.finite_steps, progress.held))


stretched = jax.jit(_stretched, static_argnames=("room",))
