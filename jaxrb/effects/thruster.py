"""Forces and torques that are given, not caused by the motion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.checks import as_array, check_quantity, is_concrete, quantity
from jaxrb.effects.effect import Force, Wrench
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.math.arrays import Array, Vector
from jaxrb.math.vector import cross


class BodyThruster(Force):
    """A force fixed in the body: `force` (3,) [N] in the body frame at `point` (3,) [m] of the body frame."""

    force: Vector = quantity((3,), unit="N")
    point: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        return Wrench(state.orientation.rotate(self.force), cross(self.point, self.force))


class PrescribedTorque(Force):
    """A torque [N m] in the body frame: a constant `torque` (3,), or its course over time.

    With `times` (k,) [s], ascending, `torque` is (k, 3) and is interpolated linearly, constant beyond the ends. The
    course is the same for all bodies on which it acts.
    """

    torque: Vector = quantity((3,), unit="N m")
    times: Array | None = eqx.field(default=None, kw_only=True)

    def __post_init__(self):
        super().__post_init__()
        if self.times is None:
            return
        self.times = times = as_array("PrescribedTorque.times", self.times)
        if times.ndim != 1 or np.shape(self.torque) != (*times.shape, 3):
            raise WrongStructure(
                f"PrescribedTorque: times {times.shape} and torque {np.shape(self.torque)}; give (k,) and (k, 3)"
            )
        check_quantity("PrescribedTorque.times", times, unit="s")
        if is_concrete(times) and (np.diff(times) <= 0).any():
            first = np.asarray(times)[1:][np.diff(times) <= 0][0]
            raise InvalidInput(
                f"PrescribedTorque.times must ascend, but {first} s does not come after the one before"
            )

    def check(self, count: int) -> None:
        if self.times is None:
            super().check(count)
        else:  # the leading axis of the torque runs over the times
            self.check_bodies(count)

    def _axes(self):
        return super()._axes() if self.times is None else jax.tree.map(lambda _: None, self)

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        if self.times is None:
            return Wrench(torque=jnp.asarray(self.torque))
        course = jnp.asarray(self.torque)
        return Wrench(torque=jnp.stack([jnp.interp(state.time, self.times, course[:, i]) for i in range(3)]))
