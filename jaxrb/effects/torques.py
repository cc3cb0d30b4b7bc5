"""Torques that depend on the attitude or the rate: a magnet in a field, springs that twist, motors."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.body.validity import inertia_matrix
from jaxrb.checks import check_direction, quantity
from jaxrb.effects.effect import Effect, Force, Wrench, check_indices, check_shapes, scattered, taken
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.math.safe import norm
from jaxrb.math.vector import cross, dot


class MagneticTorque(Force):
    """τ = m × B on a magnet: `moment` m (3,) [A m²] in the body frame, `field` B (3,) [T] in the world frame.

    The field is uniform, so there is no force. The potential energy is −m·B.
    """

    moment: Vector = quantity((3,), unit="A m²")
    field: Vector = quantity((3,), unit="T")

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        return Wrench(torque=cross(self.moment, state.orientation.unrotate(jnp.asarray(self.field))))

    def potential_energy(self, body: MassProperties, state: State) -> Scalar:
        return -dot(self.moment, state.orientation.unrotate(jnp.asarray(self.field)))

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        most = np.linalg.norm(self.moment, axis=-1).max() * np.linalg.norm(self.field, axis=-1).max()
        return np.sqrt(most / smallest_moment(bodies))


class Motor(Force):
    """A motor that turns a body about an axis of its own: τ = gain (speed − ω·a), limited, along the axis a.

    `axis` (3,) in the body frame need not have length one; `speed` [rad/s] is what it aims at; `gain` [N m s/rad];
    `torque_limit` [N m], by default none. It takes hold in the world: nothing feels the reaction.
    """

    axis: Vector = quantity((3,))
    speed: Scalar = quantity((), unit="rad/s")
    gain: Scalar = quantity((), nonnegative=True, unit="N m s/rad")
    torque_limit: Scalar | None = quantity((), nonnegative=True, unit="N m", default=None)

    def __post_init__(self):
        super().__post_init__()
        check_direction("Motor.axis", self.axis)

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        axis = jnp.asarray(self.axis) / norm(jnp.asarray(self.axis))
        push = self.gain * (self.speed - dot(state.angular_velocity, axis))
        if self.torque_limit is not None:
            push = jnp.clip(push, -self.torque_limit, self.torque_limit)
        return Wrench(torque=push * axis)

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        return np.max(np.asarray(self.gain)) / smallest_moment(bodies)


class AngularSpring(Effect):
    """A spring that twists: τ = −k θ − d ω_rel, θ the rotation vector [rad] from the rest attitude to the present one.

    `stiffness` k [N m/rad] and `damping` d [N m s/rad] are alike in all directions. It acts on `body_a`, against the
    world, or against `body_b`, which feels the reaction. `rest` is the attitude of a at rest, in the world or as seen
    from b; by default the two frames are parallel. The energy is ½ k |θ|². At half a turn it pulls either way: the
    torque jumps there.
    """

    stiffness: Scalar = quantity((), nonnegative=True, unit="N m/rad")
    damping: Scalar = quantity((), nonnegative=True, unit="N m s/rad", default=0.0)
    rest: Rotation | None = None
    body_a: int = eqx.field(static=True, default=0)
    body_b: int | None = eqx.field(static=True, default=None)

    def check(self, count: int) -> None:
        pair = (self.body_a,) if self.body_b is None else (self.body_a, self.body_b)
        check_indices("AngularSpring", "body_a and body_b", pair, count)
        check_shapes(self, 1, "the spring", "one value")
        if self.body_a == self.body_b:
            raise WrongStructure(f"AngularSpring: body {self.body_a} cannot be twisted against itself")

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        with jax.named_scope("AngularSpring"):
            twist, relative, a_in_b = self._twist(state)
            torque = -self.stiffness * twist - self.damping * relative
            total = scattered(Wrench(torque=torque), np.asarray([self.body_a]), state)
            if self.body_b is None:
                return total
            reaction = Wrench(torque=-a_in_b.rotate(torque))
            return total + scattered(reaction, np.asarray([self.body_b]), state)

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar:
        twist, _, _ = self._twist(state)
        return 0.5 * self.stiffness * jnp.sum(twist**2)

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        moment = smallest_moment(bodies)
        return max(np.sqrt(2.0 * float(self.stiffness) / moment), 2.0 * float(self.damping) / moment)

    def _twist(self, state: State) -> tuple[Vector, Vector, Rotation]:
        """θ and the relative rate, (1, 3) in the frame of a, and the attitude of a as seen from b or the world."""
        a = taken(state, np.asarray([self.body_a]))
        orientation, relative = a.orientation, a.angular_velocity
        if self.body_b is not None:
            b = taken(state, np.asarray([self.body_b]))
            orientation = b.orientation.inverse() @ orientation
            relative = relative - orientation.unrotate(b.angular_velocity)
        # As quaternions whatever the state is: their logarithm loses no digit at small angles.
        turned = Quaternion.from_rotation(orientation)
        if self.rest is not None:
            rest = jax.tree.map(lambda leaf: jnp.asarray(leaf, state.dtype), self.rest)
            turned = Quaternion.from_rotation(rest).inverse() @ turned
        return turned.log(), relative, orientation


def smallest_moment(bodies: MassProperties) -> float:
    """The smallest principal moment of any body that has one [kg m²], on the host; infinite where all are points."""
    moments = np.linalg.eigvalsh(inertia_matrix(bodies.inertia))[..., 0]
    return float(moments.min(initial=np.inf, where=moments > 0))
