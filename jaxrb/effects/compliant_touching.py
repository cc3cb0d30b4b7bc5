"""The shapes on which compliant contact acts: where they touch, and what the law does there to the bodies."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.effects.effect import Effect, Wrench
from jaxrb.effects.surfaces import Kind, placed, standing
from jaxrb.geometry.primitives import Pose
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.vector import cross, dot


class Still(eqx.Module):
    """Bodies of one kind against one shape that stands still."""

    kind: int = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)
    shape: Shape
    pose: Pose | None


class Touching(Effect):
    """A law of contact with the shapes on which it acts. `pairs`: two kinds, and all pairs of their bodies."""

    law: Any  # a CompliantContact
    kinds: tuple[Kind, ...]
    still: tuple[Still, ...]
    pairs: tuple[tuple[tuple[int, int], tuple[tuple[int, int], ...]], ...] = eqx.field(static=True)

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        with jax.named_scope("CompliantContact"):
            force, turning = jnp.zeros_like(state.position), jnp.zeros_like(state.position)
            spin = state.orientation.rotate(state.angular_velocity)

            def lever(body: np.ndarray, points: Any) -> Vector:
                return points.position - state.position[body][:, None]

            def velocity(body: np.ndarray, points: Any) -> Vector:
                return state.velocity[body][:, None] + cross(spin[body][:, None], lever(body, points))

            for points, first, second in self._points(state):
                relative = velocity(second, points)
                if first is not None:
                    relative = relative - velocity(first, points)
                push = self._force(points, relative)
                resistance = self._resistance(points, relative, spin, first, second)
                for body, sign in ((second, 1.0), (first, -1.0)):
                    if body is not None:
                        torque = cross(lever(body, points), push)
                        if resistance is not None:
                            torque = torque + resistance
                        force = force.at[body].add(sign * jnp.sum(push, axis=1))
                        turning = turning.at[body].add(sign * jnp.sum(torque, axis=1))
            return Wrench(force, state.orientation.unrotate(turning))

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar:
        depths = [_depth(points) for points, _, _ in self._points(state)]
        return sum((jnp.sum(self.law.stored_energy(depth)) for depth in depths), jnp.zeros((), state.dtype))

    def _points(self, state: State) -> Iterator[tuple[Any, np.ndarray | None, np.ndarray]]:
        """The points of each group (k, s), and the bodies from which and to which their normals point."""
        from jaxrb.collision.touch import contact_points  # only scenes with contact load the collision floor

        for one in self.still:
            kind, members = self.kinds[one.kind], np.asarray(one.members, np.int32)
            shape, pose = placed(kind, kind.rows(members), state, members)
            still = standing(one.pose, state)
            yield jax.vmap(contact_points, (None, None, 0, 0))(one.shape, still, shape, pose), None, members
        for numbers, met in self.pairs:
            sides = np.asarray(met, np.int32).T
            both = [self.kinds[k] for k in numbers]
            given = [
                placed(kind, kind.rows(side), state, side) for kind, side in zip(both, sides, strict=True)
            ]
            yield jax.vmap(contact_points)(*given[0], *given[1]), sides[0], sides[1]

    def _resistance(
        self, points: Any, relative: Vector, spin: Vector, first: np.ndarray | None, second: np.ndarray
    ) -> Vector | None:
        """The torque (k, s, 3) [N m] on the second bodies against turning on the first; None where there is none."""
        if not self.law.resists_turning:
            return None
        normal = jnp.broadcast_to(points.normal[:, None], relative.shape)
        pressing = self.law.normal_force(_depth(points), -dot(relative, normal))
        turn = spin[second] if first is None else spin[second] - spin[first]
        return self.law.turning_torque(pressing, jnp.broadcast_to(turn[:, None], relative.shape), normal)

    def _force(self, points: Any, relative: Vector) -> Vector:
        """The force (k, s, 3) [N] on the second bodies, which move with `relative` (k, s, 3) past the first."""
        normal = jnp.broadcast_to(points.normal[:, None], relative.shape)
        along = dot(relative, normal)
        pressing = self.law.normal_force(_depth(points), -along)
        push = pressing[..., None] * normal
        if self.law.friction is None:
            return push
        return push + self.law.friction_force(pressing, relative - along[..., None] * normal)


def _depth(points: Any) -> Scalar:
    return jnp.where(points.valid, -points.distance, 0.0)
