"""The program of a run with impacts as events: flights to the next impact, save or end, one after the other.

Every turn of the loop flies to what comes first and, if that is an impact, makes it. The loop has a fixed number of
turns, so it can be differentiated in both modes. The time of an impact is a number found by a search without
derivatives; one step of Newton's method from it, t* − g(t*)/ġ(t*), has its value and its derivative (the implicit
function theorem), and the flight to t*, the impact and the flight after it carry that on: the saltation matrix, without
being written down.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.problem import motion_of
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.method import Method
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import norm
from jaxrb.math.vector import dot
from jaxrb.scene.events_corners import Corners, corners_of
from jaxrb.scene.events_flight import Flight, flight_of
from jaxrb.scene.events_impact import Blow, hits, struck
from jaxrb.scene.events_search import Scale, first_impact, touching
from jaxrb.scene.status import OK, TOO_MANY_CONTACTS

TOO_MANY_EVENTS, CAME_TO_REST, SEARCH_STALLED, OUT_OF_TURNS = 11, 12, 13, 14


class Settings(eqx.Module):
    """How to run: `dt` [s] the longest flight and the step of resting contact (None: flights as long as they are, no
    resting), `resting_speed` [m/s], and the capacities."""

    method: Method
    dt: Scalar | None
    resting_speed: Scalar
    max_events: int = eqx.field(static=True)
    turns: int = eqx.field(static=True)


class Events(eqx.Module):
    """The impacts of a run, in order; rows beyond `count` are empty (time infinite, pair −2).

    `time` (m,) [s]; of the strongest point of each: `pair` (m, 2) the numbers of the body that was pushed and of the
    other (−1: what stands still), `point` (m, 3) [m] and `impulse` (m, 3) [N s] on the first, in W; `points` (m,): how
    many met at once.
    """

    time: Scalar
    pair: Array
    point: Vector
    impulse: Vector
    points: Array
    count: Array

    def with_blow(self, time: Scalar, blow: Blow, happened: Array) -> "Events":
        """With one more, if it happened."""
        at = jnp.where(happened, self.count, len(self.time))

        def put(rows: Array, row: Array) -> Array:
            return rows.at[at].set(row, mode="drop")

        return Events(
            put(self.time, time), put(self.pair, blow.pair), put(self.point, blow.point),
            put(self.impulse, blow.impulse), put(self.points, blow.points), self.count + happened,
        )  # fmt: skip


class Turn(eqx.Module):
    """What goes from turn to turn: the `state`, the next `mark` (a save, or the end), whether bodies rest (`resting`),
    whether the last impact was `slow`, `reason` of a failure, and what resting contact `carried`."""

    state: State
    mark: Array
    resting: Array
    slow: Array
    reason: Array
    carried: Any


def run_events(
    dynamics: Dynamics, state: State, marks: Array, settings: Settings
) -> tuple[State, Events, Array]:
    """States (k, ...) at the `marks` (k,) [s], which ascend; the events; and the reason of a failure (0 for none)."""
    contact = dynamics.contact
    corners = corners_of(contact, state.dtype)
    none, no = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
    carried = None if settings.dt is None else contact.first_memory(state)
    turn = Turn(state, none, no, no, none, carried)
    saved = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(marks), *x.shape)), state)
    carry = (turn, saved, _no_events(settings.max_events, state.dtype))

    def one(carry: Any, _: None) -> tuple[Any, None]:
        turn, saved, events = carry
        going = (turn.mark < len(marks)) & (turn.reason == OK)
        act = _Act(dynamics, corners, settings, marks)
        new, blow, happened = lax.cond(going, lambda t: act.go(t), lambda t: act.idle(t), turn)
        # An impact for which there is no room is not made: the run ends before it.
        full = happened & (events.count >= settings.max_events)
        new = eqx.tree_at(lambda t: t.reason, new, jnp.where(full, TOO_MANY_EVENTS, new.reason))
        events = events.with_blow(new.state.time, blow, happened & ~full)
        reached = new.mark > turn.mark
        at = jnp.where(reached, turn.mark, len(marks))
        saved = jax.tree.map(lambda rows, row: rows.at[at].set(row, mode="drop"), saved, new.state)
        return (new, saved, events), None

    (turn, saved, events), _ = lax.scan(one, carry, None, length=settings.turns)
    saved = filled_from(turn.mark, saved, turn.state)
    short = (turn.reason == OK) & (turn.mark < len(marks))
    return saved, events, jnp.where(short, OUT_OF_TURNS, turn.reason)


def filled_from(mark: Array, saved: State, state: State) -> State:
    """Saved states (k, ...) with `state` from row `mark` on: a run that ended early shows where in all it missed."""
    missed = jnp.arange(len(saved.time)) >= mark
    return jax.tree.map(
        lambda rows, row: jnp.where(missed.reshape(-1, *(1,) * row.ndim), row, rows), saved, state
    )


def _no_events(most: int, dtype: Any) -> Events:
    none = jnp.zeros((most,), jnp.int32)
    return Events(
        jnp.full((most,), jnp.inf, dtype), jnp.full((most, 2), -2, jnp.int32), jnp.zeros((most, 3), dtype),
        jnp.zeros((most, 3), dtype), none, jnp.zeros((), jnp.int32),
    )  # fmt: skip


def _no_blow(dtype: Any) -> Blow:
    none = jnp.zeros((), jnp.int32)
    zero = jnp.zeros(3, dtype)
    return Blow(jnp.full(2, -2, jnp.int32), zero, zero, none, jnp.zeros((), bool))


class _Act(eqx.Module):
    """One turn of the loop."""

    dynamics: Dynamics
    corners: Corners
    settings: Settings
    marks: Array

    def go(self, turn: Turn) -> tuple[Turn, Blow, Array]:
        """A flight or, where bodies rest, a step; with the impact, if there was one, and whether there was."""
        if self.settings.dt is None:
            return self.fly(turn)
        return lax.cond(turn.resting, lambda t: self.rest(t), lambda t: self.fly(t), turn)

    def idle(self, turn: Turn) -> tuple[Turn, Blow, Array]:
        """Nothing: the run has ended."""
        return turn, _no_blow(turn.state.dtype), jnp.zeros((), bool)

    def horizon(self, turn: Turn) -> tuple[Scalar, Array]:
        """How long this turn may last, and whether that reaches the mark."""
        left = jnp.maximum(self.marks[jnp.minimum(turn.mark, len(self.marks) - 1)] - turn.state.time, 0.0)
        if self.settings.dt is None:
            return left, jnp.ones((), bool)
        # The last piece is not left to be a sliver.
        whole = left <= 1.001 * self.settings.dt
        return jnp.where(whole, left, self.settings.dt), whole

    def fly(self, turn: Turn) -> tuple[Turn, Blow, Array]:
        """To the next impact, or as far as this turn may."""
        contact, state = self.dynamics.contact, turn.state
        flight = flight_of(self.dynamics, state, self.settings.method)
        horizon, whole = self.horizon(turn)
        reach = self._reach(flight, state, horizon)
        found, scale = first_impact(contact, self.corners, flight, state, horizon, reach)
        tau = jnp.where(found.hit, found.tau, horizon)
        now, c = _flown(contact, flight, state, tau, found.hit, reach, scale)
        mark = turn.mark + jnp.where(found.hit, 0, whole)
        time = jnp.where(
            jnp.logical_or(found.hit, ~whole),
            now.time,
            self.marks[jnp.minimum(turn.mark, len(self.marks) - 1)],
        )
        now = eqx.tree_at(lambda s: s.time, now, time)

        def strike(now: State) -> tuple[State, Blow]:
            return struck(self.dynamics, now, c, scale, self.settings.resting_speed)

        new, blow = lax.cond(found.hit, strike, lambda s: (s, _no_blow(s.dtype)), now)
        # Twice in a row too slow for a bounce: something presses bodies together, and they stay so.
        rests = found.hit & blow.slow & turn.slow
        reason = jnp.where(found.stalled, SEARCH_STALLED, turn.reason)
        reason = jnp.where(found.overflow, TOO_MANY_CONTACTS, reason)
        if self.settings.dt is None:
            reason = jnp.where(rests, CAME_TO_REST, reason)
        slow = jnp.where(found.hit, blow.slow, turn.slow & ~whole)
        return Turn(new, mark, rests, slow, reason.astype(jnp.int32), turn.carried), blow, found.hit

    def rest(self, turn: Turn) -> tuple[Turn, Blow, Array]:
        """One step of time stepping, with the contact solve of `rollout`."""
        contact, state = self.dynamics.contact, turn.state
        span, whole = self.horizon(turn)
        free = self.settings.method.free_step(self.dynamics, state, None, span, None)[0]
        new, carried = contact.resolved(self.dynamics, state, free, span, turn.carried)
        presses = [jnp.any(impulse != 0) for impulse in carried.memory.impulse]
        reason = jnp.where(carried.report.overflow >= 0, TOO_MANY_CONTACTS, turn.reason).astype(jnp.int32)
        resting = jnp.any(jnp.stack(presses))
        after = Turn(new, turn.mark + whole, resting, resting, reason, carried)
        return after, _no_blow(state.dtype), jnp.zeros((), bool)

    def _reach(self, flight: Flight, state: State, horizon: Scalar) -> Array:
        """How far (n,) [m] any point of each body can move in a turn; infinite where every pair is looked at."""
        contact = self.dynamics.contact
        if all(len(meeting.first) <= meeting.touching for meeting in contact.meetings):
            return jnp.full(contact.count, jnp.inf, state.dtype)
        flight, state, horizon = lax.stop_gradient((flight, state, horizon))
        bounds = flight.bounds(state, horizon)
        speed = norm(state.velocity) + bounds.spin * contact.radius
        gathered = 0.5 * horizon * (norm(bounds.acceleration) + bounds.excess)
        return lax.stop_gradient(horizon * (speed + gathered))


def _flown(
    contact: Any, flight: Flight, state: State, tau: Scalar, hit: Array, reach: Array, scale: Scale
) -> tuple[State, Contacts]:
    """The state and contacts at the impact, with the derivative of its time; without one the state at `tau`."""

    def look(tau: Scalar, _: None) -> tuple[Scalar, tuple[State, Contacts]]:
        now = flight.after(state, tau)
        c = touching(contact, now, reach).contacts
        rate = dot(c.relative_velocity(motion_of(now)), c.normal[:, None])
        rate, distance = lax.stop_gradient((rate, c.distance))
        meets = hits(c, rate, scale)
        # Of several at once the time is that of the nearest; on a tie the first.
        at = jnp.argmin(jnp.where(meets, distance, jnp.inf))
        gap, speed = c.distance.ravel()[at], rate.ravel()[at]
        usable = hit & jnp.any(meets)
        later = (lax.stop_gradient(gap) - gap) / jnp.where(usable, speed, 1.0)
        return tau + jnp.where(usable, later, 0.0), (now, c)

    _, both = lax.scan(look, tau, None, length=2)
    return jax.tree.map(lambda rows: rows[-1], both)
