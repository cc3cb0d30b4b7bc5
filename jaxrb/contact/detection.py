"""Contacts of a state: who is near whom, where they touch, and what the last step knew of it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.collision.manifold import Manifold
from jaxrb.collision.touch import contact_points
from jaxrb.contact.block import Contacts, Incidence
from jaxrb.contact.memory import Memory, recalled
from jaxrb.contact.near import Near
from jaxrb.contact.pairs import points_where
from jaxrb.contact.resistance import with_couples
from jaxrb.contact.surfaces import Meeting, Obstacle
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.effects.surfaces import Kind, placed, standing
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.compaction import first_true


class Detected(eqx.Module):
    """`contacts`, the impulses (k, s, 3) from which their solve starts, the pairs that each group chose, `overflow`."""

    contacts: Contacts
    start: Array
    chosen: tuple[Array, ...]
    overflow: Array


def detect(
    rules: tuple[RigidContact, ...],
    kinds: tuple[Kind, ...],
    obstacles: tuple[Obstacle, ...],
    meetings: tuple[Meeting, ...],
    state: State,
    reach: Scalar,
    memory: Memory | None,
) -> Detected:
    """All points that may touch while each body moves by at most `reach` (n,) [m]."""
    count = len(reach)
    found, chosen, overflow = [], [], jnp.zeros((), bool)
    # Not each body's own reach: the fastest may push any other.
    within = 2 * jnp.max(reach, initial=0.0)
    near = Near(kinds, state, reach) if any(meeting.crowded for meeting in meetings) else None
    for obstacle in obstacles:
        bodies = np.asarray(obstacle.members)
        found.append(_against(kinds[obstacle.kind], obstacle, state, bodies))
        chosen.append(jnp.arange(len(bodies), dtype=jnp.int32))
    for meeting in meetings:
        pair, short = (np.arange(len(meeting.first)), False) if near is None else near.choose(meeting)
        points = _between(kinds, meeting, state, pair)
        points, pair, more = _touching(points, jnp.asarray(pair, jnp.int32), within, meeting.touching)
        found.append(points)
        chosen.append(pair)
        overflow = overflow | short | more
    slots = max(points.valid.shape[1] for points in found)
    points = Manifold(*(jnp.concatenate(x) for x in zip(*(_padded(p, slots) for p in found), strict=True)))
    contacts = _joined(rules, obstacles, meetings, points, chosen, state, within, count)
    # A face cut off at its last edges has lost points.
    overflow = overflow | jnp.any(points.overflow & jnp.any(contacts.active, axis=1))
    start = (
        jnp.zeros((*contacts.active.shape, 3), state.dtype)
        if memory is None
        else recalled(contacts, chosen, memory)
    )
    return Detected(contacts, start, tuple(chosen), overflow)


def _touching(points: Manifold, pair: Array, within: Scalar, capacity: int) -> tuple[Manifold, Array, Any]:
    """Of many pairs those that have a point within reach: the solve's cost is that of the places it is given."""
    if len(pair) <= capacity:
        return points, pair, False
    near = jnp.any(points.valid & (points.distance <= within), axis=1)
    rows, total = first_true(near, capacity)
    kept = jax.tree.map(lambda leaf: leaf[rows], points)
    there = rows >= 0
    kept = kept._replace(valid=kept.valid & there[:, None])
    return kept, jnp.where(there, pair[rows], -1), total > capacity


def _against(kind: Kind, obstacle: Obstacle, state: State, bodies: np.ndarray) -> Manifold:
    shape, pose = placed(kind, kind.rows(bodies), state, bodies)
    still = standing(obstacle.pose, state)
    return jax.vmap(contact_points, in_axes=(None, None, 0, 0))(obstacle.shape, still, shape, pose)


def _between(kinds: tuple[Kind, ...], meeting: Meeting, state: State, pair: Any) -> Manifold:
    sides = []
    for kind, bodies in zip(meeting.kinds, (meeting.first, meeting.second), strict=True):
        rows = kinds[kind].rows(bodies)
        if isinstance(pair, np.ndarray):
            sides.append(placed(kinds[kind], rows[pair], state, bodies[pair]))
        else:
            at = jnp.maximum(pair, 0)
            sides.append(placed(kinds[kind], jnp.asarray(rows)[at], state, jnp.asarray(bodies)[at]))
    if isinstance(pair, np.ndarray):
        return jax.vmap(contact_points)(*sides[0], *sides[1])
    return points_where((*sides[0], *sides[1]), pair >= 0)


def _joined(
    rules: tuple[RigidContact, ...],
    obstacles: tuple[Obstacle, ...],
    meetings: tuple[Meeting, ...],
    points: Manifold,
    chosen: list[Array],
    state: State,
    within: Scalar,
    count: int,
) -> Contacts:
    """The points of all groups as blocks of equally many slots."""
    lone = tuple(i for obstacle in obstacles for i in obstacle.members)
    first, second = [], []
    for meeting, pair in zip(meetings, chosen[len(obstacles) :], strict=True):
        # Nobody is the body after the last: its rows are zero and what it is given is dropped.
        first.append(jnp.where(pair >= 0, jnp.asarray(meeting.first)[pair], count))
        second.append(jnp.where(pair >= 0, jnp.asarray(meeting.second)[pair], count))
    none = jnp.zeros(0, jnp.int32)
    first, second = (jnp.concatenate(side) if side else none for side in (first, second))
    incidence = Incidence(lone, first, second, count)
    pushed, back = incidence.take(state.position)
    restitution = _coefficient("restitution", rules, obstacles, meetings, incidence)
    # Each body is pushed at its own surface, half a gap from the middle: there it will touch. Two bodies that do not
    # bounce are pushed in the middle, since their step ends without an impact's time, and this keeps angular momentum.
    own = np.arange(len(points.normal)) < (len(lone) if restitution is None else len(points.normal))
    half = jnp.where(own[:, None], 0.5 * points.distance, 0.0)[..., None] * points.normal[:, None]
    lever = points.position + half - pushed[:, None]
    back = None if back is None else (points.position - half)[len(lone) :] - back[:, None]
    contacts = Contacts(
        incidence,
        points.normal,
        lever,
        back,
        points.distance,
        points.valid & (points.distance <= within),
        _coefficient("friction", rules, obstacles, meetings, incidence),
        restitution,
        points.feature,
    )
    lengths = (f"{name}_resistance" for name in ("rolling", "spinning"))
    return with_couples(
        contacts, *(_coefficient(name, rules, obstacles, meetings, incidence) for name in lengths)
    )


def _padded(points: Manifold, slots: int) -> Manifold:
    more = slots - points.valid.shape[1]
    return points._replace(
        position=jnp.pad(points.position, ((0, 0), (0, more), (0, 0))),
        distance=jnp.pad(points.distance, ((0, 0), (0, more))),
        feature=jnp.pad(points.feature, ((0, 0), (0, more)), constant_values=-1),
        valid=jnp.pad(points.valid, ((0, 0), (0, more))),
        overflow=jnp.broadcast_to(points.overflow, points.valid.shape[:1]),
    )


def _coefficient(name: str, rules: Any, obstacles: Any, meetings: Any, incidence: Incidence) -> Array | None:
    """A coefficient of each block (k,); None where no rule has it."""
    if all(getattr(rule, name) is None for rule in rules):
        return None
    parts, at = [], 0
    for obstacle in obstacles:
        value = getattr(rules[obstacle.rule], name)
        members = np.asarray(obstacle.members)
        parts.append(coefficient_of(value, members))
    for meeting in meetings:
        rule = rules[meeting.rule]
        value, size = getattr(rule, name), meeting.touching
        sides = [coefficient_of(value, side[at : at + size]) for side in (incidence.first, incidence.second)]
        parts.append(combined(rule.combine, *sides))
        at += size
    return jnp.concatenate(parts)


def coefficient_of(value: Any, bodies: Any) -> Array:
    if value is None:
        return jnp.zeros(len(bodies))
    value = jnp.asarray(value)
    if value.ndim == 0:
        return jnp.broadcast_to(value, (len(bodies),))
    return value.at[bodies].get(mode="clip")


def combined(rule: str, a: Array, b: Array) -> Array:
    if rule == "geometric":
        # Of equal coefficients the mean is that coefficient, also with its derivative where it is zero.
        equal = a == b
        return jnp.where(equal, 0.5 * (a + b), jnp.sqrt(jnp.where(equal, 1.0, a * b)))
    return {
        "mean": lambda: 0.5 * (a + b),
        "smaller": lambda: jnp.minimum(a, b),
        "larger": lambda: jnp.maximum(a, b),
        "product": lambda: a * b,
    }[rule]()
