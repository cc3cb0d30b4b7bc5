"""An impact at its own time: Newton's restitution along the normals, Coulomb's friction across them.

All points that close at this time share one solve; those that merely touch take no part, so that a blow runs through a
row of bodies one after the other and the last of a cradle leaves.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.impact import impact_scale
from jaxrb.contact.implicit import solve
from jaxrb.contact.problem import Problem, motion_of, world_inertia
from jaxrb.contact.solver import solve_contacts
from jaxrb.effects.dynamics import Dynamics
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide, norm
from jaxrb.math.vector import cross, dot, matvec
from jaxrb.scene.events_search import Scale

# The solve ends where round-off of velocities, seen through its compliance, hides what is left. Of few points (slots of
# the whole scene) a dense step of Newton's method ends it, 0.3 s of compiling where the solve's own derivative takes 4;
# of many, sweeps over the points.
_FEW = 16
_SWEEPS = 3
_SHARED = {64: 1e-14, 32: 1e-6}
_NEARLY = 1e-2


class Blow(eqx.Module):
    """What one impact did: `pair` (2,) the body that was pushed and the other (−1 what stands still), the `point`
    (3,) [m]
    and the `impulse` (3,) [N s] on the pushed one, of the strongest of its `points`; `slow`: all met more slowly than a
    bounce."""

    pair: Array
    point: Vector
    impulse: Vector
    points: Array
    slow: Array


def hits(c: Contacts, rate: Scalar, scale: Scale) -> Array:
    """The points (k, s) that meet now."""
    least = jnp.min(jnp.where(c.active & (rate < -scale.slow), c.distance, jnp.inf))
    sinking = jnp.min(jnp.where(c.active & (rate < 0), c.distance, jnp.inf))
    near = 4 * scale.level
    fast = c.active & (rate < -scale.slow) & (c.distance <= near)
    any_fast = jnp.any(fast)
    # Where the search had to end away from touch, the nearest is meant.
    reach = jnp.maximum(near, jnp.where(jnp.isfinite(least), least, sinking) + scale.level)
    closing = c.active & (c.distance <= reach)
    return jnp.where(any_fast, fast, closing & (rate < 0))


def struck(
    dynamics: Dynamics, state: State, c: Contacts, scale: Scale, resting_speed: Scalar
) -> tuple[State, Blow]:
    """The state after the impact of the points that meet."""
    motion = motion_of(state)
    rate = dot(c.relative_velocity(motion), c.normal[:, None])
    hit = lax.stop_gradient(hits(c, rate, scale))
    e = jnp.zeros_like(c.distance[:, :1]) if c.restitution is None else c.restitution[:, None]
    slow = (-rate < resting_speed) & (e < 1)
    problem = _problem(dynamics, state, eqx.tree_at(lambda k: k.active, c, hit), motion)
    problem = eqx.tree_at(lambda p: p.bias, problem, jnp.where(slow, 0.0, -e * rate))
    start = jnp.zeros((*hit.shape, 3), state.dtype)
    if hit.size <= _FEW:
        found = lax.stop_gradient(solve_contacts(lax.stop_gradient(problem), start))
        impulse = _by_law(problem, found.impulse)
    else:
        found = solve(problem, start)
        impulse = _swept(problem, found.impulse)
    if c.friction is not None:
        one = jnp.ones((), state.dtype)
        impulse = impulse * impact_scale(problem, found, jnp.zeros_like(rate), motion, motion, one)
    new = problem.moved_by(impulse)
    touched = jnp.any(problem.contacts.impulse_on_bodies(impulse) != 0, axis=-1)[:, None]
    spin = state.orientation.unrotate(new[:, 3:])
    after = State(
        state.position,
        state.orientation,
        jnp.where(touched, new[:, :3], state.velocity),
        jnp.where(touched, spin, state.angular_velocity),
        state.time,
    )
    return after, _blow(state, problem.contacts, impulse, hit, slow)


def _problem(dynamics: Dynamics, state: State, c: Contacts, motion: Array) -> Problem:
    inertia, inverse = world_inertia(dynamics, state.orientation)
    tolerance = jnp.finfo(state.dtype).eps.astype(state.dtype)
    return Problem(
        c, c.distance, dynamics.bodies.mass, inertia, dynamics.inverse_mass, inverse, motion, tolerance
    )


def _by_law(problem: Problem, impulse: Vector) -> Vector:
    """One step of Newton's method on the law itself from impulses that fulfil it nearly.

    Its derivative is that of the implicit function theorem, with no compliance in it: where points do not share a load
    it is right to round-off, where they do the motion's is.
    """
    c, shape, dtype = problem.contacts, impulse.shape, impulse.dtype
    normal = c.normal[:, None]
    start = lax.stop_gradient(_swept(problem, impulse))
    pressing = dot(start, normal)
    pressed = c.active & (pressing > 0)
    # Where the solve saw nothing but its round-off there is a push and no friction.
    weak = pressed & (dot(impulse, normal) <= 0)
    slides = pressed
    if c.friction is not None:
        share = 1e-6 if jnp.finfo(dtype).bits == 64 else 1e-3
        side = norm(start - pressing[..., None] * normal)
        slides = pressed & (weak | (side >= (1 - share) * lax.stop_gradient(c.friction[:, None]) * pressing))

    def broken(flat: Array, problem: Problem) -> Array:
        """What of the law does not hold, (points · 3,)."""
        own, impulse = problem.contacts, flat.reshape(shape)
        n = own.normal[:, None]
        velocity = own.relative_velocity(problem.moved_by(impulse))
        missing = velocity - problem.bias[..., None] * n
        across = impulse - dot(impulse, n)[..., None] * n
        if own.friction is not None:
            side = missing - dot(missing, n)[..., None] * n
            pressing = own.friction[:, None] * dot(impulse, n)
            rubbed = norm(side)[..., None] * across + pressing[..., None] * side
            across = jnp.where(weak[..., None], across, rubbed)
        sliding = dot(missing, n)[..., None] * n + across
        law = jnp.where(slides[..., None], sliding, missing)
        return jnp.where(pressed[..., None], law, impulse).ravel()

    at = start.ravel()
    slope = lax.stop_gradient(jax.jacfwd(broken)(at, lax.stop_gradient(problem)))
    # Of several ways to share a load any will do.
    slope = slope + _SHARED[jnp.finfo(dtype).bits] * jnp.max(jnp.abs(slope)) * jnp.eye(len(at), dtype=dtype)
    step = -jnp.linalg.solve(slope, broken(at, problem))
    # It ends what the solve began; a step that goes far is for the derivative only.
    small = norm(step) <= _NEARLY * norm(at)
    return (at + step - jnp.where(small, 0.0, lax.stop_gradient(step))).reshape(shape)


def _swept(problem: Problem, impulse: Vector) -> Vector:
    """Impulses whose normal parts leave exactly the velocities asked for, where points do not depend on each other."""
    c = problem.contacts
    normal = c.normal[:, None]
    inverse = jnp.concatenate([problem.inverse_mass[:, None], problem.inverse_inertia.reshape(-1, 9)], axis=1)
    pushed, back = c.incidence.take(inverse)
    mobility = _mobility(pushed, c.lever, normal)
    if back is not None and c.lever_back is not None:
        mobility = mobility.at[c.lone :].add(_mobility(back, c.lever_back, normal[c.lone :]))
    # Points that share a body share the correction too.
    points = jnp.sum(c.active, axis=1, keepdims=True).astype(impulse.dtype)
    on_bodies = c.incidence.give(points, None if back is None else points[c.lone :])
    most, most_back = c.incidence.take(on_bodies)
    if most_back is not None:
        most = most.at[c.lone :].max(most_back)
    rate = divide(c.active.astype(impulse.dtype), mobility * most)
    for _ in range(_SWEEPS):
        velocity = dot(c.relative_velocity(problem.moved_by(impulse)), normal)
        along = dot(impulse, normal)
        more = jnp.maximum(rate * (problem.bias - velocity), -along)
        impulse = impulse + jnp.where(c.active, more, 0.0)[..., None] * normal
    return impulse


def _mobility(inverse: Array, lever: Vector, normal: Vector) -> Scalar:
    """n · J M⁻¹ Jᵀ n (k, s) [1/kg]."""
    arm = cross(lever, jnp.broadcast_to(normal, lever.shape))
    tensor = inverse[:, None, 1:].reshape(len(inverse), 1, 3, 3)
    return inverse[:, :1] + dot(arm, matvec(tensor, arm))


def _blow(state: State, c: Contacts, impulse: Vector, hit: Array, slow: Array) -> Blow:
    strength = lax.stop_gradient(jnp.where(hit, norm(impulse), -1.0))
    at = jnp.argmax(strength)
    block, slot = at // strength.shape[1], at % strength.shape[1]
    lone = jnp.asarray(c.incidence.lone, jnp.int32)
    pushed = jnp.concatenate([lone, c.incidence.second])[block]
    other = jnp.concatenate([jnp.full_like(lone, -1), c.incidence.first])[block]
    point = state.position[jnp.minimum(pushed, len(state.position) - 1)] + c.lever[block, slot]
    pair = jnp.stack([pushed, other]).astype(jnp.int32)
    count = jnp.sum(hit, dtype=jnp.int32)
    return Blow(pair, point, impulse[block, slot], count, jnp.all(jnp.where(hit, slow, True)))
