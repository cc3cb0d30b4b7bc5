"""Corners of bodies in flight: where they are, how fast they move, and how much their paths can bend."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.problem import motion_of
from jaxrb.errors import WrongStructure
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.primitives import Box, Capsule, Composite, HalfSpace, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import norm
from jaxrb.math.vector import cross, matvec
from jaxrb.scene.events_flight import Bounds

_MOST_CORNERS = 16  # of a hull that is followed corner by corner; others by their speed
_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)


class Corners(eqx.Module):
    """Corners of the cores: of bodies (n, m, 3) [m] from the centre of mass in the body frame, and `rounding` (n,); of
    what stands still (lone, m, 3) [m] in W, and `rounding_still` (lone,). `followed` (n,), `still_followed` (lone,):
    whose
    cores have few corners.
    """

    bodies: Array
    rounding: Scalar
    still: Array
    rounding_still: Scalar
    followed: tuple[bool, ...] = eqx.field(static=True)
    still_followed: tuple[bool, ...] = eqx.field(static=True)


def corners_of(contact: Any, dtype: Any) -> Corners:
    """The corners of a scene's shapes.

    Raises:
        WrongStructure: a composite.
    """
    count = contact.count
    parts, rounding, followed = {}, jnp.zeros(count, dtype), [False] * count
    for kind in contact.kinds:
        points = _core(kind.shape, (len(kind.members),), dtype)
        for row, member in enumerate(kind.members):
            followed[member] = points is not None
            parts[member] = (jnp.zeros((1, 3), dtype) if points is None else points[row]) - kind.center[row]
        members = np.asarray(kind.members, np.int32)
        rounding = rounding.at[members].set(jnp.asarray(kind.shape.rounding, dtype))
    still, rounding_still, still_followed = [], [], []
    for obstacle in contact.obstacles:
        points = _core(obstacle.shape, (), dtype)
        still_followed += [points is not None] * len(obstacle.members)
        points = jnp.zeros((1, 3), dtype) if points is None else points
        if obstacle.pose is not None:
            points = jnp.asarray(obstacle.pose.position) + obstacle.pose.orientation.rotate(points)
        still += [points] * len(obstacle.members)
        rounding_still += [jnp.asarray(obstacle.shape.rounding, dtype)] * len(obstacle.members)
    bodies = [parts.get(i, jnp.zeros((1, 3), dtype)) for i in range(count)]
    none = jnp.zeros(0, dtype)
    return Corners(
        _padded(bodies, dtype), rounding, _padded(still, dtype), jnp.stack(rounding_still) if still else none,
        tuple(followed), tuple(still_followed),
    )  # fmt: skip


def _core(shape: Shape, lead: tuple[int, ...], dtype: Any) -> Array | None:
    """Corners (*lead, m, 3) of the core in the shape's own frame; None where there are none, or too many."""
    if isinstance(shape, Composite):
        raise WrongStructure(
            "solve_events: a Composite is not followed between impacts; make its parts bodies of their "
            "own, or use rb.rollout"
        )
    if isinstance(shape, Sphere):
        return jnp.zeros((*lead, 1, 3), dtype)
    if isinstance(shape, HalfSpace):
        normal = jnp.asarray(shape.normal, dtype)
        return (jnp.asarray(shape.offset, dtype) * normal)[..., None, :]
    if isinstance(shape, Capsule):
        end = jnp.zeros((*lead, 3), dtype).at[..., 2].set(shape.half_height)
        return jnp.stack([-end, end], axis=-2)
    if isinstance(shape, Box):
        return jnp.asarray(shape.half_extents, dtype)[..., None, :] * jnp.asarray(_SIGNS, dtype)
    if isinstance(shape, ConvexHull) and shape.vertices.shape[-2] <= _MOST_CORNERS:
        return jnp.asarray(shape.vertices, dtype)
    return None


def _padded(rows: list[Array], dtype: Any) -> Array:
    """Rows of points as one array; short rows repeat their first point."""
    most = max((len(points) for points in rows), default=1)
    if not rows:
        return jnp.zeros((0, 1, 3), dtype)
    return jnp.stack([jnp.concatenate([p, jnp.broadcast_to(p[:1], (most - len(p), 3))]) for p in rows])


class Sides(eqx.Module):
    """Both sides of each block: corners (k, m, 3) from the pushed body's centre, their velocities and bends; then, of
    the pushed body against the other, velocity and acceleration (k, 3), and bounds (k,)."""

    low: Array
    low_velocity: Array
    low_bend: Array
    high: Array
    high_velocity: Array
    high_bend: Array
    rounding: Scalar
    velocity: Vector
    acceleration: Vector
    excess: Scalar
    sweep: Scalar
    whirl: Scalar
    followed: Array


def sides_of(corners: Corners, bounds: Bounds, reach: Scalar, state: State, c: Contacts) -> Sides:
    """The corners of both bodies of each block. `reach` (n,) [m]: of each from its centre."""
    motion = motion_of(state)
    turn = state.orientation.as_matrix()
    arms = matvec(turn[:, None], corners.bodies)
    velocity = motion[:, None, :3] + cross(jnp.broadcast_to(motion[:, None, 3:], arms.shape), arms)
    whirl = bounds.spin * bounds.spin + bounds.turning
    bend = whirl[:, None] * norm(corners.bodies)
    numbers = jnp.stack([corners.rounding, bounds.excess, bounds.spin * reach, whirl * reach], axis=1)
    followed = jnp.asarray(np.asarray(corners.followed))
    rows = (arms, velocity, bend, state.position, motion[:, :3], bounds.acceleration, numbers, followed)
    most = len(state.position) - 1
    lone = np.asarray(c.incidence.lone, np.int32)
    second, first = (jnp.minimum(side, most) for side in (c.incidence.second, c.incidence.first))
    pushed = jnp.concatenate([jnp.asarray(lone), second])
    own = tuple(x[pushed] for x in rows)
    other = tuple(x[first] for x in rows)
    still = corners.still - state.position[lone][:, None]
    none = jnp.zeros_like(still)
    shift = (other[3] - state.position[second])[:, None]
    others = jnp.zeros((len(lone), 4), arms.dtype).at[:, 0].set(corners.rounding_still)
    quiet = jnp.zeros((len(lone), 3), arms.dtype)
    high = _stacked(still, other[0] + shift)
    both = own[6] + jnp.concatenate([others, other[6]])
    return Sides(
        own[0], own[1], own[2],
        high, _stacked(none, other[1]), _stacked(none[..., 0], other[2]),
        both[:, 0],
        own[4] - jnp.concatenate([quiet, other[4]]), own[5] - jnp.concatenate([quiet, other[5]]),
        both[:, 1], both[:, 2], both[:, 3],
        own[7] & jnp.concatenate([np.asarray(corners.still_followed, bool), other[7]]),
    )  # fmt: skip


def _stacked(first: Array, second: Array) -> Array:
    """Rows of points one below the other; the shorter rows repeat their first point."""
    most = max(first.shape[1], second.shape[1])

    def wide(x: Array) -> Array:
        return jnp.concatenate([x, jnp.broadcast_to(x[:, :1], (len(x), most - x.shape[1], *x.shape[2:]))], 1)

    return jnp.concatenate([wide(first), wide(second)])
