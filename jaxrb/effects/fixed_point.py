"""A body point that is held in place: tops, pendulums, gyroscopes."""

import jax.numpy as jnp

from jaxrb.body.inertia import FullInertia, parallel_axis
from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.checks import quantity
from jaxrb.effects.effect import Force, Wrench, add
from jaxrb.math.arrays import Vector
from jaxrb.math.vector import cross


class FixedPoint(Force):
    """Holds the body point `point` (3,) [m], in the body frame, at `anchor` (3,) [m] of the world.

    The body then only rotates: with the inertia about that point (Steiner) under the torque about that point. Its
    centre of mass follows from its attitude, so the constraint cannot drift, and no translation is integrated where
    all bodies are held.
    """

    point: Vector = quantity((3,), unit="m")
    anchor: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        return Wrench()

    def chosen(self, count: int) -> tuple[int, ...]:
        """The numbers of the bodies that are held."""
        return tuple(range(count)) if self.bodies is None else self.bodies

    def inertia_about_point(self, bodies: MassProperties) -> FullInertia:
        """The inertia with which the bodies rotate: about the held point, or about the centre of mass."""
        six = jnp.asarray(bodies.inertia.six())
        added = jnp.asarray(bodies.mass)[:, None] * parallel_axis(
            self._spread(self.point, six.shape[0], six.dtype)
        )
        return FullInertia(six + added)

    def about_point(self, wrench: Wrench, state: State) -> Wrench:
        """The wrench with the torque taken about the held points; forces on held bodies move nothing else."""
        count = state.position.shape[0]
        if wrench.force is None:
            return wrench
        # The centre of mass lies at −point from the held point. Free bodies have a zero here.
        lever = self._spread(self.point, count, state.dtype)
        moment = cross(state.orientation.unrotate(wrench.force), lever)
        force = None if len(self.chosen(count)) == count else wrench.force * ~self._held(count)
        return Wrench(force, add(wrench.torque, moment))

    def complete(self, state: State) -> State:
        """The state with position and velocity of the held bodies as their attitude demands."""
        count = state.position.shape[0]
        lever = self._spread(self.point, count, state.dtype)
        position = self._spread(self.anchor, count, state.dtype) - state.orientation.rotate(lever)
        velocity = -state.orientation.rotate(cross(state.angular_velocity, lever))
        held = self._held(count)
        if len(self.chosen(count)) < count:
            position, velocity = (
                jnp.where(held, position, state.position),
                jnp.where(held, velocity, state.velocity),
            )
        return State(position, state.orientation, velocity, state.angular_velocity, state.time)

    def _held(self, count: int):
        return jnp.zeros((count, 1), bool).at[jnp.asarray(self.chosen(count))].set(True)

    def _spread(self, value: Vector, count: int, dtype) -> Vector:
        chosen = self.chosen(count)
        value = jnp.broadcast_to(jnp.asarray(value, dtype), (len(chosen), 3))
        return (
            value if len(chosen) == count else jnp.zeros((count, 3), dtype).at[jnp.asarray(chosen)].set(value)
        )
