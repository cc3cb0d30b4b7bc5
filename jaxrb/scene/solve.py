"""Any solver of diffrax on the same equations of motion."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State, finite_per_body
from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.integrators.method import Rates, rates
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene, check_fit, refuse_contact
from jaxrb.scene.settings import (
    ON_ERROR,
    applied_torque,
    check_choice,
    check_count,
    check_number,
    check_numbers,
    check_tolerance,
)
from jaxrb.scene.status import NOT_FINITE, OK, STOPPED_EARLY, Status, sound

# [1/s] How fast the solver's numbers go back to the joints, on which the equations are evaluated in any case. Without
# it errors across the joints add up and bend the motion along them: after 100 periods of a pendulum 1e-6 rad, with it
# 9e-10.
_RETURN = 10.0


def solve(
    scene: Scene,
    state: State,
    *,
    t1: Scalar | float,
    solver: Any = None,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    times: Array | None = None,
    torque: Any = None,
    max_steps: int = 100_000,
    adjoint: Any = None,
    on_error: str = "raise",
) -> Path:
    """Integrate from `state.time` to `t1` [s] with a solver of diffrax and error-controlled steps.

    The solver sees the numbers of the representation; saved and final orientations are projected back to exact
    rotations. (Projecting at every step was measured not to help the attitude.)

    Args:
        solver: e.g. `diffrax.Dopri8()`, the default. rtol, atol: its tolerances for each step.
        times: (k,) [s] at which to save, ascending, within the run; by default the two ends.
        torque: applied body torque [N m], (n, 3), constant.
        max_steps: the run stops there; a run that stopped early is an error, never a short result.
        adjoint: diffrax's way to differentiate; by default its `RecursiveCheckpointAdjoint`.
        on_error: as for `rollout`.
    """
    import diffrax  # not at the top: importing it takes longer than the rest of jaxrb

    check_fit(scene, state)
    refuse_contact(scene, "solve", "use rb.solve_contact, or rb.rollout")
    check_choice("on_error", on_error, ON_ERROR)
    check_tolerance("rtol", rtol)
    check_tolerance("atol", atol)
    max_steps = check_count("max_steps", max_steps, 1)
    solver = diffrax.Dopri8() if solver is None else solver
    if not isinstance(solver, diffrax.AbstractSolver):
        raise WrongStructure(
            f"solver: {solver!r} is no solver of diffrax; use e.g. diffrax.Dopri8(), or rb.rollout"
        )
    adjoint = diffrax.RecursiveCheckpointAdjoint() if adjoint is None else adjoint
    times = run_times(state, t1, times)
    states, reason = _integrate(
        scene, state, applied_torque(torque, state), jnp.asarray(t1, state.dtype), times, (rtol, atol),
        _Program.of(solver), _Program.of(adjoint), max_steps=max_steps,
    )  # fmt: skip
    final = jax.tree.map(lambda leaf: leaf[-1], states)
    if times is None:
        saved_times, saved = states.time, states
    else:
        saved = jax.tree.map(lambda leaf: leaf[:-1], states)
        saved_times = saved.time
    path = Path(saved_times, saved, final, Status(reason, jnp.full_like(reason, -1)), scene)
    if on_error == "raise":
        path.raise_if_bad()
    return path


def run_times(state: State, t1: Any, times: Any) -> Array | None:
    """The times at which to save, of the state's type; refuses an end or times that no run can have."""
    check_number("t1", t1)
    if is_concrete(t1) and is_concrete(state.time) and not (np.isfinite(t1) and t1 > float(state.time)):
        raise InvalidInput(
            f"t1 is {t1!r} s, but must be finite and later than the state's {float(state.time)} s"
        )
    if times is None:
        return None
    check_numbers("times", times)
    if is_concrete(times) and is_concrete(t1) and is_concrete(state.time):
        host = np.asarray(times, float)
        inside = np.isfinite(host) & (host >= float(state.time)) & (host <= float(t1))
        if host.ndim != 1 or not inside.all() or (np.diff(host) < 0).any():
            raise InvalidInput(
                f"times {host.tolist()} s: give (k,) ascending times between {float(state.time)} and {float(t1)} s"
            )
    return jnp.asarray(times, state.dtype)


class _Program(eqx.Module):
    """A solver or adjoint of diffrax as an argument of a program: its arrays, and all else (implicit solvers hold
    functions and marks), which is structure."""

    numbers: Any
    structure: Any = eqx.field(static=True)

    @classmethod
    def of(cls, given: Any) -> "_Program":
        return cls(*eqx.partition(given, eqx.is_array))

    def whole(self) -> Any:
        return eqx.combine(self.numbers, self.structure)


def _integrate_states(
    scene: Scene,
    state: State,
    torque: Vector | None,
    t1: Scalar,
    times: Array | None,
    tolerances: tuple[float, float],
    solver: "_Program",
    adjoint: "_Program",
    *,
    max_steps: int,
) -> tuple[State, Array]:
    import diffrax

    dynamics = scene.prepared(state.dtype)

    def at(t: Scalar, y: tuple) -> State:
        return State(y[0], y[1] if dynamics.joints is None else y[1].normalise(), y[2], y[3], t)

    def field(t: Scalar, y: tuple, _: None) -> tuple:
        now = dynamics.complete(at(t, y))
        rate: Rates = rates(now, dynamics.acceleration(now, torque))
        zero = jnp.zeros_like(now.velocity)
        found = (
            rate.position,
            rate.orientation,
            zero if rate.velocity is None else rate.velocity,
            zero if rate.angular_velocity is None else rate.angular_velocity,
        )
        if dynamics.joints is None:
            return found
        held = (now.position, now.orientation, now.velocity, now.angular_velocity)
        return jax.tree.map(lambda f, x, off: f + _RETURN * (x - off), found, held, y)

    saved = jnp.stack([state.time, t1]) if times is None else jnp.concatenate([times, t1[None]])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver.whole(),
        state.time,
        t1,
        None,
        (state.position, state.orientation, state.velocity, state.angular_velocity),
        saveat=diffrax.SaveAt(ts=saved),
        stepsize_controller=diffrax.PIDController(rtol=tolerances[0], atol=tolerances[1]),
        adjoint=adjoint.whole(),
        max_steps=max_steps,
        throw=False,
    )
    raw = solution.ys
    assert raw is not None
    states = State(raw[0], raw[1].normalise(), raw[2], raw[3], saved)
    states = jax.vmap(dynamics.complete)(states)
    stopped = solution.result != diffrax.RESULTS.successful
    reason = sound(state, True)
    finite = jnp.all(jax.vmap(finite_per_body)(states), axis=0)
    ended = jnp.where(stopped, STOPPED_EARLY, jnp.where(finite, OK, NOT_FINITE))
    return states, jnp.where(reason != OK, reason, ended).astype(jnp.int32)


_integrate = jax.jit(_integrate_states, static_argnames=("max_steps",))
