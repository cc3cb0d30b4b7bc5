"""Points of contact as the adaptive step sees them: which are closed, which meet, what keeps them closed."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.detection import Detected, detect
from jaxrb.contact.impact import impact_scale
from jaxrb.contact.linear import conjugate_gradients
from jaxrb.contact.memory import Memory, recalled, remembered
from jaxrb.contact.newton import compliance
from jaxrb.contact.problem import Problem, motion_of, world_inertia
from jaxrb.contact.solver import solve_contacts
from jaxrb.effects.dynamics import Dynamics
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.safe import divide, norm
from jaxrb.math.vector import dot

# Of the matrix of the closed points, so that points which share a load have one answer.
_SHARED = {64: 1e-10, 32: 1e-5}
_PRODUCTS = 24
_SAMPLES, _HALVINGS = 16, 12
_FEW = 16  # points of a scene whose impulses are polished
_NEARLY = 1e-2
_AMPLIFIED = 200.0  # by the weights of extrapolation, and as turning


class Levels(eqx.Module):
    """What counts as what at a tolerance: `gap` [m], nearer than which points are closed; `resting` [m/s], meeting more
    slowly than which nothing bounces (but without loss); `meeting` [m/s], above which a closed point is an impact."""

    gap: Scalar
    resting: Scalar
    meeting: Scalar


class Points(eqx.Module):
    """The points of a state: `contacts`, `rate` (k, s) [m/s] along the normal, `closed` (k, s), `held` (k, s): closed
    and not leaving; `hit`: closed and meeting. `chosen`, `overflow`: as of `Detected`."""

    contacts: Contacts
    rate: Scalar
    closed: Array
    held: Array
    hit: Array
    chosen: tuple[Array, ...]
    overflow: Array

    def memory(self) -> Memory:
        """Distance, rate and `held` of each point, by the name of the point, to be recalled later on."""
        return remembered(self.contacts, self.chosen, self.noted())

    def noted(self) -> Array:
        """What `memory` keeps (k, s, 3)."""
        held = self.held.astype(self.rate.dtype)
        return jnp.stack([self.contacts.distance, self.rate, held], axis=-1)


def looked_at(contact: Any, state: State, reach: Array, memory: Memory | None = None) -> Detected:
    """The contacts of a state; `start` is what `memory` knows of them."""
    return detect(contact.rules, contact.kinds, contact.obstacles, contact.meetings, state, reach, memory)


def points_of(contact: Any, state: State, reach: Array, levels: Levels) -> Points:
    """The points of a state that may touch."""
    found = looked_at(contact, state, reach)
    c = found.contacts
    rate = rates_of(c, state)
    closed = c.active & (c.distance <= levels.gap)
    held = closed & (rate <= levels.resting)
    return Points(c, rate, closed, held, closed & (rate < -levels.meeting), found.chosen, found.overflow)


def rates_of(c: Contacts, state: State) -> Scalar:
    """Velocity (k, s) [m/s] of each point along its normal; negative where it closes."""
    return dot(c.relative_velocity(motion_of(state)), c.normal[:, None])


def reach_of(contact: Any, state: State, span: Scalar) -> Scalar:
    """How far (n,) [m] any point of each body may come in `span` [s]; infinite where every pair is looked at."""
    if all(len(meeting.first) <= meeting.touching for meeting in contact.meetings):
        return jnp.full(contact.count, jnp.inf, state.dtype)
    speed = norm(state.velocity) + norm(state.angular_velocity) * contact.radius
    return 1.5 * span * speed + 0.05 * contact.radius


def problem_of(dynamics: Dynamics, state: State, c: Contacts, bias: Scalar, motion: Array) -> Problem:
    """The contact problem at a state for bodies that move with `motion` (n, 6)."""
    inertia, inverse = world_inertia(dynamics, state.orientation)
    share = 1e-12 if jnp.finfo(state.dtype).bits == 64 else 1e-6
    return Problem(
        c, bias, dynamics.bodies.mass, inertia, dynamics.inverse_mass, inverse, motion,
        jnp.asarray(share, state.dtype),
    )  # fmt: skip


def polished(problem: Problem, impulse: Array) -> Array:
    """Impulses (k, s, 3) of a solve without the round-off that its compliance makes of velocities.

    That is 1e-10 m/s, more than a step of a microsecond changes: the error of a short step would never fall below the
    tolerance. Of scenes with many points it is left, and `noise_of` tells.
    """
    c, shape = problem.contacts, impulse.shape
    if not _polishes(c):
        return impulse
    # Who presses, sticks and slides is told with a compliance of 1, against which the round-off is nothing.
    velocity = c.relative_velocity(problem.moved_by(impulse))
    wanted = problem.wanted(impulse, velocity, problem.stiffness(1.0))
    normal = jnp.broadcast_to(c.normal[:, None], shape)
    along = dot(wanted, normal)
    pressed = c.active & (along > 0)
    friction = None if c.friction is None else c.friction[:, None]
    slides = pressed
    if friction is not None:
        slides = pressed & (
            norm(wanted - along[..., None] * normal) > friction * jnp.maximum(dot(impulse, normal), 0.0)
        )

    def broken(flat: Array) -> Array:
        """What of the law does not hold, (points · 3,)."""
        own = flat.reshape(shape)
        missing = c.relative_velocity(problem.moved_by(own)) - problem.bias[..., None] * normal
        pressing, leaving = dot(own, normal), dot(missing, normal)
        across, side = own - pressing[..., None] * normal, missing - leaving[..., None] * normal
        if friction is not None:
            across = norm(side)[..., None] * across + (friction * pressing)[..., None] * side
        law = jnp.where(slides[..., None], leaving[..., None] * normal + across, missing)
        return jnp.where(pressed[..., None], law, own).ravel()

    at = impulse.ravel()
    slope = jax.jacfwd(broken)(at)
    # Of several ways to share a load any will do.
    share = _SHARED[jnp.finfo(at.dtype).bits] * 1e-4
    slope = slope + share * jnp.max(jnp.abs(slope)) * jnp.eye(len(at), dtype=at.dtype)
    step = -jnp.linalg.solve(slope, broken(at))
    found = (at + jnp.where(norm(step) <= _NEARLY * norm(at), step, 0.0)).reshape(shape)
    return jnp.where((pressed & (dot(found, normal) > 0))[..., None], found, 0.0)


def noise_of(c: Contacts, state: State) -> Scalar:
    """What a solve leaves of the law [m/s], as the error of an extrapolated step shows it."""
    if _polishes(c):
        return jnp.zeros((), state.dtype)
    eps = float(jnp.finfo(state.dtype).eps)
    return _AMPLIFIED * eps / compliance(state.dtype) * jnp.max(jnp.abs(motion_of(state)))


def _polishes(c: Contacts) -> bool:
    return c.active.size <= _FEW


def with_motion(state: State, motion: Array) -> State:
    """The state with other velocities, (v, ω) (n, 6) in W."""
    return State(
        state.position,
        state.orientation,
        motion[:, :3],
        state.orientation.unrotate(motion[:, 3:]),
        state.time,
    )


def struck(dynamics: Dynamics, state: State, points: Points, levels: Levels) -> State:
    """The state after an impact. Points that bounce do so alone, as a blow runs through a row of bodies; where none
    does, all closed points take the blow together."""
    c = points.contacts
    e = jnp.zeros_like(points.rate) if c.restitution is None else c.restitution[:, None]
    fast = points.hit & (e > 0) & ((-points.rate >= levels.resting) | (e >= 1))
    bounces = jnp.any(fast)
    bias = jnp.where(fast & bounces, -e * points.rate, 0.0)
    own = eqx.tree_at(lambda k: k.active, c, jnp.where(bounces, fast, points.closed))
    motion = motion_of(state)
    problem = problem_of(dynamics, state, own, bias, motion)
    found = solve_contacts(problem, jnp.zeros((*own.active.shape, 3), state.dtype))
    impulse = polished(problem, found.impulse)
    if c.restitution is not None and c.friction is not None:
        none, one = jnp.zeros_like(points.rate), jnp.ones((), state.dtype)
        impulse = impulse * impact_scale(problem, found, none, motion, motion, one)
    given = problem.contacts.impulse_on_bodies(impulse)
    touched = jnp.any(given != 0, axis=-1)[:, None]
    return with_motion(state, jnp.where(touched, problem.moved_by(impulse), motion))


def kept_closed(dynamics: Dynamics, state: State, c: Contacts, pressed: Array, target: Scalar) -> State:
    """The state nearest in the metric of the masses whose pressed points are `target` (k, s) [m] apart and stay so.

    Extrapolated states miss this by the error of the step; a miss that is left would be an impact in the next.
    """
    normal = jnp.where(pressed, 1.0, 0.0)[..., None] * c.normal[:, None]
    own = eqx.tree_at(lambda k: k.active, c, pressed)
    problem = problem_of(dynamics, state, own, c.distance, motion_of(state))

    def response(impulse: Scalar) -> Array:
        return problem.response(c.impulse_on_bodies(impulse[..., None] * normal))

    def along(motion: Array) -> Scalar:
        return dot(c.relative_velocity(motion), normal)

    # Each point's own mobility on the mean, a scale to precondition with and to tell of points that share a load.
    scale = divide(jnp.ones_like(target), problem.stiffness(1.0))
    small = _SHARED[jnp.finfo(state.dtype).bits]

    def corrected(missing: Scalar) -> Array:
        found, _ = conjugate_gradients(
            lambda p: along(response(p)) + small * scale * p,
            lambda r: divide(r, scale),
            jnp.where(pressed, missing, 0.0),
            tolerance=small,
            most=_PRODUCTS,
        )
        return response(found)

    shift = corrected(target - c.distance)
    jump = corrected(-along(motion_of(state)))
    turn = state.orientation.unrotate(shift[:, 3:])
    moved = State(
        state.position + shift[:, :3],
        (state.orientation @ type(state.orientation).exp(turn)).renormalise(),
        state.velocity,
        state.angular_velocity,
        state.time,
    )
    return with_motion(moved, motion_of(state) + jump)


def first_closing(start: Array, c: Contacts, rate: Scalar, span: Scalar, level: Scalar) -> Scalar:
    """When in (0, span] [s] the first open point comes `level` [m] below touch, by the cubic through distances and
    rates at both ends; infinite where none does. `start` (k, s, 3) is what was `noted` of the points at the start."""
    before, speed, held = start[..., 0], start[..., 1], start[..., 2] > 0
    known = jnp.any(start != 0, axis=-1)
    # A point that was not there at the start is followed back from the end.
    before = jnp.where(known, before, c.distance - span * rate)
    speed = jnp.where(known, speed, rate)
    floor = jnp.minimum(before, 0.0)
    open_ = c.active & ~held

    def gap(share: Any) -> Scalar:
        a, b = before - floor, span * speed
        d, e = c.distance - floor, span * rate
        s = share
        return (
            (1 + 2 * s) * (1 - s) ** 2 * a
            + s * (1 - s) ** 2 * b
            + s * s * (3 - 2 * s) * d
            - s * s * (1 - s) * e
        )

    shares = jnp.arange(1, _SAMPLES + 1, dtype=rate.dtype) / _SAMPLES
    below = jnp.stack([gap(s) < -level for s in shares])
    met = open_ & jnp.any(below, axis=0)
    high = shares[jnp.argmax(below, axis=0)]
    low = high - 1.0 / _SAMPLES

    def halved(_: Any, ends: tuple) -> tuple:
        low, high = ends
        at_low, at_high = gap(low), gap(high)
        # Regula falsi with a bisection every round: both ends come near.
        share = low + (high - low) * jnp.clip(divide(at_low, at_low - at_high), 0.02, 0.98)
        low, high = jnp.where(gap(share) < 0, low, share), jnp.where(gap(share) < 0, share, high)
        middle = 0.5 * (low + high)
        return jnp.where(gap(middle) < 0, low, middle), jnp.where(gap(middle) < 0, middle, high)

    low, high = lax.fori_loop(0, _HALVINGS, halved, (low, high))
    return span * jnp.min(jnp.where(met, high, jnp.inf), initial=jnp.inf)


def recalled_by(found: Detected, memory: Memory) -> Array:
    """What a memory knows of the points found (k, s, 3)."""
    return recalled(found.contacts, found.chosen, memory)
