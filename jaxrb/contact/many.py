"""Many contact problems at once: each runs as long as it must itself, not as long as the worst of all.

`vmap` of a loop goes on until its last member is done, and all others wait. So problems that know nothing of each other
are solved here in another way: bodies that touch only what stands still, each a problem of its own, in short rows
ordered by how far they are from their answer; worlds of bodies that touch each other one after the other.
(One box a world, 256 worlds: 22 µs a body-step under plain vmap, sixteen boxes, 16 worlds: 204.)
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap

from jaxrb.contact.block import Contacts, Incidence
from jaxrb.contact.platform import on_accelerator
from jaxrb.contact.problem import Problem
from jaxrb.contact.solution import Solution, no_contact, speed_to_take
from jaxrb.contact.solver import solve_contacts
from jaxrb.math.arrays import Array, Scalar, Vector

# Problems in a row. Shorter rows wait less for their slowest, longer ones fill the vector units better.
_ROW = 32


def solve_all(problem: Problem, start: Vector) -> Solution:
    """`solve_contacts` of a world, under any number of vmaps."""
    if problem.contacts.lever_back is not None or problem.joints is not None:
        return _solve_worlds(problem, start)
    bodies, blocks = _blocks_of_bodies(problem.contacts.incidence.lone)
    found = _solve_rows(*_one_by_one(problem, start, bodies, blocks))
    return _together(problem, found, bodies, blocks)


@custom_vmap
def _solve_worlds(problem: Problem, start: Vector) -> Solution:
    touches = speed_to_take(problem, problem.free) > 0
    return lax.cond(touches, solve_contacts, no_contact, problem, start)


@_solve_worlds.def_vmap
def _worlds(size: int, batched: Any, problem: Problem, start: Vector) -> tuple[Solution, Any]:
    arguments = _with_axis(size, batched, (problem, start))
    if on_accelerator():
        return _all_batched(jax.vmap(solve_contacts)(*arguments))
    return _all_batched(lax.map(lambda one: _solve_worlds(*one), arguments))


@custom_vmap
def _solve_rows(problem: Problem, start: Vector) -> Solution:
    """Problems (b, …) of one body each."""
    count = len(start)
    if count == 1:
        found = solve_contacts(*jax.tree.map(lambda leaf: leaf[0], (problem, start)))
        return jax.tree.map(lambda leaf: leaf[None], found)
    if count <= _ROW or on_accelerator():
        return jax.vmap(solve_contacts)(problem, start)
    return _in_rows(problem, start)


@_solve_rows.def_vmap
def _rows(size: int, batched: Any, problem: Problem, start: Vector) -> tuple[Solution, Any]:
    arguments = _with_axis(size, batched, (problem, start))
    count = arguments[1].shape[1]
    flat = jax.tree.map(lambda leaf: leaf.reshape(size * count, *leaf.shape[2:]), arguments)
    found = _solve_rows(*flat)
    return _all_batched(jax.tree.map(lambda leaf: leaf.reshape(size, count, *leaf.shape[1:]), found))


def _in_rows(problem: Problem, start: Vector) -> Solution:
    taken, left = jax.vmap(_distance_to_go)(problem, start)
    # What touches nothing comes last and is not looked at; of the rest, those at rest first.
    order = jnp.argsort(jnp.where(taken > 0, left, jnp.inf))
    rows = -(-len(start) // _ROW)
    order = jnp.pad(order, (0, rows * _ROW - len(start)), mode="edge").reshape(rows, _ROW)
    busy = -(-jnp.sum(taken > 0) // _ROW)

    def one(carry: Any) -> Any:
        row, found = carry
        at = order[row]
        own = jax.vmap(solve_contacts)(*jax.tree.map(lambda leaf: leaf[at], (problem, start)))
        return row + 1, jax.tree.map(lambda all_, new: all_.at[at].set(new), found, own)

    first = (jnp.zeros((), busy.dtype), jax.vmap(no_contact)(problem, start))
    return lax.while_loop(lambda carry: carry[0] < busy, one, first)[1]


def _distance_to_go(problem: Problem, start: Vector) -> tuple[Scalar, Scalar]:
    """The velocity that contact has to take [m/s], and the share of it that the start leaves."""
    taken = speed_to_take(problem, problem.free)
    left = speed_to_take(problem, problem.moved_by(start))
    return taken, left / jnp.where(taken > 0, taken, 1.0)


def _blocks_of_bodies(lone: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The bodies (b,) that have blocks, and the blocks (b, m) of each, −1 where it has fewer."""
    bodies = sorted(set(lone))
    own = [[block for block, body in enumerate(lone) if body == one] for one in bodies]
    most = max(map(len, own), default=0)
    blocks = [row + [-1] * (most - len(row)) for row in own]
    return np.asarray(bodies, np.int32), np.asarray(blocks, np.int32).reshape(len(bodies), most)


def _one_by_one(
    problem: Problem, start: Vector, bodies: np.ndarray, blocks: np.ndarray
) -> tuple[Problem, Vector]:
    """Problems (b, …) of one body each, out of one of all."""
    c = problem.contacts
    there, nobody = jnp.asarray(blocks >= 0)[:, :, None], jnp.zeros((len(bodies), 0), jnp.int32)
    contacts = Contacts(
        Incidence((0,) * blocks.shape[1], nobody, nobody, 1),
        c.normal[blocks],
        c.lever[blocks],
        None,
        c.distance[blocks],
        c.active[blocks] & there,
        None if c.friction is None else c.friction[blocks],
        None if c.restitution is None else c.restitution[blocks],
        c.feature[blocks],
        None if c.resistance is None else jax.tree.map(lambda leaf: leaf[blocks], c.resistance),
    )

    def own(rows: Array) -> Array:
        return rows[bodies][:, None]

    alone = Problem(
        contacts,
        problem.bias[blocks],
        own(problem.mass),
        own(problem.inertia),
        own(problem.inverse_mass),
        own(problem.inverse_inertia),
        own(problem.free),
        jnp.broadcast_to(problem.tolerance, len(bodies)),
        allowed=None if problem.allowed is None else own(problem.allowed),
    )
    return alone, start[blocks]


def _together(problem: Problem, found: Solution, bodies: np.ndarray, blocks: np.ndarray) -> Solution:
    """The solution of a world, out of those of its bodies."""
    row, column = np.nonzero(blocks >= 0)
    back = np.empty_like(row)
    back[blocks[row, column]] = np.arange(len(row))
    motion = problem.free.at[bodies].set(found.motion[:, 0])
    impulse = found.impulse[row[back], column[back]]
    return Solution(
        motion,
        impulse,
        jnp.max(found.residual, initial=0.0),
        jnp.any(found.poor),
        jnp.max(found.newton_steps, initial=0),
        jnp.max(found.products, initial=0),
    )


def _with_axis(size: int, batched: Any, values: Any) -> Any:
    return jax.tree.map(
        lambda leaf, has: leaf if has else jnp.broadcast_to(leaf, (size, *leaf.shape)), values, tuple(batched)
    )


def _all_batched(found: Solution) -> tuple[Solution, Any]:
    return found, jax.tree.map(lambda _: True, found)
