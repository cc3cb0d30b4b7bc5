"""Runs in which impacts are events: located in time, with exact derivatives through them."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import freedoms_of
from jaxrb.body.state import State, finite_per_body
from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, RunFailed, WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Array, Scalar
from jaxrb.scene.events_flight import is_exact
from jaxrb.scene.events_loop import (
    CAME_TO_REST,
    OUT_OF_TURNS,
    SEARCH_STALLED,
    TOO_MANY_EVENTS,
    Events,
    Settings,
    run_events,
)
from jaxrb.scene.freedoms import check_struck_plainly
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import ON_ERROR, check_choice, check_count, check_positive, check_struck
from jaxrb.scene.solve import run_times
from jaxrb.scene.status import NOT_FINITE, OK, Status, sound

_REASONS = {
    TOO_MANY_EVENTS: "there are more impacts than max_events = {most}; raise it, or raise resting_speed "
    "where bounces die away",
    CAME_TO_REST: "bodies have come to rest on each other; give dt=… [s], the step of the contact solve "
    "that goes on from there",
    SEARCH_STALLED: "the search for the next impact came to no end: bodies stay together while they "
    "turn; use rb.rollout",
    OUT_OF_TURNS: "the run did not reach its end in the turns it was given; raise max_steps or max_events",
}


class EventPath(Path):
    """A run of `solve_events`: a `Path` whose `events` tell every impact (`Events`)."""

    events: Events = eqx.field(kw_only=True)

    def raise_if_bad(self) -> None:
        """Raise `RunFailed` if the run failed: for paths that come out of `jit` or `vmap`."""
        reason = self.status.reason
        if not is_concrete(reason):
            return
        bad = np.isin(np.asarray(reason), list(_REASONS))
        if not bad.any():
            self.status.raise_if_bad()
            return
        where = np.unravel_index(int(bad.argmax()), bad.shape)
        world = f" of world {where[:-1]}" if len(where) > 1 else ""
        count = np.asarray(self.events.count)[where[:-1]]
        said = _REASONS[int(np.asarray(reason)[where])].format(most=self.events.time.shape[-1])
        raise RunFailed(
            f"solve_events{world}: after {count} impacts {said}. on_error='flag' keeps the result"
        )


def solve_events(
    scene: Scene,
    state: State,
    *,
    t1: Scalar | float,
    times: Array | None = None,
    max_events: int = 64,
    dt: Scalar | float | None = None,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
    resting_speed: Scalar | float | None = None,
    max_steps: int | None = None,
    on_error: str = "raise",
) -> EventPath:
    """Run from `state.time` to `t1` [s] with every impact located in time.

    Between impacts bodies fly: by the closed form where nothing or only `UniformGravity` acts, else by steps of
    `method`
    of at most `dt`. Impacts follow Newton's law of restitution and Coulomb's of friction, several at once where they
    are
    at once. Derivatives, forward and reverse, hold through impacts and their times (saltation), not through a change of
    their order; see `docs/events.md` for grazing and simultaneous ones.

    Args:
        t1: the end [s].
        times: (k,) [s] at which to save, ascending, within the run; by default the two ends.
        max_events: most impacts; a run with more fails. The program's length, and a gradient's memory, grow with it.
        dt: [s] the longest flight looked through at once (needed under other effects than gravity, and for crowds), and
            the step of resting contact: bodies that stay on each other are stepped as by `rollout` until they part.
            None: a run in which bodies come to rest fails.
        resting_speed: [m/s] bodies that meet more slowly and do not bounce without loss stay together; by default
            1e-4 in float64, 1e-3 in float32.
        max_steps: most pieces of `dt`; needed only where `t1`, `dt` or the state's time is traced.
        on_error: as for `rollout`.

    Raises:
        WrongStructure: no `RigidContact`, a `Composite`, Euler angles; effects that need a `dt`.
        RunFailed: too many impacts, rest without `dt`, numbers that are not finite.
    """
    check_fit(scene, state)
    check_choice("on_error", on_error, ON_ERROR)
    method = method_of(method)
    _check_scene(scene, state, method, dt)
    max_events = check_count("max_events", max_events, 1)
    if resting_speed is None:
        resting_speed = 1e-4 if jnp.finfo(state.dtype).bits == 64 else 1e-3
    check_positive("resting_speed", resting_speed, "m/s")
    times = run_times(state, t1, times)
    t1 = jnp.asarray(t1, state.dtype)
    marks = jnp.stack([state.time, t1]) if times is None else jnp.concatenate([times, t1[None]])
    turns = max_events + 1 + len(marks) + _pieces(state, t1, dt, max_steps)
    step = None if dt is None else jnp.asarray(dt, state.dtype)
    settings = Settings(method, step, jnp.asarray(resting_speed, state.dtype), max_events, turns)
    states, events, reason = _run(scene, state, marks, settings)
    final = jax.tree.map(lambda leaf: leaf[-1], states)
    if times is not None:
        states = jax.tree.map(lambda leaf: leaf[:-1], states)
    path = EventPath(
        states.time, states, final, Status(reason, jnp.full_like(reason, -1)), scene, events=events
    )
    if on_error == "raise":
        path.raise_if_bad()
    return path


@jax.jit
def _run(scene: Scene, state: State, marks: Array, settings: Settings) -> tuple[State, Events, Array]:
    with jax.named_scope("solve_events"):
        dynamics = scene.prepared(state.dtype)
        states, events, ended = run_events(dynamics, state, marks, settings)
        reason = sound(state, True)
        finite = jnp.all(jax.vmap(finite_per_body)(states), axis=0)
        ended = jnp.where(finite, ended, NOT_FINITE)
        return states, events, jnp.where(reason != OK, reason, ended).astype(jnp.int32)


def _pieces(state: State, t1: Any, dt: Any, max_steps: int | None) -> int:
    """Most pieces of dt in the run."""
    if dt is None:
        return 0
    if max_steps is not None:
        return check_count("max_steps", max_steps, 1)
    if not (is_concrete(t1) and is_concrete(dt) and is_concrete(state.time)):
        raise WrongStructure(
            "solve_events: t1, dt or the state's time is being traced, so the number of steps is not known; give "
            "max_steps=…, at least (t1 − time)/dt"
        )
    return math.ceil((float(t1) - float(state.time)) / float(dt)) + 1


def _check_scene(scene: Scene, state: State, method: Method, dt: Any) -> None:
    from jaxrb.effects.rigid_contact import RigidContact

    others = tuple(effect for effect in scene.effects if not isinstance(effect, RigidContact))
    if len(others) == len(scene.effects):
        raise WrongStructure(
            "solve_events: the scene has no RigidContact, so nothing can meet; add one, or use rb.rollout or rb.solve"
        )
    check_struck("solve_events", state, method)
    check_struck_plainly("solve_events", freedoms_of(scene.bodies), scene.effects)
    if dt is not None:
        check_positive("dt", dt)
    elif not is_exact(others):
        names = ", ".join(type(effect).__name__ for effect in others)
        raise WrongStructure(
            f"solve_events: flight under {names} has no closed form; give dt=…, the longest step of the method [s]"
        )
    if is_concrete(dt) and dt is not None and not np.isfinite(float(dt)):
        raise InvalidInput(f"solve_events: dt is {dt!r}, but must be finite")
