"""Scalar constraints between two bodies: value, derivative, and what the velocities alone add to the second derivative.

Every joint is made of three kinds of rows, so the program of a scene does not grow with the number or kinds of its
joints. A row is C(q) = 0 with Ċ = J·(v, ω) and C̈ = J·(v̇, ω̇) + bias; v in the world frame, ω in the body's. The world
takes part as one more body, after the last, that neither moves nor turns.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.state import State
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.rotation import Rotation
from jaxrb.math.vector import cross, dot


class Place(eqx.Module):
    """Where the body of each row is and how it moves: all in the world frame, (k, 3)."""

    position: Vector
    orientation: Rotation
    velocity: Vector
    spin: Vector


class Rows(eqx.Module):
    """k scalar constraints. `value` and `bias` (k,); derivatives (k, 2, 3): of body a, of body b; [0] a, [1] b.

    `linear` multiplies v in W, `angular` ω in B.
    """

    value: Scalar
    linear: Vector
    angular: Vector
    bias: Scalar

    def rate(self, bodies: np.ndarray, velocity: Vector, angular_velocity: Vector) -> Scalar:
        """J·(v, ω) (k,) for velocities, or accelerations, of all bodies (n + 1, 3); `bodies` (k, 2)."""
        along = self.linear * velocity[bodies] + self.angular * angular_velocity[bodies]
        return jnp.sum(along, axis=(1, 2))

    def pushed(self, bodies: np.ndarray, count: int, size: Scalar) -> tuple[Vector, Vector]:
        """Jᵀ `size`: the forces in W and torques in B (n, 3) that constraint forces (k,) are on `count` bodies."""
        linear, angular = (
            jnp.zeros((count + 1, 3), size.dtype).at[bodies].add(part * size[:, None, None])[:count]
            for part in (self.linear, self.angular)
        )
        return linear, angular


class PointRows(eqx.Module):
    """(x_a − x_b)·t: how far the point `anchor_a` of a is from the point `anchor_b` of b along `direction`, fixed in b.

    All (k, 3), each in the frame of its body; `bodies` (k, 2), of which the world is the last.
    """

    anchor_a: Vector
    anchor_b: Vector
    direction: Vector
    bodies: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def rows(self, a: Place, b: Place) -> Rows:
        """The rows for bodies in these places."""
        arm_a, arm_b = a.orientation.rotate(self.anchor_a), b.orientation.rotate(self.anchor_b)
        t = b.orientation.rotate(self.direction)
        gap = (a.position - b.position) + (arm_a - arm_b)
        sweep_a, sweep_b = cross(a.spin, arm_a), cross(b.spin, arm_b)
        closing = (a.velocity - b.velocity) + (sweep_a - sweep_b)
        turning = cross(b.spin, t)
        bias = (
            dot(t, cross(a.spin, sweep_a) - cross(b.spin, sweep_b))
            + 2.0 * dot(turning, closing)
            + dot(cross(b.spin, turning), gap)
        )
        on_a = a.orientation.unrotate(cross(arm_a, t))
        on_b = -b.orientation.unrotate(cross(arm_b + gap, t))
        return Rows(dot(t, gap), jnp.stack([t, -t], axis=1), jnp.stack([on_a, on_b], axis=1), bias)


class TurnRows(eqx.Module):
    """u·t: the cosine between `across_a`, fixed in a, and `across_b`, fixed in b, that a joint keeps perpendicular."""

    across_a: Vector
    across_b: Vector
    bodies: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def rows(self, a: Place, b: Place) -> Rows:
        """The rows for bodies in these places."""
        u, t = a.orientation.rotate(self.across_a), b.orientation.rotate(self.across_b)
        axis = cross(u, t)
        bias = dot(a.spin - b.spin, cross(cross(a.spin, u), t) + cross(u, cross(b.spin, t)))
        angular = jnp.stack([a.orientation.unrotate(axis), -b.orientation.unrotate(axis)], axis=1)
        return Rows(dot(u, t), jnp.zeros_like(angular), angular, bias)


class LengthRows(eqx.Module):
    """½ (|x_a − x_b|²/l − l): as the error of the distance itself near l, and smooth everywhere."""

    anchor_a: Vector
    anchor_b: Vector
    length: Scalar
    bodies: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def rows(self, a: Place, b: Place) -> Rows:
        """The rows for bodies in these places."""
        arm_a, arm_b = a.orientation.rotate(self.anchor_a), b.orientation.rotate(self.anchor_b)
        line = (a.position - b.position) + (arm_a - arm_b)
        sweep_a, sweep_b = cross(a.spin, arm_a), cross(b.spin, arm_b)
        closing = (a.velocity - b.velocity) + (sweep_a - sweep_b)
        inverse = 1.0 / jnp.asarray(self.length)
        along = inverse[:, None] * line
        bias = dot(along, cross(a.spin, sweep_a) - cross(b.spin, sweep_b)) + inverse * dot(closing, closing)
        on_a = a.orientation.unrotate(cross(arm_a, along))
        on_b = -b.orientation.unrotate(cross(arm_b, along))
        value = 0.5 * (dot(along, line) - self.length)
        return Rows(value, jnp.stack([along, -along], axis=1), jnp.stack([on_a, on_b], axis=1), bias)


def with_world(state: State) -> tuple[Vector, Rotation, Vector, Vector]:
    """Position, orientation, velocity and angular velocity of all bodies and, last, the world (n + 1, ...)."""
    still = jnp.zeros((1, 3), state.dtype)
    upright = type(state.orientation).identity(state.dtype)
    orientation = jax.tree.map(lambda x, e: jnp.concatenate([x, e[None]]), state.orientation, upright)
    position, velocity, omega = (
        jnp.concatenate([part, still]) for part in (state.position, state.velocity, state.angular_velocity)
    )
    return position, orientation, velocity, omega


def places(state: State, bodies: np.ndarray) -> tuple[Place, Place]:
    """The places of the bodies a and b of rows; `bodies` (k, 2)."""
    position, orientation, velocity, omega = with_world(state)
    spin = orientation.rotate(omega)

    def of(index: np.ndarray) -> Place:
        return lax.optimization_barrier(
            Place(*jax.tree.map(lambda leaf: leaf[index], (position, orientation, velocity, spin)))
        )

    return of(bodies[:, 0]), of(bodies[:, 1])


def joined(parts: list[Rows]) -> Rows:
    """Rows of all kinds one after the other."""
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *x: jnp.concatenate(x), *parts)
