"""When bodies in flight first touch: conservative advancement, then Newton's method to round-off.

Along the normal of a pair, held fixed, the gap between the corners of the one and those of the other falls no faster
than known speeds, gravity and bounds on the curvature of their paths allow. The step to where it could first close is
safe, and for balls and for what does not turn it is the root itself (Mirtich 1996, "Impulse-based dynamic simulation",
chapter 3, with a bound of second order). Near the root Newton's method on the distance of the points of contact ends
it.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.detection import Detected, detect
from jaxrb.contact.problem import motion_of
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.safe import divide, norm
from jaxrb.math.vector import dot
from jaxrb.scene.events_corners import Corners, sides_of
from jaxrb.scene.events_flight import Bounds, Flight

_ROUNDS = 400
_POLISH = 4


class Scale(eqx.Module):
    """What counts as touching: `level` [m], to which gaps are advanced; `near` [m], below which Newton takes over;
    `round_off` [m]; and `slow` [m/s], closing more slowly than which is no impact of its own."""

    level: Scalar
    near: Scalar
    round_off: Scalar
    slow: Scalar


class Found(eqx.Module):
    """`tau` [s] of the first impact and whether there is one (`hit`); `stalled`: the search came to no end;
    `overflow`."""

    tau: Scalar
    hit: Array
    stalled: Array
    overflow: Array


def touching(contact: Any, state: State, reach: Array) -> Detected:
    """The contacts of a state."""
    return detect(contact.rules, contact.kinds, contact.obstacles, contact.meetings, state, reach, None)


def scale_of(contact: Any, state: State, bounds: Bounds) -> Scale:
    """Tolerances by round-off of where bodies are and how fast they move."""
    eps = float(jnp.finfo(state.dtype).eps)
    size = jnp.max(contact.radius) + jnp.max(jnp.abs(state.position))
    fastest = jnp.max(norm(state.velocity) + bounds.spin * contact.radius)
    share = 1e-9 if jnp.finfo(state.dtype).bits == 64 else 1e-4
    return Scale(16 * eps * size, eps**0.5 * size, 2 * eps * size, share * fastest)


def first_impact(
    contact: Any, corners: Corners, flight: Flight, state: State, horizon: Scalar, reach: Array
) -> tuple[Found, Scale]:
    """The first impact within `horizon` [s]. Constants to derivatives: the caller puts the time's own back."""
    contact, corners, flight, state, horizon, reach = lax.stop_gradient(
        (contact, corners, flight, state, horizon, reach)
    )
    bounds = flight.bounds(state, horizon)
    scale = scale_of(contact, state, bounds)

    def going(carry: Any) -> Any:
        count, _, _, hit, over, _ = carry
        return (count < _ROUNDS) & ~hit & ~over

    def closer(carry: Any) -> Any:
        count, tau, polished, _, _, overflow = carry
        now = flight.after(state, tau)
        detected = touching(contact, now, reach)
        c = detected.contacts
        rate = dot(c.relative_velocity(motion_of(now)), c.normal[:, None])
        step, bend = _safe_step(corners, bounds, scale, contact.radius, now, c, rate)
        ripe = _ripe(c, rate, scale, bend)
        toward = jnp.min(jnp.where(ripe, divide(c.distance, -rate), jnp.inf))
        off = jnp.min(jnp.where(ripe, c.distance, jnp.inf))
        any_ripe = jnp.any(ripe)
        hit = any_ripe & ((jnp.abs(off) <= scale.round_off) | (polished >= _POLISH))
        ahead = tau + jnp.where(any_ripe, toward, step)
        over = ~any_ripe & (tau >= horizon)
        new = jnp.where(hit | over, tau, jnp.clip(ahead, 0.0, horizon))
        return count + 1, new, polished + any_ripe, hit, over, overflow | detected.overflow

    none, no = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
    carry = (none, jnp.zeros_like(horizon), none, no, no, no)
    _, tau, _, hit, over, overflow = lax.while_loop(going, closer, carry)
    return Found(tau, hit, ~hit & ~over, overflow), scale


def _ripe(c: Contacts, rate: Scalar, scale: Scale, bend: Scalar) -> Array:
    """Points (k, s) so near and closing that Newton's method may end the search."""
    closing = c.active & (rate < -scale.slow)
    touches = c.distance <= 2 * scale.level
    # The parabola's curvature is small against the speed with which they meet.
    soon = (c.distance <= scale.near) & (c.distance * bend[:, None] <= 1e-4 * rate * rate)
    sinking = c.active & (rate < 0) & (c.distance <= -0.5 * scale.level)
    return (closing & (touches | soon)) | sinking


def _safe_step(
    corners: Corners,
    bounds: Bounds,
    scale: Scale,
    radius: Scalar,
    state: State,
    c: Contacts,
    rate: Scalar,
) -> tuple[Scalar, Scalar]:
    """For how long no pair can close, and the bend (k,) [m/s²] of the paths of each."""
    reach = jnp.where(np.asarray(corners.followed), jnp.max(norm(corners.bodies), axis=1), radius)
    sides = sides_of(corners, bounds, reach, state, c)
    normal = c.normal
    pulled = sides.excess - dot(normal, sides.acceleration)
    low, low_rate, high, high_rate = (
        dot(normal[:, None], x) for x in (sides.low, sides.low_velocity, sides.high, sides.high_velocity)
    )
    gap = low[:, :, None] - high[:, None, :] - sides.rounding[:, None, None]
    speed = low_rate[:, :, None] - high_rate[:, None, :]
    curve = sides.low_bend[:, :, None] + sides.high_bend[:, None, :] + pulled[:, None, None]
    by_corners = jnp.min(_root(gap, speed, curve, scale.level), axis=(1, 2))
    there = jnp.any(c.active, axis=1)
    nearest = jnp.min(jnp.where(c.active, c.distance, jnp.inf), axis=1)
    slowest = dot(normal, sides.velocity) - sides.sweep
    by_speed = _root(jnp.where(there, nearest, 1.0), slowest, pulled, scale.level)
    time = jnp.where(sides.followed, by_corners, by_speed)
    bend = jnp.abs(dot(normal, sides.acceleration)) + sides.excess + sides.whirl
    # Points that touch and part are safe until their own path bends back; the next look sees what else there is.
    parts = c.active & (c.distance <= scale.near)
    least = jnp.min(jnp.where(parts, rate, jnp.inf), axis=1)
    leaving = jnp.any(parts, axis=1) & (least > scale.slow)
    parting = jnp.where(leaving, 0.1 * divide(jnp.where(leaving, least, 0.0), bend), 0.0)
    return jnp.min(jnp.where(there, jnp.maximum(time, parting), jnp.inf), initial=jnp.inf), bend


def _root(gap: Scalar, speed: Scalar, curve: Scalar, level: Scalar) -> Scalar:
    """The first time at which gap + speed t − ½ curve t² has fallen to −level; infinite where it never does."""
    # What is deeper already is taken to be half a level above, so that every step is one.
    gap = jnp.maximum(gap + level, 0.5 * level)
    square = speed * speed + 2.0 * curve * gap
    real = square > 0
    root = jnp.sqrt(jnp.where(real, square, 1.0))
    down = speed < 0
    # Of the two forms of the root the one that does not cancel.
    denominator = jnp.where(down, root - speed, curve)
    usable = real & (down | (curve > 0))
    ahead = jnp.where(down, 2.0 * gap, speed + root)
    return jnp.where(usable, ahead / jnp.where(usable, denominator, 1.0), jnp.inf)
