"""What a contact solve gives, and what it is measured by."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxrb.contact.problem import Problem
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide
from jaxrb.math.vector import dot

POOR = 1e-2  # residual over what contact takes away from which on a solve is called poor


def default_tolerance(dtype: Any) -> float:
    """Of the answer, relative to the largest velocity that contact takes away: what a type reaches, with room."""
    return 1e-8 if jnp.finfo(dtype).bits == 64 else 1e-4


def crowd_tolerance(dtype: Any) -> float:
    """The same of a crowd, whose solve converges slowly (`contact/sparse.py`)."""
    return 1e-4 if jnp.finfo(dtype).bits == 64 else 3e-3


class Solution(eqx.Module):
    """`motion` (n, 6), `impulse` (k, s, 3) [N s] in W, and how it went.

    `residual` [m/s]: how far the impulses are from the law, as a velocity; `poor`: whether that is above 1 % of what it
    takes away. `newton_steps` and `products` of the system's matrix: how many were taken, of bodies that
    know nothing of each other by the one that took most.
    """

    motion: Array
    impulse: Vector
    residual: Scalar
    poor: Array
    newton_steps: Array
    products: Array


def no_contact(problem: Problem, start: Vector) -> Solution:
    """The solution where the free motion breaks no law."""
    none = jnp.zeros((), jnp.int32)
    free = problem.free
    return Solution(free, jnp.zeros_like(start), jnp.zeros((), free.dtype), jnp.zeros((), bool), none, none)


def passive_share(problem: Problem, impulse: Vector) -> Scalar:
    """The share of impulses that may be given so that they do no work at the end: where no solution was found."""
    c = problem.contacts
    given = c.impulse_on_bodies(impulse)
    taken, moved = -jnp.sum(given * problem.free), jnp.sum(given * problem.response(given))
    return jnp.clip(divide(taken, moved), 0.0, 1.0)


def speed_to_take(problem: Problem, motion: Array) -> Scalar:
    """The largest velocity [m/s] along a normal that the law takes from a motion (n, 6).

    Not the speed of sliding: friction takes no more than about μ times this, however fast a body slides.
    """
    c = problem.contacts
    missing = c.at_points(problem.bias - dot(c.relative_velocity(motion), c.normal[:, None]), 0.0)
    return jnp.max(jnp.where(c.active, missing, 0.0), initial=0.0)
