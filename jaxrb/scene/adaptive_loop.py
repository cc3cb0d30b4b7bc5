"""The program of a run with contact to a tolerance: impacts, flights and steps of contact, one after the other.

A turn of the loop looks at the points of the state. Where some meet there is an impact, which takes no time; where some
are held a step of contact is tried; else bodies fly to what comes first. A step whose error is above the tolerance is
tried again shorter. Where a point sticks, slips or lifts off within a step the error falls only with the square of the
step, so between the last good time and the first bad one the interval is halved until what is left may be crossed at
once (or, where a sliding point slows down, the time at which it would stop is tried first). An open point that closes
within a step ends it there.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State, finite_per_body
from jaxrb.effects.dynamics import Dynamics
from jaxrb.geometry.primitives import HalfSpace
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.safe import norm
from jaxrb.scene.adaptive_points import Levels, Points, points_of, reach_of, struck
from jaxrb.scene.adaptive_records import Settings, StepCounts, Turn
from jaxrb.scene.adaptive_step import difference, tried
from jaxrb.scene.events_corners import Corners, corners_of
from jaxrb.scene.events_flight import ExactFlight, flight_of
from jaxrb.scene.events_loop import filled_from
from jaxrb.scene.events_search import first_impact
from jaxrb.scene.status import NOT_FINITE, OK, STOPPED_EARLY, TOO_MANY_CONTACTS

# A step is at most so many times the last, and at least such a part of it; aim for this part of the tolerance.
_GROW, _SHRINK, _AIM = 5.0, 0.2, 0.8
_TURN = 0.5  # [rad] a step of contact turns no body farther
_FIRST = 1e-2  # [s] the first step that is tried
_HALVINGS = 40  # of a flight by steps of a method, within one turn


def run_adaptive(
    dynamics: Dynamics, state: State, marks: Array, settings: Settings
) -> tuple[State, StepCounts, Array]:
    """States (k, ...) at the `marks` (k,) [s], which ascend; the counts; and the reason of a failure (0 for none)."""
    corners = corners_of(dynamics.contact, state.dtype)
    act = _Act(dynamics, corners, settings, marks)
    saved = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(marks), *x.shape)), state)

    def going(carry: Any) -> Array:
        turn, _ = carry
        return (turn.mark < len(marks)) & (turn.reason == OK) & (turn.turns < settings.max_steps)

    def one(carry: Any) -> Any:
        turn, saved = carry
        new = act.turned(turn)
        at = jnp.where(new.mark > turn.mark, turn.mark, len(marks))
        saved = jax.tree.map(lambda rows, row: rows.at[at].set(row, mode="drop"), saved, new.state)
        return new, saved

    turn, saved = lax.while_loop(going, one, (_first_turn(state, settings), saved))
    saved = filled_from(turn.mark, saved, turn.state)
    short = (turn.reason == OK) & (turn.mark < len(marks))
    return saved, turn.counts, jnp.where(short, STOPPED_EARLY, turn.reason)


def _first_turn(state: State, settings: Settings) -> Turn:
    none = jnp.zeros((), jnp.int32)
    zero, never = jnp.zeros((), state.dtype), jnp.asarray(jnp.inf, state.dtype)
    counts = StepCounts(none, none, none, never, jnp.zeros((len(state.position), 2), state.dtype))
    first = jnp.minimum(jnp.asarray(_FIRST, state.dtype), settings.longest)
    return Turn(state, none, first, settings.longest, first, -never, zero, first, counts, none, none)


class _Act(eqx.Module):
    """One turn of the loop."""

    dynamics: Dynamics
    corners: Corners
    settings: Settings
    marks: Array

    def turned(self, turn: Turn) -> Turn:
        """An impact, a step of contact, or a flight."""
        levels = self.levels(turn.state)
        reach = reach_of(self.dynamics.contact, turn.state, jnp.zeros((), turn.state.dtype))
        points = points_of(self.dynamics.contact, turn.state, reach, levels)
        hits, holds = jnp.any(points.hit), jnp.any(points.held)
        choice = jnp.where(hits, 0, jnp.where(holds, 1, 2))
        ways = tuple(lambda *x, way=way: way(*x) for way in (self.impact, self.contact, self.flight))
        new = lax.switch(choice, ways, turn, points, levels)
        finite = jnp.all(finite_per_body(new.state))
        reason = jnp.where(finite, new.reason, NOT_FINITE)
        reason = jnp.where(points.overflow, TOO_MANY_CONTACTS, reason)
        return eqx.tree_at(lambda t: (t.turns, t.reason), new, (turn.turns + 1, reason.astype(jnp.int32)))

    def levels(self, state: State) -> Levels:
        """What counts as closed, at rest and an impact: what is lost by it is a small part of the tolerance."""
        tolerance, eps = self.settings.tolerance, float(jnp.finfo(state.dtype).eps)
        size = jnp.max(self.dynamics.contact.radius) + jnp.max(jnp.abs(state.position))
        pull = self.dynamics.acceleration(state).linear
        pull = jnp.zeros((), state.dtype) if pull is None else jnp.max(norm(pull))
        # A hop of this speed is as high as a twentieth of the tolerance; where nothing pulls none comes back.
        fastest = jnp.max(norm(state.velocity) + norm(state.angular_velocity) * self.dynamics.contact.radius)
        resting = jnp.maximum(jnp.sqrt(0.1 * tolerance * pull), 64 * eps * fastest)
        return Levels(
            jnp.maximum(0.01 * tolerance, 64 * eps * size), resting, 1e-3 * resting + 16 * eps * fastest
        )

    def impact(self, turn: Turn, points: Points, levels: Levels) -> Turn:
        """Points meet: no time passes."""
        state = struck(self.dynamics, turn.state, points, levels)
        # What was slow before a blow need not be after it.
        counts = eqx.tree_at(lambda c: c.impacts, turn.counts, turn.counts.impacts + 1)
        never = jnp.full_like(turn.trouble, -jnp.inf)
        return eqx.tree_at(lambda t: (t.state, t.counts, t.trouble), turn, (state, counts, never))

    def contact(self, turn: Turn, points: Points, levels: Levels) -> Turn:
        """A step with the points that are held, if its error is small; else it is to be tried shorter."""
        state, tolerance, order = turn.state, self.settings.tolerance, self.settings.order
        left = self.left(turn)
        floor = self.floor(state)
        spin = jnp.max(norm(state.angular_velocity))
        span = jnp.minimum(turn.step, _TURN / jnp.where(spin > 0, spin, 1e-6))
        span = jnp.maximum(jnp.minimum(span, jnp.minimum(self.settings.longest, self.safe(state))), floor)
        whole = left <= 1.0001 * span
        span = jnp.where(whole, left, span)
        trial = tried(self.dynamics, state, points, span, levels, order)
        excess = jnp.max(trial.error) / jnp.maximum(tolerance, trial.noise)
        excess = jnp.where(jnp.isfinite(excess), excess, 1e12)
        lands = trial.meets < span
        good = ((excess <= 1.0) & ~lands) | (span <= floor)
        end = jnp.where(whole, self.marks[jnp.minimum(turn.mark, len(self.marks) - 1)], state.time + span)
        new = eqx.tree_at(lambda s: s.time, trial.state, end)
        step, smooth, trouble, at = self.lengths(turn, trial, span, excess, good, lands, end)
        state = jax.tree.map(lambda a, b: jnp.where(good, a, b), new, state)
        counts = self.counted(turn.counts, good, span, trial.error)
        reason = jnp.where(trial.overflow, TOO_MANY_CONTACTS, turn.reason)
        return Turn(
            state, turn.mark + (good & whole), step, turn.flight, smooth, trouble, at[0], at[1], counts,
            turn.turns, reason.astype(jnp.int32),
        )  # fmt: skip

    def safe(self, state: State) -> Scalar:
        """A step [s] in which nothing can fly through another body; past a half-space nothing can."""
        contact = self.dynamics.contact
        if not contact.meetings and all(isinstance(o.shape, HalfSpace) for o in contact.obstacles):
            return jnp.asarray(jnp.inf, state.dtype)
        size = jnp.min(jnp.where(contact.radius > 0, contact.radius, jnp.inf)).astype(state.dtype)
        speed = jnp.max(norm(state.velocity) + norm(state.angular_velocity) * contact.radius)
        pull = self.dynamics.acceleration(state).linear
        pull = jnp.zeros((), state.dtype) if pull is None else jnp.max(norm(pull))
        return 0.25 * size / (speed + jnp.sqrt(size * pull) + jnp.finfo(state.dtype).tiny)

    def lengths(
        self, turn: Turn, trial: Any, span: Scalar, excess: Scalar, good: Array, lands: Array, end: Scalar
    ) -> tuple[Scalar, Scalar, Scalar, tuple[Scalar, Scalar]]:
        """The next step to try, the one to go back to after trouble, the trouble's time, and its excess and length."""
        order = self.settings.order
        small = jnp.maximum(excess, 1e-12)
        by_order = span * jnp.clip((_AIM / small) ** (1.0 / order), _SHRINK, _GROW)
        # A good step cut short by a save or a landing says nothing against a longer one.
        grown = jnp.maximum(by_order, jnp.where(turn.step > span, turn.step, 0.0))
        bad = ~good & ~lands
        trouble = jnp.where(bad, turn.state.time + span, turn.trouble)
        at = jnp.where(bad, excess, turn.excess), jnp.where(bad, span, turn.length)
        now = jnp.where(good, end, turn.state.time)
        ahead = trouble - now
        in_trouble = ahead > 0
        # What a crossing of the rest would cost, by the square of its length.
        crossing = at[0] * (ahead / at[1]) ** 2
        slip = jnp.where(good, trial.slips - span, trial.slips)
        guess = jnp.where((slip > 0) & (slip < 0.9 * ahead) & (slip > 1e-3 * ahead), slip, 0.5 * ahead)
        cautious = jnp.where((crossing <= 0.5) | (ahead <= self.floor(turn.state)), 1.0001 * ahead, guess)
        smooth = jnp.where(bad & ~(turn.trouble > turn.state.time), span, turn.smooth)
        # Past the trouble the step is that of before.
        past = good & ~in_trouble & (turn.trouble > turn.state.time)
        after = jnp.where(past, jnp.maximum(smooth, by_order), jnp.where(good, grown, by_order))
        step = jnp.where(
            in_trouble,
            jnp.where(good, jnp.minimum(cautious, jnp.maximum(after, 0.25 * ahead)), cautious),
            after,
        )
        step = jnp.where(lands & ~good, trial.meets, step)
        return step, smooth, trouble, at

    def counted(self, counts: StepCounts, good: Array, span: Scalar, error: Array) -> StepCounts:
        """With one step more."""
        return StepCounts(
            counts.accepted + good,
            counts.rejected + ~good,
            counts.impacts,
            jnp.where(good & (span > 0), jnp.minimum(counts.smallest, span), counts.smallest),
            counts.error + jnp.where(good, error, 0.0),
        )

    def left(self, turn: Turn) -> Scalar:
        """Time [s] to the next mark."""
        return jnp.maximum(self.marks[jnp.minimum(turn.mark, len(self.marks) - 1)] - turn.state.time, 0.0)

    def floor(self, state: State) -> Scalar:
        """The shortest step [s]: below it time itself is round-off."""
        eps = jnp.finfo(state.dtype).eps
        return 16 * eps * jnp.maximum(jnp.abs(state.time), jnp.max(jnp.abs(self.marks)))

    def flight(self, turn: Turn, points: Points, levels: Levels) -> Turn:
        """To the next impact, or as far as this turn may."""
        state, contact = turn.state, self.dynamics.contact
        flight = flight_of(self.dynamics, state, self.settings.method)
        left = self.left(turn)
        if isinstance(flight, ExactFlight):
            span, error = (
                jnp.minimum(left, self.settings.longest),
                jnp.zeros((len(state.position), 2), state.dtype),
            )
            rejected = jnp.zeros((), jnp.int32)
            following = turn.flight
        else:
            span, error, rejected, following = self.short_enough(
                flight, state, jnp.minimum(turn.flight, left)
            )
            # A save that cut a flight short says nothing against a longer one.
            following = jnp.where(span >= left, jnp.maximum(following, turn.flight), following)
        whole = span >= left
        reach = reach_of(contact, state, span)
        found, _ = first_impact(contact, self.corners, flight, state, span, reach)
        tau = jnp.where(found.hit, found.tau, span)
        new = flight.after(state, tau)
        mark = turn.mark + jnp.where(found.hit, 0, whole)
        end = self.marks[jnp.minimum(turn.mark, len(self.marks) - 1)]
        time = jnp.where(found.hit | ~whole, state.time + tau, end)
        new = eqx.tree_at(lambda s: s.time, new, time)
        reason = jnp.where(
            found.overflow, TOO_MANY_CONTACTS, jnp.where(found.stalled, STOPPED_EARLY, turn.reason)
        )
        counts = self.counted(turn.counts, jnp.ones((), bool), tau, error)
        counts = eqx.tree_at(lambda c: c.rejected, counts, counts.rejected + rejected)
        never = jnp.full_like(turn.trouble, -jnp.inf)
        return Turn(
            new, mark, turn.step, following, turn.smooth, never, turn.excess, turn.length, counts, turn.turns,
            reason.astype(jnp.int32),
        )  # fmt: skip

    def short_enough(self, flight: Any, state: State, span: Scalar) -> tuple[Scalar, Array, Array, Scalar]:
        """A flight by one step of a method whose error, by two half steps, is below the tolerance: its length [s], its
        estimated error (n, 2), how many were too long, and the length to begin with next time."""
        order = self.settings.method.order
        floor = self.floor(state)

        def error_of(span: Scalar) -> Array:
            half = flight.after(flight.after(state, 0.5 * span), 0.5 * span)
            return difference(flight.after(state, span), half)

        def excess_of(error: Array) -> Scalar:
            excess = jnp.max(error) / self.settings.tolerance
            return jnp.where(jnp.isfinite(excess), excess, 1e12)

        def going(carry: Any) -> Array:
            count, span, error = carry
            return (excess_of(error) > 1.0) & (span > floor) & (count < _HALVINGS)

        def shorter(carry: Any) -> Any:
            count, span, error = carry
            span = span * jnp.clip((_AIM / excess_of(error)) ** (1.0 / (order + 1)), 0.1, 0.5)
            return count + 1, span, error_of(span)

        count, span, error = lax.while_loop(going, shorter, (jnp.zeros((), jnp.int32), span, error_of(span)))
        small = jnp.maximum(excess_of(error), 1e-12)
        following = span * jnp.clip((_AIM / small) ** (1.0 / (order + 1)), _SHRINK, _GROW)
        return span, error, count, jnp.minimum(following, self.settings.longest)
