"""What contact did in a run: carried with the state, so that looking at it later costs no second run."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from jaxrb.contact.impact import Course
from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import Solution
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.vector import dot


class ContactReport(eqx.Module):
    """Contact from the start of a run to a saved time.

    * `penetration` [m]: the deepest overlap met at the start of a step.
    * `normal_work`, `friction_work` [J]: what contact has done along its normals (impacts, resting) and across them;
      both are losses, and negative, but for an error of first order in the step where a curved surface rolls.
    * `residual` [m/s]: the worst that a solve left of the law, as a velocity; `poor`: in how many steps that was above
      1 % of what the law takes away.
    * `newton_steps`, `products`: of all solves. `points`: most points pressed at a time.
    * `steps` taken; `overflow`: the first step in which capacity did not suffice, −1 for none.
    """

    penetration: Scalar
    normal_work: Scalar
    friction_work: Scalar
    residual: Scalar
    poor: Array
    newton_steps: Array
    products: Array
    points: Array
    steps: Array
    overflow: Array

    def noting(self, overflow: Array) -> "ContactReport":
        """With the step just made counted, and whether it had too little room."""
        first = jnp.where((self.overflow < 0) & overflow, self.steps, self.overflow)
        return eqx.tree_at(lambda r: (r.steps, r.overflow), self, (self.steps + 1, first))


def first_report(dtype) -> ContactReport:
    """Nothing has happened."""
    zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
    return ContactReport(zero, zero, zero, zero, none, none, none, none, none, none - 1)


def reported(
    report: ContactReport, problem: Problem, start: Array, course: Course, found: Solution
) -> ContactReport:
    """With what one step did. `start` (n, 6) is the motion before it."""
    problem, start, course, found = lax.stop_gradient((problem, start, course, found))
    c = problem.contacts
    normal = c.normal[:, None]
    # Against the mean of the velocities before and after: of a body at rest contact takes no energy.
    mean = c.relative_velocity(start + 0.5 * (problem.free - start + course.jump))
    pressing = c.at_points(dot(course.impulse, normal), 0.0)
    along = jnp.sum(pressing * dot(mean, normal))
    total = jnp.sum(course.impulse * mean)
    depth = jnp.max(jnp.where(c.active, -c.distance, 0.0), initial=0.0)
    return ContactReport(
        jnp.maximum(report.penetration, depth),
        report.normal_work + along,
        report.friction_work + (total - along),
        jnp.maximum(report.residual, found.residual),
        report.poor + found.poor,
        report.newton_steps + found.newton_steps,
        report.products + found.products,
        jnp.maximum(report.points, jnp.sum(pressing > 0, dtype=jnp.int32)),
        report.steps,
        report.overflow,
    )
