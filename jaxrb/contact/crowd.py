"""Contacts of crowds: who is near whom by the broad phase, and all points that may press in one list.

A scene of few bodies knows all its pairs when it is traced, and its blocks stand in the order of the pairs. Of many
bodies the pairs are found at run time, and only points that will close within the step are handed to the solve, each as
a block of its own; points against what stands still are pairs with nobody. Every capacity has its overflow.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.state import State
from jaxrb.collision.broadphase import body_pairs
from jaxrb.collision.manifold import Manifold
from jaxrb.collision.touch import contact_points, slots
from jaxrb.contact.block import Contacts, Incidence
from jaxrb.contact.detection import Detected, coefficient_of, combined
from jaxrb.contact.near import Near
from jaxrb.contact.point_memory import recalled_points
from jaxrb.contact.surfaces import Obstacle
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.effects.surfaces import Kind, placed, standing
from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.compaction import first_true
from jaxrb.math.safe import norm
from jaxrb.math.vector import cross, dot

# Beyond what closes by itself within the step, points are taken along within this share of the smaller ball: a push may
# come from behind.
_SLACK = 0.02
# Through so many bodies a blow is followed within the step.
_PUSHES = 2
# A body, near each other and pressing: of equal balls in a heap 2.5 to 3 pairs touch, 6 at the densest.
_NEAR, _PRESSING = 6, 3


class Crowd(eqx.Module):
    """Bodies that meet each other under one rule, too many to list their pairs.

    `members`: their numbers; `kinds`: the places of their kinds; `near`, `pressing`: pairs that there is room for.
    """

    rule: int = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)
    kinds: tuple[int, ...] = eqx.field(static=True)
    near: int = eqx.field(static=True)
    pressing: int = eqx.field(static=True)


def crowd_of(number: int, rule: RigidContact, own: list[tuple[int, tuple[int, ...]]]) -> Crowd:
    """The bodies (kind, members) that a rule lets meet each other."""
    members = tuple(sorted(i for _, some in own for i in some))
    near, pressing = (rule.capacity or share * len(members) for share in (_NEAR, _PRESSING))
    return Crowd(number, members, tuple(kind for kind, _ in own), near, pressing)


class _Points(NamedTuple):
    """Points (m,) of one group, of body `second` against `first`, or against obstacle first − count."""

    first: Array
    second: Array
    normal: Array
    position: Array
    distance: Array
    feature: Array
    valid: Array
    friction: Any
    restitution: Any


def room_for_points(kinds: Any, obstacles: tuple[Obstacle, ...], crowds: tuple[Crowd, ...]) -> int:
    """How many points may press at a time: of a body against what stands still as many as one contact has."""
    at_walls: dict[int, int] = {}
    for obstacle in obstacles:
        points = len(obstacle.members) * slots(kinds[obstacle.kind].shape, obstacle.shape)
        at_walls[obstacle.kind] = max(points, at_walls.get(obstacle.kind, 0))
    between = 0
    for crowd in crowds:
        most = max(slots(kinds[a].shape, kinds[b].shape) for a in crowd.kinds for b in crowd.kinds)
        between += most * crowd.pressing
    return sum(at_walls.values()) + between


def detect_crowd(step: Any, state: State, reach: Scalar, motion: Array, dt: Scalar, memory: Any) -> Detected:
    """All points that may press in a step at whose end bodies would move with `motion` (n, 6), (v, ω) in W."""
    near = Near(step.kinds, state, _reach_among(state, reach, motion, dt))
    groups, overflow = [], jnp.zeros((), bool)
    for number, obstacle in enumerate(step.obstacles):
        found, cut = _against(step, number, obstacle, state)
        groups.append(_with_coefficients(step.rules[obstacle.rule], found, None))
        overflow |= cut
    for crowd in step.crowds:
        found, cut = _among(step, crowd, near, state)
        groups += [_with_coefficients(step.rules[crowd.rule], points, crowd) for points in found]
        overflow |= cut
    frictional = any(rule.friction is not None for rule in step.rules)
    bouncing = any(rule.restitution is not None for rule in step.rules)
    points = _Points(*(None if x[0] is None else jnp.concatenate(x) for x in zip(*groups, strict=True)))
    points = points._replace(
        friction=points.friction if frictional else None, restitution=points.restitution if bouncing else None
    )
    wanted = points.valid & _closes(points, state, near, motion, dt)
    capacity = min(len(wanted), step.room)
    row, total = first_true(wanted, capacity)
    there = row >= 0
    points = jax.tree.map(lambda leaf: leaf[jnp.maximum(row, 0)], points)
    contacts = _contacts(points, there, state, len(reach))
    name = (
        jnp.where(there, points.first, -1), jnp.where(there, points.second, -1), jnp.where(there, points.feature, -1)
    )  # fmt: skip
    start = jnp.zeros((capacity, 1, 3), state.dtype) if memory is None else recalled_points(name, memory)
    return Detected(contacts, start, name, overflow | (total > capacity))


def _reach_among(state: State, reach: Scalar, motion: Array, dt: Scalar) -> Scalar:
    """How far (n,) [m] each body moves against the mean of all: a crowd that falls together stays as near as it is."""
    old, new = (dt * norm(v - jnp.mean(v, axis=0)) for v in (state.velocity, motion[:, :3]))
    moved = dt * jnp.maximum(norm(state.velocity), norm(motion[:, :3]))
    return lax.stop_gradient(reach - moved + jnp.maximum(old, new))


def _against(step: Any, number: int, obstacle: Obstacle, state: State) -> tuple[_Points, Array]:
    kind, bodies = step.kinds[obstacle.kind], np.asarray(obstacle.members, np.int32)
    shape, pose = placed(kind, kind.rows(bodies), state, bodies)
    still = standing(obstacle.pose, state)
    found = jax.vmap(contact_points, in_axes=(None, None, 0, 0))(obstacle.shape, still, shape, pose)
    first = jnp.full(len(bodies), step.count + number, jnp.int32)
    return _flat(found, first, jnp.asarray(bodies), True)


def _among(step: Any, crowd: Crowd, near: Near, state: State) -> tuple[list[_Points], Array]:
    members = np.asarray(crowd.members, np.int32)
    middle, radius = near.middle[members], near.radius[members]
    columns = (*middle.T, radius)

    def balls_meet(first: Array, second: Array) -> Array:
        x, y, z, r = ((column[first], column[second]) for column in columns)
        square = sum((a - b) ** 2 for a, b in (x, y, z))
        return square <= (r[0] + r[1]) ** 2

    rule = step.rules[crowd.rule]
    bits = {
        name: None if getattr(rule, name) is None else jnp.asarray(np.asarray(getattr(rule, name), np.int32)[members])
        for name in ("groups", "masks")
    }  # fmt: skip
    low, high = (lax.stop_gradient(side)[members] for side in (near.low, near.high))
    pairs = body_pairs(low, high, crowd.near, **bits, keep=balls_meet)
    number = jnp.asarray(members)
    first, second = (jnp.where(side >= 0, number[side], -1) for side in (pairs.first, pairs.second))
    kind_of = np.full(step.count, -1, np.int32)
    for kind in crowd.kinds:
        kind_of[np.asarray(step.kinds[kind].members)] = kind
    groups, overflow = [], pairs.overflow
    for at, one in enumerate(crowd.kinds):
        for other in crowd.kinds[at:]:
            own = (first, second)
            if len(crowd.kinds) > 1:
                own = _of_kinds(jnp.asarray(kind_of), first, second, one, other)
            found, cut = _flat(_touching(step.kinds, one, other, own, state), *own, own[0] >= 0)
            groups.append(found)
            overflow |= cut
    return groups, overflow


def _of_kinds(kind_of: Array, first: Array, second: Array, one: int, other: int) -> tuple[Array, Array]:
    """The pairs of two kinds, first of the one kind, −1 elsewhere."""
    straight = (kind_of[first] == one) & (kind_of[second] == other)
    turned = (kind_of[first] == other) & (kind_of[second] == one) & ~straight
    there = (first >= 0) & (straight | turned)
    a, b = jnp.where(turned, second, first), jnp.where(turned, first, second)
    row, _ = first_true(there, len(first))
    return tuple(jnp.where(row >= 0, side[jnp.maximum(row, 0)], -1) for side in (a, b))  # pyright: ignore


def _touching(kinds: tuple[Kind, ...], one: int, other: int, bodies: Any, state: State) -> Manifold:
    sides = []
    for kind, own in zip((one, other), bodies, strict=True):
        rows = np.zeros(len(state.position), np.int32)
        rows[np.asarray(kinds[kind].members)] = np.arange(len(kinds[kind].members))
        at = jnp.where(own >= 0, own, kinds[kind].members[0])
        sides.append(placed(kinds[kind], jnp.asarray(rows)[at], state, at))
    return jax.vmap(contact_points)(*sides[0], *sides[1])


def _flat(found: Manifold, first: Array, second: Array, there: Any) -> tuple[_Points, Array]:
    """The points of manifolds one by one; whether any lost points."""
    slots = found.valid.shape[1]

    def each(rows: Array) -> Array:
        return jnp.repeat(rows, slots, axis=0) if slots > 1 else rows

    valid = found.valid if there is True else found.valid & there[:, None]
    points = _Points(
        each(first), each(second), each(found.normal), found.position.reshape(-1, 3), found.distance.ravel(),
        found.feature.ravel(), valid.ravel(), None, None,
    )  # fmt: skip
    return points, jnp.any(found.overflow & jnp.any(valid, axis=1))


def _with_coefficients(rule: RigidContact, points: _Points, crowd: Crowd | None) -> _Points:
    found = {}
    for name in ("friction", "restitution"):
        value = getattr(rule, name)
        sides = [coefficient_of(value, jnp.maximum(side, 0)) for side in (points.first, points.second)]
        found[name] = (sides[1] if crowd is None else combined(rule.combine, *sides)).astype(
            points.distance.dtype
        )
    return points._replace(**found)


def _closes(points: _Points, state: State, near: Near, motion: Array, dt: Scalar) -> Array:
    """Which points would overlap at the end of the step, or nearly; or would if what hits a body pushed it on."""
    points, position, motion = lax.stop_gradient((points, state.position, motion))

    def at(body: Array) -> tuple[Array, Array]:
        own = motion.at[body].get(mode="fill", fill_value=0)
        arm = points.position - position.at[body].get(mode="fill", fill_value=0)
        return own[:, :3] + cross(own[:, 3:], arm), near.size.at[body].get(mode="fill", fill_value=jnp.inf)

    (one, small), (other, large) = at(points.first), at(points.second)
    closing = jnp.maximum(-dot(other - one, points.normal), 0.0)
    room = points.distance - _SLACK * jnp.minimum(small, large)
    pushed = jnp.zeros_like(position[:, 0])
    for _ in range(_PUSHES):
        blow = jnp.where(points.valid & (room <= dt * closing), closing, 0.0)
        for body in (points.first, points.second):
            pushed = pushed.at[jnp.where(body >= 0, body, len(pushed))].max(blow, mode="drop")
        first, second = (
            pushed.at[body].get(mode="fill", fill_value=0) for body in (points.first, points.second)
        )
        closing = jnp.maximum(closing, jnp.maximum(first, second))
    return room <= dt * closing


def _contacts(points: _Points, there: Array, state: State, count: int) -> Contacts:
    # Nobody is the body after the last.
    first = jnp.where(there, jnp.minimum(points.first, count), count)
    second = jnp.where(there, points.second, count)
    incidence = Incidence((), first, second, count)
    pushed, back = incidence.take(state.position)
    # As in blocks of few bodies: at the body's own surface, but in the middle of two that do not bounce.
    half = 0.5 * points.distance
    if points.restitution is None:
        half = jnp.where(first == count, half, 0.0)
    half = half[:, None] * points.normal
    return Contacts(
        incidence,
        points.normal,
        (points.position + half - pushed)[:, None],
        (points.position - half - back)[:, None],
        points.distance[:, None],
        there[:, None],
        points.friction,
        points.restitution,
        points.feature[:, None],
    )
