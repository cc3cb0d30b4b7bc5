"""Bodies in contact that cannot move in every way: what holds or drives them takes up any impulse.

What is left of an impulse is its projection onto the motions that the body can make. Masses and inertias of restricted
bodies are such (`body/freedom.py`) that the projection goes before M⁻¹ as well as after it.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.freedom import AXES, FREE, Freedom, angular_mask, linear_mask
from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.problem import Problem, motion_of, of_masses
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.vector import cross

# Of what a free body would answer along the normal, what is nothing but round-off: squares of 4 eps.
_ROUND_OFF = 16


def held(problem: Problem, dynamics: Any, pose: State, old: State, free: State, dt: Scalar) -> Problem:
    """A problem of bodies that are not all free, as if they were, made one that knows what they can do. `pose`: where
    its inertias were taken."""
    allowed = allowed_motions(dynamics.freedoms, pose)
    there = jnp.any(jnp.asarray(linear_mask(dynamics.freedoms)), axis=1)
    inverse_mass = jnp.where(there, problem.inverse_mass, 0.0)
    inverse = allowed[:, 3:, 3:] @ problem.inverse_inertia
    whole = of_masses(problem.inverse_mass, problem.inverse_inertia)
    open_ = movable(problem.contacts, allowed @ whole, whole)
    # A rate about a bearing is no response to its own momentum: that of what is driven is its driver's.
    motion = driven_motion(motion_of(free), dynamics.driven, old, free, dt)
    restricted = np.array([freedom != FREE for freedom in dynamics.freedoms])[:, None]
    return eqx.tree_at(
        lambda p: (p.contacts.active, p.inverse_mass, p.inverse_inertia, p.free, p.allowed),
        problem,
        (
            problem.contacts.active & open_,
            inverse_mass,
            inverse,
            jnp.where(restricted, motion, problem.free),
            allowed,
        ),
        is_leaf=lambda leaf: leaf is None,
    )


def turning(dynamics: Any, vector: Vector) -> Vector:
    """Rotations or rates (n, 3) in B without the components that cannot be."""
    return vector if dynamics.freedoms is None else jnp.where(angular_mask(dynamics.freedoms), vector, 0.0)


def allowed_motions(freedoms: Sequence[Freedom], state: State) -> Array:
    """Projectors (n, 6, 6) onto the motions (v, ω) in W that bodies of these freedoms can make."""
    axes = state.orientation.rotate(jnp.asarray(angular_mask(freedoms), state.dtype))
    about_any = np.array([freedom.angular == AXES for freedom in freedoms])[:, None, None]
    turning = jnp.where(about_any, jnp.eye(3, dtype=axes.dtype), axes[:, :, None] * axes[:, None, :])
    straight = jnp.asarray(linear_mask(freedoms), axes.dtype)[:, :, None] * jnp.eye(3, dtype=axes.dtype)
    none = jnp.zeros_like(straight)
    rows = [jnp.concatenate(row, axis=2) for row in ((straight, none), (none, turning))]
    return jnp.concatenate(rows, axis=1)


def movable(contacts: Contacts, answers: Array, whole: Array) -> Array:
    """Which points (k, s) can be pushed open: by bodies that answer impulses by `answers` (n, 6, 6), if they were free
    by `whole`. No impulse along a normal moves what is held along it."""
    eps = jnp.finfo(whole.dtype).eps
    open_ = _along_normal(contacts, answers) > _ROUND_OFF * eps * _along_normal(contacts, whole)
    return contacts.at_points(open_, jnp.any(contacts.at_points(contacts.active & open_, False), axis=1))


def _along_normal(contacts: Contacts, answers: Array) -> Scalar:
    """n · J A Jᵀ n (k, s) [1/kg]."""
    pushed, back = contacts.incidence.take(answers.reshape(len(answers), 36))
    found = _quadratic(pushed, contacts.lever, contacts.normal)
    if back is None or contacts.lever_back is None:
        return found
    return found.at[contacts.lone :].add(
        _quadratic(back, contacts.lever_back, contacts.normal[contacts.lone :])
    )


def _quadratic(answers: Array, lever: Vector, normal: Vector) -> Scalar:
    across = jnp.broadcast_to(normal[:, None], lever.shape)
    push = jnp.concatenate([across, cross(lever, across)], axis=-1)
    return jnp.einsum("ksi,kij,ksj->ks", push, answers.reshape(-1, 6, 6), push)


def driven_motion(motion: Array, driven: Sequence[Any], old: State, free: State, dt: Scalar) -> Array:
    """Motions (n, 6) in W with driven bodies' own: steadily from where they begin the step to where they end it, so
    that what rests on them goes where they go."""
    for driver in driven:
        i = driver.body
        before, after = (jax.tree.map(lambda leaf, i=i: leaf[i], s.orientation) for s in (old, free))
        turned = before.rotate((before.inverse() @ after).log())
        way = jnp.concatenate([free.position[i] - old.position[i], turned])
        motion = motion.at[i].set(way / dt)
    return motion
