"""Runs with contact to a stated tolerance."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import freedoms_of
from jaxrb.body.freedom import restricted
from jaxrb.body.state import State, finite_per_body
from jaxrb.checks import is_concrete
from jaxrb.compilation import jit
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Array, Scalar
from jaxrb.scene.adaptive_loop import run_adaptive
from jaxrb.scene.adaptive_records import Settings, StepCounts
from jaxrb.scene.certificate import Certificate, certificate_between
from jaxrb.scene.events_corners import corners_of
from jaxrb.scene.freedoms import check_struck_plainly
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import (
    ON_ERROR,
    check_choice,
    check_count,
    check_jointed,
    check_positive,
    check_struck,
    check_tolerance,
)
from jaxrb.scene.solve import run_times
from jaxrb.scene.status import NOT_FINITE, OK, Status, sound

# A judge's tolerance over that of the run it judges.
_FINER = 0.1
# The tolerance of a run that judges one by fixed steps, its most turns, and the places at which they are compared.
_JUDGE, _JUDGE_STEPS, _PLACES = {64: 1e-6, 32: 1e-4}, 20_000, 7
# The least tolerance that a floating type holds.
LEAST = {64: 1e-12, 32: 1e-4}
_DEFAULT = {64: 1e-6, 32: 1e-3}


class AdaptivePath(Path):
    """A run of `solve_contact`: a `Path` whose `steps` tell what it took (`StepCounts`)."""

    steps: StepCounts = eqx.field(kw_only=True)


def solve_contact(
    scene: Scene,
    state: State,
    *,
    t1: Scalar | float,
    tolerance: Scalar | float | None = None,
    times: Array | None = None,
    certify: bool = False,
    max_step: Scalar | float | None = None,
    max_steps: int = 100_000,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
    on_error: str = "raise",
) -> AdaptivePath:
    """Run a scene with contact from `state.time` to `t1` [s] with steps as short as a tolerance asks.

    Flights, impacts and phases of contact follow each other, each by what suits it: flights by the closed form where
    only `UniformGravity` or nothing acts, else by steps of `method` with a half-step estimate of their error; impacts
    at their own time; while bodies touch, by half-explicit Euler extrapolated to order 5, whose steps shrink where
    points stick, slip or lift off (`docs/accuracy_in_contact.md`). The laws are those of `RigidContact` in the limit
    of small steps.

    Args:
        t1: the end [s].
        tolerance: largest estimated error of one step: of positions and velocities [m, m/s], attitudes and angular
            velocities [rad, rad/s]; by default 1e-6, in float32 1e-3. The error at the end is what the motion makes of
            these: ask with `certify`.
        times: (k,) [s] at which to save, ascending, within the run; by default the two ends.
        certify: run once more with a tenth of the tolerance; the difference is `path.certificate`, which is *not
            reliable* where the two runs have lost each other.
        max_step: [s] the longest step or flight; needed only in crowds, where pairs near each other are sought.
        max_steps: most turns (impacts, steps and rejected steps); a run that needs more fails.
        method: of flights under forces other than uniform gravity.
        on_error: as for `rollout`.

    Returns the path, with `path.steps` (`StepCounts`). `jax.jit` and `jax.vmap` work.

    Raises:
        WrongStructure: no `RigidContact`, a `Composite`, Euler angles, bodies that are not free; while being
            differentiated, since steps are chosen by the numbers (use rb.solve_events or rb.rollout).
        InvalidInput: a tolerance below what the state's type holds (1e-12, float32 1e-4; to `certify` ten times that).
        RunFailed: more than `max_steps`, too many contacts, numbers that are not finite.
    """
    check_fit(scene, state)
    check_choice("on_error", on_error, ON_ERROR)
    method = method_of(method)
    _check_scene(scene, state, method)
    tolerance = _DEFAULT[jnp.finfo(state.dtype).bits] if tolerance is None else tolerance
    _check_tolerance(tolerance, state, certify)
    max_steps = check_count("max_steps", max_steps, 1)
    if max_step is not None:
        check_positive("max_step", max_step)
    times = run_times(state, t1, times)
    t1 = jnp.asarray(t1, state.dtype)
    marks = jnp.stack([state.time, t1]) if times is None else jnp.concatenate([times, t1[None]])
    longest = jnp.asarray(jnp.inf if max_step is None else max_step, state.dtype)
    settings = Settings(
        method, jnp.asarray(tolerance, state.dtype), longest, jnp.asarray(max_steps), _order(state)
    )
    states, counts, reason = _differentiable_not(scene, state, marks, settings)
    certificate = None
    if certify:
        finer = eqx.tree_at(lambda s: s.tolerance, settings, _FINER * settings.tolerance)
        judge, _, ended = _differentiable_not(scene, state, marks, finer)
        certificate = certificate_between(scene, states, judge, reason + ended, settings.tolerance)
    final = jax.tree.map(lambda leaf: leaf[-1], states)
    if times is not None:
        states = jax.tree.map(lambda leaf: leaf[:-1], states)
    status = Status(reason, jnp.full_like(reason, -1))
    path = AdaptivePath(states.time, states, final, status, scene, certificate, steps=counts)
    if on_error == "raise":
        path.raise_if_bad()
    return path


def takes(scene: Scene, state: State) -> bool:
    """Whether a scene can be run by `solve_contact` without being told a longest step."""
    try:
        _check_scene(scene, state, RungeKutta4())
        contact = scene.prepared(state.dtype).contact
        corners_of(contact, state.dtype)
    except WrongStructure:
        return False
    return all(len(meeting.first) <= meeting.touching for meeting in contact.meetings)


def judged(scene: Scene, states: State, tolerance: Scalar | float | None) -> Certificate:
    """The certificate of a run whose saved states are `states` (k, …), the start among them, by `solve_contact`."""
    count = states.time.shape[0]
    rows = np.unique(np.linspace(0, count - 1, _PLACES).round().astype(np.int32))
    scene, states = jax.lax.stop_gradient((scene, states))
    places = jax.tree.map(lambda leaf: leaf[rows], states)
    start = jax.tree.map(lambda leaf: leaf[0], places)
    asked = jnp.asarray(_JUDGE[jnp.finfo(states.dtype).bits], states.dtype)
    longest = jnp.asarray(jnp.inf, states.dtype)
    settings = Settings(RungeKutta4(), asked, longest, jnp.asarray(_JUDGE_STEPS), _order(start))
    judge, _, ended = _differentiable_not(scene, start, places.time, settings)
    return certificate_between(scene, places, judge, ended, tolerance)


def _order(state: State) -> int:
    """Of a step of contact. Beyond 5 what extrapolation gains goes into round-off."""
    return 5 if jnp.finfo(state.dtype).bits == 64 else 3


def _adaptive(
    scene: Scene, state: State, marks: Array, settings: Settings
) -> tuple[State, StepCounts, Array]:
    with jax.named_scope("solve_contact"):
        states, counts, ended = run_adaptive(scene.prepared(state.dtype), state, marks, settings)
        reason = sound(state, True)
        finite = jnp.all(jax.vmap(finite_per_body)(states), axis=0)
        ended = jnp.where(finite, ended, NOT_FINITE)
        return states, counts, jnp.where(reason != OK, reason, ended).astype(jnp.int32)


_run = jit(_adaptive)


@jax.custom_jvp
def _differentiable_not(scene: Scene, state: State, marks: Array, settings: Settings) -> Any:
    return _run(scene, state, marks, settings)


@_differentiable_not.defjvp
def _refused(primals: Any, tangents: Any) -> Any:
    raise WrongStructure(
        "solve_contact has no derivative: its steps are chosen by the numbers, and an impact's time would be held "
        "still; use rb.solve_events (impacts with their times) or rb.rollout"
    )


def _check_tolerance(tolerance: Any, state: State, certify: bool) -> None:
    check_tolerance("tolerance", tolerance)
    least = LEAST[jnp.finfo(state.dtype).bits]
    if certify and is_concrete(tolerance) and least <= float(tolerance) < 9.99 * least:
        raise InvalidInput(
            f"solve_contact: certify runs once more at a tenth of the tolerance {tolerance!r}, but "
            f"{np.dtype(state.dtype).name} holds {least:g} at best; ask for {10 * least:g} or more"
        )
    if is_concrete(tolerance) and float(tolerance) < 0.999 * least:
        more = "; use float64 for less" if least > 1e-6 else ""
        raise InvalidInput(
            f"solve_contact: tolerance is {tolerance!r}, but {np.dtype(state.dtype).name} holds {least:g} a step at "
            f"best{more}"
        )


def _check_scene(scene: Scene, state: State, method: Method) -> None:
    from jaxrb.effects.rigid_contact import RigidContact

    if not any(isinstance(effect, RigidContact) for effect in scene.effects):
        raise WrongStructure(
            "solve_contact: the scene has no RigidContact, so nothing can touch; use rb.solve, or rb.rollout with "
            "tolerance="
        )
    check_struck("solve_contact", state, method)
    check_jointed(scene, "solve_contact", "use rb.rollout")
    check_struck_plainly("solve_contact", freedoms_of(scene.bodies), scene.effects)
    if restricted(freedoms_of(scene.bodies)) is not None:
        raise WrongStructure(
            "solve_contact: a body's freedom is restricted; all must be free: use rb.rollout"
        )
