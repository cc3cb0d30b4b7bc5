"""What joints add to the equations of a contact problem's derivative: their impulses μ, and that they do not open.

M (u − free) = Jcᵀ λ − Jᵀ μ and J (u − free) = 0, linear in the changes of u and μ: a bordered matrix. Joints that say a
thing twice make it singular; a small multiple of the diagonal in the corner shares what both bear, and moves nothing.
"""

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import Solution
from jaxrb.joints.reactions import JointReactions
from jaxrb.math.arrays import Array, Scalar


def joint_impulses(problem: Problem, found: Solution) -> Scalar:
    """μ (rows,) at the solution."""
    assert problem.joints is not None
    given = problem.contacts.impulse_on_bodies(found.impulse)
    return lax.stop_gradient(problem.joints.multipliers(given))


def unbalanced_joints(problem: Problem, found: Solution, missing: Array, size: Scalar) -> Array:
    """Both equations (6n + rows,), of which `missing` (n, 6) is the first without the joints."""
    assert problem.joints is not None
    opening = problem.joints.rate(found.motion - problem.free)
    return jnp.concatenate([(missing + problem.joints.pushed(size)).ravel(), opening])


def bordered(matrix: Array, joints: JointReactions) -> Array:
    """[[K, Jᵀ], [J, −ε D]] (6n + rows, …), D the diagonal of J M⁻¹ Jᵀ."""
    rows, dtype = len(joints.bodies), matrix.dtype
    columns = jax.vmap(lambda unit: joints.pushed(unit).ravel(), out_axes=1)(jnp.eye(rows, dtype=dtype))
    tiny = 1e2 * jnp.finfo(dtype).eps
    corner = -tiny * jnp.diag(jnp.where(joints.diagonal > 0, joints.diagonal, 1.0))
    return jnp.block([[matrix, columns], [columns.T, corner]])
