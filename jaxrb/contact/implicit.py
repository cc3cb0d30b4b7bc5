"""Derivatives of the contact solve by the implicit function theorem: through its equations, not through its loops.

At the solution each point is open, sticks or slides, and its law is linear in a neighbourhood: open λ = 0; stick
J u = b n; slide: the normal part as stick, the tangential one μ λₙ against the sliding. With these the tangent of the
motion solves one linear system. Where a point is just between two of them (touching without force, at the limit of
friction) the motion has no derivative but one to each side; the one returned is that of the state in which the solve
ended, and it is finite.

The linear law keeps a compliance of its own, far below the solve's, so that several points that share one load (four
corners of a box) have a unique answer: of all ways to share it the least. Rigid bodies leave it open, and a run keeps
the way of the step before; so what depends on the sharing (the spin of a box that slides on a whole face) has a
derivative that differs from differences of runs by some per cent.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.contact.many import solve_all
from jaxrb.contact.newton import compliance
from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import Solution
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.kept import kept
from jaxrb.math.vector import dot


@jax.custom_jvp
def solve(problem: Problem, start: Vector) -> Solution:
    """`solve_all` with derivatives, forward and reverse, of motion and impulses with respect to `problem`."""
    return solve_all(problem, start)


@solve.defjvp
def _rule(primals: Any, tangents: Any) -> Any:
    # The loops are most of the program.
    found = kept(solve(*primals))
    numbers, rest = eqx.partition(primals[0], eqx.is_inexact_array)
    change, _ = eqx.partition(tangents[0], eqx.is_inexact_array)
    motion, impulse = _tangents(numbers, change, rest, found)
    still = jax.tree.map(_no_tangent, found)
    return found, eqx.tree_at(lambda s: (s.motion, s.impulse), still, (motion, impulse))


@jax.custom_jvp
def solve_crowd(problem: Problem, start: Vector) -> Solution:
    """`solve_sparse`. Derivatives are refused by name: its dense linear system would have (6n)² numbers."""
    from jaxrb.contact.sparse import solve_sparse  # other scenes need not load it

    return solve_sparse(problem, start)


@solve_crowd.defjvp
def _refused(primals: Any, tangents: Any) -> Any:
    raise WrongStructure(
        f"RigidContact: no derivative through the sparse solve of a crowd ({len(primals[0].mass)} bodies); use "
        "solver='newton', which has one, or rb.CompliantContact"
    )


def _no_tangent(leaf: Array) -> Any:
    if jnp.issubdtype(leaf.dtype, jnp.inexact):
        return jnp.zeros_like(leaf)
    return np.zeros(leaf.shape, jax.dtypes.float0)


def _tangents(numbers: Problem, change: Problem, rest: Any, found: Solution) -> tuple[Array, Vector]:
    """Tangents of motion and impulse for a tangent of the problem's numbers."""
    problem = eqx.combine(numbers, rest)
    frozen, firm = _linear_law(problem, found)

    def impulses(numbers: Problem, motion: Array) -> Vector:
        own = eqx.combine(numbers, rest)
        moved = own.contacts.relative_velocity(motion)
        against = own.wanted(jnp.zeros_like(moved), moved, jnp.ones_like(firm))
        wanted = frozen + firm[..., None] * (against - lax.stop_gradient(against))
        return own.projected(wanted, own.bounds(wanted))

    joined: Any = None
    if problem.joints is not None:
        from jaxrb.contact import implicit_joints as joined  # only scenes with joints load it

        size = joined.joint_impulses(problem, found)

    def unbalanced(numbers: Problem) -> Array:
        own = eqx.combine(numbers, rest)
        given = impulses(numbers, found.motion)
        missing = own.momentum(found.motion - own.free) - own.on_bodies(given)
        return missing.ravel() if joined is None else joined.unbalanced_joints(own, found, missing, size)

    _, excess = jax.jvp(unbalanced, (numbers,), (change,))
    matrix = _matrix(problem, _slopes(problem, frozen, firm))
    if joined is not None:
        matrix = joined.bordered(matrix, problem.joints)
    solved = -jnp.linalg.solve(matrix, excess)
    motion = solved[: found.motion.size].reshape(found.motion.shape)
    _, impulse = jax.jvp(impulses, (numbers, found.motion), (change, motion))
    return motion, impulse


def _linear_law(problem: Problem, found: Solution) -> tuple[Vector, Scalar]:
    """What the law projects at the solution (k, s, 3), and the stiffness (k, s) of its changes.

    Open, stick and slide are told apart with the solve's own compliance, against which its error is small. A point that
    slides is then seen with the firm one, since the direction of its friction changes by μ λₙ / |v|.
    """
    c, dtype = problem.contacts, found.motion.dtype
    soft, firm = (problem.stiffness(r) for r in (compliance(dtype), _firm_compliance(dtype)))
    velocity = c.relative_velocity(found.motion)
    wanted = problem.wanted(found.impulse, velocity, soft)
    bound = problem.bounds(wanted).across
    if bound is not None:
        normal = c.normal[:, None]
        along = dot(wanted, normal)
        side = wanted - along[..., None] * normal
        slides = (dot(side, side) > bound * bound) & (bound > 0)
        firmly = problem.wanted(found.impulse, velocity, firm)
        firmly = firmly - dot(firmly, normal)[..., None] * normal + along[..., None] * normal
        wanted = jnp.where(slides[..., None], firmly, wanted)
    return lax.stop_gradient((wanted, firm))


def _firm_compliance(dtype: Any) -> float:
    return 1e-8 if jnp.finfo(dtype).bits == 64 else 1e-3


def _slopes(problem: Problem, frozen: Vector, firm: Scalar) -> Array:
    """−∂λ/∂v of the linear law: (k, s, 3, 3), each point's own; (k, s, 3, s, 3) where couples follow all of a pair."""

    def law(change: Vector) -> Vector:
        wanted = frozen - firm[..., None] * change
        return problem.projected(wanted, problem.bounds(wanted))

    def slope(direction: Array) -> Vector:
        at = jnp.zeros_like(frozen)
        return -jax.jvp(law, (at,), (jnp.broadcast_to(direction, at.shape),))[1]

    unit = jnp.eye(3, dtype=frozen.dtype)
    if problem.contacts.resistance is None:
        return jax.vmap(slope, out_axes=-1)(unit)
    alone = jnp.eye(frozen.shape[1], dtype=frozen.dtype)
    return jax.vmap(jax.vmap(slope, out_axes=-1), out_axes=-2)(alone[:, None, :, None] * unit[:, None, :])


def _matrix(problem: Problem, slopes: Array) -> Array:
    """M + Jᵀ G J (6n, 6n), G of `_slopes`, not symmetric."""
    n = len(problem.mass)
    product = "ksij,ksj->ksi" if problem.contacts.resistance is None else "ksitj,ktj->ksi"
    return jax.vmap(
        lambda direction: (
            problem.momentum(direction)
            + problem.on_bodies(jnp.einsum(product, slopes, problem.contacts.relative_velocity(direction)))
        ).ravel(),
        out_axes=1,
    )(jnp.eye(6 * n, dtype=slopes.dtype).reshape(6 * n, n, 6))
