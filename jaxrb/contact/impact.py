"""Impacts with restitution within a step: each at its own time, in rounds, as a blow runs through a row of bodies.

A round takes all points that close within the step at more than a resting contact's speed and gives them −e times the
normal velocity with which they meet (Newton); those that only touch take no part, so that in a cradle the last ball
leaves. Rounds go on until nothing closes (Smith, Kaufman, Vouga, Tamstorf, Grinspun 2012, "Reflections on simultaneous
impact"). The time of an impact is that of the parabola along the normal: under a constant force a bounce then has no
error of the step.
"""

import equinox as eqx
import jax.numpy as jnp

from jaxrb.contact.block import Contacts
from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import Solution
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide, safe_sqrt
from jaxrb.math.vector import dot


class Course(eqx.Module):
    """What contact has done so far in a step.

    `jump` (n, 6): change of (v, ω) in W; `shift` (n, 6): what it has moved by the end of the step, [m] and [rad];
    `impulse` (k, s, 3) [N s] of each point.
    """

    jump: Array
    shift: Array
    impulse: Vector

    def after(self, problem: Problem, found: Solution, weight: Scalar) -> "Course":
        """With the impulses of a solve, each acting for the last `weight` (k, s), or (), [s] of the step."""
        c = problem.contacts
        jump = problem.response(c.impulse_on_bodies(found.impulse))
        if jnp.ndim(weight) == 0:
            shift = weight * jump
        else:
            shift = problem.response(c.impulse_on_bodies(weight[..., None] * found.impulse))
        return Course(self.jump + jump, self.shift + shift, self.impulse + found.impulse)


def first_course(motion: Array, contacts: Contacts) -> Course:
    """Nothing yet."""
    return Course(
        jnp.zeros_like(motion), jnp.zeros_like(motion), jnp.zeros((*contacts.active.shape, 3), motion.dtype)
    )


def closing(problem: Problem, course: Course, start: Array, dt: Scalar) -> tuple[Array, Scalar, Scalar]:
    """Which points (k, s) hit, the normal velocity that they must at least have at the end, and the time left then.

    `start` (n, 6) is the motion at the start of the step.
    """
    c = problem.contacts
    normal = c.normal[:, None]
    begin = dot(c.relative_velocity(start + course.jump), normal)
    acceleration = dot(c.relative_velocity(problem.free - start), normal) / dt
    gap = c.distance + dot(c.relative_velocity(course.shift - dt * course.jump), normal)
    gap = jnp.maximum(gap, 0.0)
    square = begin * begin - 2.0 * acceleration * gap
    meets = square > 0
    speed = safe_sqrt(jnp.where(meets, square, 0.0))
    time = divide(2.0 * gap, speed - begin)
    # What a resting body picks up in two steps is no blow, and neither is round-off between two that move as one.
    round_off = jnp.sqrt(jnp.finfo(speed.dtype).eps) * jnp.max(jnp.abs(begin), initial=0.0)
    resting = jnp.maximum(2.0 * jnp.abs(acceleration) * dt, round_off)
    hit = c.active & meets & (begin < 0) & (time <= dt) & (speed > resting) & (_restitution(c) > 0)
    hit = c.at_points(hit, False)
    left = jnp.where(hit, dt - time, 0.0)
    return hit, _restitution(c) * speed + acceleration * left, left


def impact_scale(
    problem: Problem, found: Solution, left: Scalar, start: Array, free: Array, dt: Scalar
) -> Scalar:
    """The share of the impulses that a round may give without adding energy: 1 but for blows off centre with friction.

    (Newton's law with Coulomb's can add energy: Kane and Levinson 1985.)
    """
    c = problem.contacts
    normal = c.normal[:, None]
    acceleration = dot(c.relative_velocity(free - start), normal) / dt
    before = c.relative_velocity(problem.free) - (acceleration * left)[..., None] * normal
    change = c.relative_velocity(found.motion - problem.free)
    taken, given = -jnp.sum(found.impulse * before), jnp.sum(found.impulse * change)
    return jnp.where(given > 2 * taken, divide(2 * taken, given), 1.0)


def _restitution(contacts: Contacts) -> Scalar:
    assert contacts.restitution is not None
    return contacts.restitution[:, None]
