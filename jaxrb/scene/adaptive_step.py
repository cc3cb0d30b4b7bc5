"""One step of contact of high order: the half-explicit Euler method, extrapolated.

Bodies move with the velocity they have, then get the velocity that forces and contact leave them, with the points of
contact where they are *after* the move: its error has an expansion in powers of the step as long as no point opens,
closes, sticks or slips anew, so runs of 1, 2, … k equal substeps extrapolate to order k (Aitken and Neville; for
constraints Lubich 1989, "h²-extrapolation methods for differential-algebraic systems of index 2", and Lubich, Nowak,
Pöhle, Engstler 1992, "MEXX"). The runs are the lanes of one program. Which of the closed points press, stick or slip is
not asked: the contact solve finds out in every substep.

The step of `rollout`, extrapolated, is of order 2 at most where bodies roll or topple: it looks at the points before
the move and closes gaps by speed, so a run of one substep errs otherwise than all that are longer.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.memory import Memory, remembered
from jaxrb.contact.problem import motion_of
from jaxrb.contact.solver import solve_contacts
from jaxrb.effects.dynamics import Dynamics
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.safe import norm
from jaxrb.math.vector import dot
from jaxrb.scene.adaptive_points import (
    Levels,
    Points,
    first_closing,
    kept_closed,
    looked_at,
    noise_of,
    polished,
    problem_of,
    rates_of,
    reach_of,
    recalled_by,
    with_motion,
)

# The first look at a step: so short a part of it that nothing switches within, but [s] long enough that the solve's
# round-off of velocities does not hide what forces change.
_PROBE, _LEAST_PROBE = 1e-4, {64: 1e-6, 32: 1e-3}
_AT_BOUND = 1e-5  # friction within this share of its limit slides


class Trial(eqx.Module):
    """A step that was tried: the `state` after it; the estimated `error` (n, 2) of position and velocity [m, m/s] and
    of attitude and angular velocity [rad, rad/s], the larger of each; `noise`: how much of it may be the solve's
    round-off; `meets` [s]: when the first open point closed; `slips` [s]: when the first point that slides would stop;
    `overflow`."""

    state: State
    error: Array
    noise: Scalar
    meets: Scalar
    slips: Scalar
    overflow: Array


class Look(eqx.Module):
    """What the first substep of a run saw of each point (k, s): `feature`, whether it `pushes` and `slides`, its
    velocity across before (`slip`) and after (`slid`) (k, s, 3) [m/s]; and the bodies' `rate` (n, 6) [m/s², rad/s²]."""

    feature: Array
    pushes: Array
    slides: Array
    slip: Array
    slid: Array
    rate: Array


def weights(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (order,) of runs of 1, 2, … substeps in the value of that order, and in that of one order less."""

    def of(counts: list[int]) -> list[float]:
        return [math.prod(n / (n - m) for m in counts if m != n) for n in counts]

    counts = list(range(1, order + 1))
    return np.array(of(counts)), np.array([0.0, *of(counts[1:])])


def tried(
    dynamics: Dynamics, state: State, points: Points, span: Scalar, levels: Levels, order: int
) -> Trial:
    """A step of `span` [s] with the points that are held at its start."""
    contact = dynamics.contact
    reach = reach_of(contact, state, span)
    memory = points.memory()
    # The first lane is a single substep, a short one.
    counts = jnp.asarray([1, *range(1, order + 1)], jnp.int32)
    least = _LEAST_PROBE[jnp.finfo(state.dtype).bits]
    short = jnp.minimum(jnp.maximum(_PROBE * span, least), 0.1 * span)
    spans = jnp.full(order + 1, span).at[0].set(short)
    ends, pressing, overflow, looks = jax.vmap(
        lambda s, n: _substeps(dynamics, state, memory, reach, s, n, order)
    )(spans, counts)
    probe, first = (jax.tree.map(lambda leaf, i=i: leaf[i], looks) for i in (0, order))
    ends = jax.tree.map(lambda leaf: leaf[1:], ends)
    best, lower = (_mixed(ends, w) for w in weights(order))
    slips = _stop(probe, short)
    error = difference(best, lower) + _unseen(probe, first, slips, span / order)
    last = jax.tree.map(lambda leaf: leaf[-1], pressing)
    found = looked_at(contact, best, reach, memory)
    c, start = found.contacts, found.start
    pressed = (recalled_by(found, last)[..., 0] > 0) & c.active
    # What overlapped from the start is left as it is; nothing is repaired in silence.
    target = jnp.where(start[..., 0] < -levels.gap, start[..., 0], 0.0)
    meets = first_closing(start, c, rates_of(c, best), span, levels.gap)
    # A pressed point off the surface is an error of the step: it was held in the air.
    off = jnp.max(jnp.where(pressed, jnp.abs(c.distance - target), 0.0), initial=0.0)
    error = error.at[:, 0].max(off)
    noise = noise_of(c, best)
    new = kept_closed(dynamics, best, c, pressed, target)
    return Trial(
        new, error, noise, meets, jnp.min(slips, initial=jnp.inf), jnp.any(overflow) | found.overflow
    )


def _substeps(
    dynamics: Dynamics, state: State, memory: Memory, reach: Array, span: Scalar, count: Array, most: int
) -> tuple[State, Memory, Array, Look]:
    """The end of a run of `count` substeps, what pressed in the last, and what the first saw."""
    h = span / count.astype(state.dtype)

    def one(i: Any, carry: Any) -> Any:
        new = _substep(dynamics, carry[0], memory, reach, h)
        taken = (i < count, i < count, i < count, i == 0)
        return tuple(
            jax.tree.map(lambda after, before, use=use: jnp.where(use, after, before), n, c)
            for use, n, c in zip(taken, new, carry, strict=True)
        )

    shapes = jax.eval_shape(lambda s: _substep(dynamics, s, memory, reach, h), state)
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes[1:])
    return lax.fori_loop(0, most, one, (state, *nothing))


def _substep(
    dynamics: Dynamics, state: State, memory: Memory, reach: Array, h: Scalar
) -> tuple[State, Memory, Array, Look]:
    now = dynamics.acceleration(state)
    turn = type(state.orientation).exp(h * state.angular_velocity)
    velocity = state.velocity if now.linear is None else state.velocity + h * now.linear
    omega = state.angular_velocity if now.angular is None else state.angular_velocity + h * now.angular
    moved = State(
        state.position + h * state.velocity,
        (state.orientation @ turn).renormalise(),
        velocity,
        omega,
        state.time + h,
    )
    found = looked_at(dynamics.contact, moved, reach, memory)
    held = found.start[..., 2] > 0
    c = eqx.tree_at(lambda k: k.active, found.contacts, found.contacts.active & held)
    motion = jnp.concatenate([velocity, moved.orientation.rotate(omega)], axis=1)
    problem = problem_of(dynamics, moved, c, jnp.zeros_like(c.distance), motion)
    # From nothing, not from the last impulses: how points share a load must not depend on the way here.
    solved = solve_contacts(problem, jnp.zeros((*c.active.shape, 3), state.dtype))
    impulse = polished(problem, solved.impulse)
    after = problem.moved_by(impulse)
    push = dot(impulse, c.normal[:, None])
    pressing = remembered(c, found.chosen, jnp.stack([push, push, push], axis=-1))
    look = _look(c, impulse, push, motion_of(state), after, h)
    return with_motion(moved, after), pressing, found.overflow, look


def _look(c: Contacts, impulse: Array, push: Scalar, before: Array, after: Array, h: Scalar) -> Look:
    pushes = c.active & (push > 1e-6 * jnp.max(push, initial=0.0))
    slides = pushes
    if c.friction is not None:
        across = norm(impulse - push[..., None] * c.normal[:, None])
        slides = pushes & (across >= (1 - _AT_BOUND) * c.friction[:, None] * push)
    feature = jnp.where(c.active, c.feature, -1)
    return Look(feature, pushes, slides, _across(c, before), _across(c, after), (after - before) / h)


def _across(c: Contacts, motion: Array) -> Array:
    """Velocities (k, s, 3) of the points without their part along the normal."""
    velocity = c.relative_velocity(motion)
    return velocity - dot(velocity, c.normal[:, None])[..., None] * c.normal[:, None]


def _stop(probe: Look, h: Scalar) -> Scalar:
    """When (k, s) [s] each sliding point would stop, by its slowing down in the probe; infinite where it does not."""
    before, after = norm(probe.slip), norm(probe.slid)
    slows = probe.slides & (after < before)
    return jnp.where(slows, h * before / jnp.where(slows, before - after, 1.0), jnp.inf)


def _unseen(probe: Look, first: Look, stop: Scalar, h: Scalar) -> Array:
    """The error (n, 2) that extrapolation cannot see: of a switch within the first substep of *all* runs, after which
    they differ by powers of the step as if nothing had been. The probe is before it."""
    same = probe.feature == first.feature
    turns = dot(probe.slid, first.slid) < 0
    stops = same & probe.slides & first.pushes & ~first.slides
    other = (
        same
        & ~stops
        & ((probe.pushes != first.pushes) | (probe.slides != first.slides) | (first.slides & turns))
    )
    # A point that stops is where it would be but for the last of its path.
    path = jnp.max(jnp.where(stops, 0.5 * norm(probe.slip) * jnp.minimum(stop, h), 0.0), initial=0.0)
    gained = jnp.where(jnp.any(other), h, 0.0) * (first.rate - probe.rate)
    return jnp.stack([norm(gained[:, :3]), norm(gained[:, 3:])], axis=-1) + path


def _mixed(ends: State, weight: np.ndarray) -> State:
    """A weighted sum of states (k, …); orientations as turns from the last."""
    last = jax.tree.map(lambda leaf: leaf[-1], ends)

    def added(leaf: Array) -> Array:
        w = jnp.asarray(weight, leaf.dtype)
        return leaf[-1] + jnp.tensordot(w, leaf - leaf[-1], axes=1)

    turns = jax.vmap(lambda r: (last.orientation.inverse() @ r).log())(ends.orientation)
    turn = jnp.tensordot(jnp.asarray(weight, turns.dtype), turns, axes=1)
    return State(
        added(ends.position),
        (last.orientation @ type(last.orientation).exp(turn)).renormalise(),
        added(ends.velocity),
        added(ends.angular_velocity),
        last.time,
    )


def difference(a: State, b: State) -> Array:
    """(n, 2): the larger of position [m] and velocity [m/s], and of attitude [rad] and angular velocity [rad/s]."""
    straight = jnp.maximum(norm(a.position - b.position), norm(a.velocity - b.velocity))
    turn = (a.orientation.inverse() @ b.orientation).log()
    round_ = jnp.maximum(norm(turn), norm(a.angular_velocity - b.angular_velocity))
    return jnp.stack([straight, round_], axis=-1)
