"""What went wrong in a run, and where: carried with the result, raised once at the outermost call."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State, finite_per_body
from jaxrb.checks import is_concrete
from jaxrb.errors import RunFailed
from jaxrb.math.arrays import Array

OK, NOT_FINITE, NOT_A_ROTATION, STOPPED_EARLY, TOO_MANY_CONTACTS = 0, 1, 2, 3, 4
TOO_MANY = (
    "more contact than RigidContact has room for: too many pairs of bodies near each other (raise capacity), or a "
    "hull's face with too many edges (merge its vertices)"
)
_REASONS = {
    NOT_FINITE: "the state is not finite (NaN or infinity)",
    NOT_A_ROTATION: "the orientation is no rotation any more",
    STOPPED_EARLY: "the solver stopped before the end (max_steps reached or no step small enough)",
    TOO_MANY_CONTACTS: TOO_MANY,
}


class Status(eqx.Module):
    """Per body: `reason` (n,), 0 where all is well, and `first_bad_step` (n,), −1 where there is none."""

    reason: Array
    first_bad_step: Array

    @property
    def ok(self) -> Array:
        """Whether nothing went wrong in the whole run."""
        return jnp.all(self.reason == OK)

    def raise_if_bad(self) -> None:
        """Raise `RunFailed` for the first body that went wrong. Does nothing while being traced."""
        if not is_concrete(self.reason):
            return
        reason = np.asarray(self.reason)
        if (reason == OK).all():
            return
        steps = np.asarray(self.first_bad_step)
        where = np.unravel_index(np.where(reason == OK, np.iinfo(np.int32).max, steps).argmin(), reason.shape)
        at = f"at step {steps[where]}" if steps[where] >= 0 else "during the run"
        others = int((reason != OK).sum()) - 1
        raise RunFailed(
            f"body {where[-1]}{f' of world {where[:-1]}' if len(where) > 1 else ''}: {_REASONS[int(reason[where])]}, "
            f"first {at}{f' ({others} more bodies failed)' if others else ''}. "
            "Take a smaller step, check forces and torques there, or keep the result with on_error='flag'"
        )


def sound(state: State, renormalise: bool) -> Array:
    """Reason code (n,) of a state with which a run starts.

    A method that renormalises would hide that the orientation it was given is no rotation: that is a failure too.
    """
    finite = finite_per_body(state)
    reason = jnp.where(finite, OK, NOT_FINITE)
    if renormalise:
        drift = state.orientation.drift()
        off = jnp.maximum(jnp.abs(drift.scale), drift.skew) > 1e-3
        reason = jnp.where(finite & off, NOT_A_ROTATION, reason)
    return reason.astype(jnp.int32)


def status_after(initial: Array, finite_steps: Array, steps: int, final: State, renormalise: bool) -> Status:
    """The status of a run of `steps` steps of which each body had `finite_steps` finite ones.

    A quaternion whose squared length overflows is projected to zero, a finite number, and shows as not finite only one
    step later: after the last step it is looked for here.
    """
    failed = finite_steps < steps
    reason = jnp.where(initial != OK, initial, jnp.where(failed, NOT_FINITE, OK))
    first = jnp.where(initial != OK, 0, jnp.where(failed, finite_steps + 1, -1))
    if renormalise:
        collapsed = (reason == OK) & (final.orientation.drift().scale < -0.5)
        reason = jnp.where(collapsed, NOT_A_ROTATION, reason)
        first = jnp.where(collapsed, steps, first)
    return Status(reason, first)


def with_contact(status: Status, report: Any) -> Status:
    """The status of a run in which contact may have had too little room: no body's motion can then be trusted."""
    if report is None:
        return status
    short = (report.overflow >= 0) & (status.reason == OK)
    return Status(
        jnp.where(short, TOO_MANY_CONTACTS, status.reason).astype(jnp.int32),
        jnp.where(short, report.overflow + 1, status.first_bad_step),
    )
