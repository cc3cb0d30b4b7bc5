"""Springs with dampers between points of bodies, or between a body and the world."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import PER_BODY, State
from jaxrb.checks import quantity
from jaxrb.effects.effect import Effect, Wrench, check_indices, check_shapes, scattered, taken
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.safe import norm, unit_or
from jaxrb.math.vector import dot


class SpringDamper(Effect):
    """A spring of `stiffness` k [N/m] and `rest_length` [m] with a `damping` d [N s/m] along its line.

    It pulls with k (l − l₀) + d l̇ between `point_a` (3,) [m] of body `body_a`, in that body's frame, and `point_b` of
    body `body_b`; with `body_b` None, `point_b` is a fixed point of the world. For several springs in one effect, give
    tuples of body numbers, and numbers with a leading axis over the springs. A spring of zero length has no direction:
    it exerts no force there.
    """

    stiffness: Scalar = quantity((), nonnegative=True, unit="N/m")
    damping: Scalar = quantity((), nonnegative=True, unit="N s/m", default=0.0)
    rest_length: Scalar = quantity((), nonnegative=True, unit="m", default=0.0)
    point_a: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))
    point_b: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))
    body_a: int | tuple[int, ...] = eqx.field(static=True, default=0)
    body_b: int | tuple[int, ...] | None = eqx.field(static=True, default=None)

    def check(self, count: int) -> None:
        a, b = _numbers(self.body_a), _numbers(self.body_b)
        check_indices("SpringDamper", "body_a", a, count)
        check_indices("SpringDamper", "body_b", b, count)
        if b and len(a) != len(b):
            raise WrongStructure(f"SpringDamper: body_a {a} and body_b {b} must name equally many bodies")
        check_shapes(self, len(a), "all springs", "one value a spring")

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        with jax.named_scope("SpringDamper"):
            a, b = np.asarray(_numbers(self.body_a)), np.asarray(_numbers(self.body_b), int)
            state_a = taken(state, a)
            state_b = taken(state, b) if b.size else None
            force = self._tension(state_a, state_b)
            on_a = jax.vmap(Wrench.at_point, in_axes=(0, 0, PER_BODY))(
                force, self._points(self.point_a), state_a
            )
            total = scattered(on_a, a, state)
            if state_b is None:
                return total
            on_b = jax.vmap(Wrench.at_point, in_axes=(0, 0, PER_BODY))(
                -force, self._points(self.point_b), state_b
            )
            return total + scattered(on_b, b, state)

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar:
        a, b = np.asarray(_numbers(self.body_a)), np.asarray(_numbers(self.body_b), int)
        line, _ = self._line(taken(state, a), taken(state, b) if b.size else None)
        return jnp.sum(0.5 * self.stiffness * (norm(line) - self.rest_length) ** 2)

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        masses = np.asarray(bodies.mass)
        a, b = _numbers(self.body_a), _numbers(self.body_b)
        inverse = 1.0 / masses[np.asarray(a)] + (1.0 / masses[np.asarray(b)] if b else 0.0)
        oscillation = np.sqrt(np.asarray(self.stiffness) * inverse)
        return np.maximum(oscillation, np.asarray(self.damping) * inverse).max()

    def _points(self, point: Vector) -> Vector:
        return jnp.broadcast_to(point, (len(_numbers(self.body_a)), 3))

    def _line(self, state_a: State, state_b: State | None) -> tuple[Vector, Vector]:
        """From the point on a to the point on b, and its rate of change: (springs, 3) each."""
        at_a = self._points(self.point_a)
        start, velocity = state_a.point_position(at_a), state_a.point_velocity(at_a)
        end = self._points(self.point_b)
        if state_b is None:
            return end - start, -velocity
        return state_b.point_position(end) - start, state_b.point_velocity(end) - velocity

    def _tension(self, state_a: State, state_b: State | None) -> Vector:
        """The force on a, (springs, 3) [N]."""
        line, rate = self._line(state_a, state_b)
        length = norm(line)
        direction = unit_or(line, jnp.zeros_like(line))
        pull = self.stiffness * (length - self.rest_length) + self.damping * dot(direction, rate)
        # At zero length both are zero; k · line has the derivative that a spring without rest length has there.
        coincident = length[:, None] == 0
        return jnp.where(coincident, jnp.reshape(self.stiffness, (-1, 1)) * line, pull[:, None] * direction)


def _numbers(bodies: int | tuple[int, ...] | None) -> tuple[int, ...]:
    if bodies is None:
        return ()
    return bodies if isinstance(bodies, tuple) else (bodies,)
