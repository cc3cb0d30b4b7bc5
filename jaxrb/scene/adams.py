"""The fastest accurate run under smooth torques and forces: stabilised Adams steps, counted by a pilot."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, RunFailed, WrongStructure
from jaxrb.integrators.adams_weights import SCHEMES, Scheme
from jaxrb.math.arrays import Array, Scalar
from jaxrb.scene import adams_lanes as lanes
from jaxrb.scene.adams_pilot import Found, Problem, planned
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene, check_fit, refuse_contact
from jaxrb.scene.settings import (
    ON_ERROR,
    applied_torque,
    check_choice,
    check_count,
    check_jointed,
    check_tolerance,
)
from jaxrb.scene.solve import run_times
from jaxrb.scene.status import NOT_A_ROTATION, NOT_FINITE, OK, STOPPED_EARLY, Status

_ORDERS = (
    (6, 1e-5),
    (8, 1e-7),
    (10, 1e-10),
    (11, 1e-12),
    (12, 0.0),
)  # the cheapest order from which tolerance on
_TRACED_LIMIT = 1e-3  # drift of an orientation that no converged run comes near


class SmoothPath(Path):
    """A run of `solve_smooth`, with how it was made.

    steps, order: of the method; give both again to repeat the run without a pilot.
    error: () estimate of the largest error of any body at the end, in the measure of `tolerance`; None where `steps`
        was given, since nothing was compared.
    """

    steps: int = eqx.field(static=True, kw_only=True)
    order: int = eqx.field(static=True, kw_only=True)
    error: Scalar | None = eqx.field(default=None, kw_only=True)


def solve_smooth(
    scene: Scene,
    state: State,
    *,
    t1: Scalar | float,
    tolerance: float | None = None,
    times: Array | None = None,
    order: int | None = None,
    steps: int | None = None,
    torque: Any = None,
    on_error: str = "raise",
) -> SmoothPath:
    """Integrate from `state.time` to `t1` [s] where every force and torque is a smooth function of state and time.

    Stabilised explicit Adams: fixed steps, one evaluation a step, order 6 to 12 by tolerance. The number of steps comes
    from a pilot, which runs the fastest and some other bodies with n and 1.3 n steps until their difference is well
    below the tolerance; then all run, and every body's drift and smoothness is looked at. A body that fails joins
    the pilot, and the run is repeated: nothing diverges in silence. The pilot costs about a third of a run of 1000
    bodies; give the `steps` and `order` of its path to save it.

    Not for impacts, stiff contact, dry friction or torques with jumps: a kink is felt as an error of low order, so the
    steps grow until the tolerance is met or the run is refused. Split such a run at the jumps, or use `rb.solve`.

    On a CPU with 512-bit vectors the program asks XLA for them (`JAXRB_VECTOR_WIDTH` in the environment overrides).
    With `XLA_FLAGS=--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=10000000` in the environment,
    XLA compiles each group's loop to one kernel: half the time again. No library may set that for a process.

    Args:
        tolerance: for the error at the end, without unit: attitude [rad]; positions and velocities relative to
            1 + their size in SI units. By default 1e-9 in float64, 1e-4 in float32.
        times: (k,) [s] at which to save, ascending, within the run; by default the two ends. They cost little: between
            steps the solution is interpolated to the method's order.
        order: 6 to 12; by default chosen by the tolerance.
        steps: number of steps instead of a pilot, rounded up to a whole turn of the method's ring. Needed under `jit`,
            `grad` and `vmap`, where the numbers that a pilot needs are not known.
        torque: applied body torque [N m], (n, 3), constant.
        on_error: as for `rollout`; a tolerance that is not met counts as an error.

    Derivatives, forward and reverse, are those of the steps taken, at a given `steps`.

    Raises:
        InvalidInput, WrongStructure: settings out of range, or `steps` missing where values are traced.
        RunFailed: a state is not finite, or the tolerance cannot be met: a torque that is not smooth, or a tolerance
            below the round-off of the state's type.
    """
    check_fit(scene, state)
    refuse_contact(scene, "solve_smooth", "use rb.rollout")
    check_jointed(scene, "solve_smooth", "use rb.rollout or rb.solve")
    check_choice("on_error", on_error, ON_ERROR)
    tolerance = _tolerance(tolerance, state)
    scheme = _scheme(order, tolerance)
    times = run_times(state, t1, times)
    problem = Problem(
        scene, state, applied_torque(torque, state), jnp.asarray(t1, state.dtype), times, scheme
    )
    if steps is not None:
        cycles = scheme.cycles(check_count("steps", steps, 1))
        found = Found(problem.all_bodies(cycles), cycles, None, True)
    elif problem.traced:
        raise WrongStructure(
            "solve_smooth: a traced run cannot choose its steps; run once outside jit, grad and vmap and give "
            "steps=path.steps, order=path.order"
        )
    else:
        found = planned(problem, tolerance)
    path = _path(problem, found, tolerance)
    if on_error == "raise":
        _raise_if_missed(path, found, tolerance)
        path.raise_if_bad()
    return path


def _tolerance(tolerance: float | None, state: State) -> float:
    eps = float(jnp.finfo(state.dtype).eps)
    if tolerance is None:
        return 1e-9 if eps < 1e-10 else 1e-4
    check_tolerance("tolerance", tolerance)
    if not is_concrete(tolerance):
        raise WrongStructure(
            "tolerance: it chooses the method, so it must be a number known when the program is traced"
        )
    if tolerance < 100 * eps:
        raise InvalidInput(
            f"tolerance is {tolerance!r}, but {state.dtype} resolves no less than {100 * eps:.1g} in a run; raise it, "
            "or run in float64"
        )
    return float(tolerance)


def _scheme(order: int | None, tolerance: float) -> Scheme:
    if order is None:
        order = next(
            o
            for o, least in ((6, 1e-5), (8, 1e-7), (10, 1e-10), (11, 1e-12), (12, 0.0))
            if tolerance >= least
        )
    order = check_count("order", order, 1)
    if order not in SCHEMES:
        raise InvalidInput(f"order is {order}, but must be from {min(SCHEMES)} to {max(SCHEMES)}")
    return SCHEMES[order]


@jax.jit
def _status(ends: lanes.Ends, limit: Scalar, met: Array) -> Status:
    good = jnp.maximum(ends.drift, ends.roughness) <= limit
    missed = jnp.where(met, OK, STOPPED_EARLY)
    ended = jnp.where(ends.finite, jnp.where(good, missed, NOT_A_ROTATION), NOT_FINITE)
    reason = jnp.where(ends.begun != OK, ends.begun, ended).astype(jnp.int32)
    return Status(reason, jnp.full_like(reason, -1))


def _path(problem: Problem, found: Found, tolerance: float) -> SmoothPath:
    ends = found.ends
    status = _status(ends, _TRACED_LIMIT if found.error is None else 10 * tolerance, found.met)
    return SmoothPath(
        ends.states.time,
        ends.states,
        ends.final,
        status,
        problem.scene,
        steps=problem.scheme.steps(found.cycles),
        order=problem.scheme.order,
        error=None if found.error is None else jnp.asarray(found.error, problem.state.dtype),
    )


def _raise_if_missed(path: SmoothPath, found: Found, tolerance: float) -> None:
    if found.met or not (np.asarray(found.ends.finite) & (np.asarray(found.ends.begun) == OK)).all():
        return
    raise RunFailed(
        f"solve_smooth: the error estimate is {float(found.error or 0.0):.1e} after {path.steps} steps of order "
        f"{path.order}, above the tolerance {tolerance:.1e}. Either a force or torque is not smooth (split the run at "
        "its jumps, or use rb.solve), or the tolerance is below round-off (raise it); on_error='flag' keeps the result"
    )
