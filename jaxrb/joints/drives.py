"""What acts along the free coordinate of a joint: springs, stops, motors, servos.

The coordinate x is an angle [rad] of a hinge or a travel [m] of a slider; the effort a torque [N m] or a force [N]
along it. A coefficient is one number for all joints of the value, or one a joint.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.checks import Checked, is_concrete, quantity
from jaxrb.errors import InvalidInput
from jaxrb.math.arrays import Scalar


class Drive(Checked):
    """Something that pushes along the coordinate of a joint."""

    def effort(self, coordinate: Scalar, rate: Scalar) -> Scalar:
        """The push (k,) along the coordinates (k,) [rad or m] with these rates."""
        raise NotImplementedError

    def energy(self, coordinate: Scalar) -> Scalar | None:
        """Potential energy (k,) [J]; None where there is none."""
        return None

    def fastest(self, inverse_inertia: np.ndarray) -> Any:
        """Estimate on the host of the fastest rate [1/s] on something of this inverse inertia."""
        stiffness, damping = (np.asarray(getattr(self, name, 0.0)) for name in ("stiffness", "damping"))
        return np.maximum(np.sqrt(stiffness * inverse_inertia), damping * inverse_inertia)


class JointSpring(Drive):
    """Effort −k (x − `rest`) − d ẋ: `stiffness` k [N m/rad or N/m], `damping` d [N m s/rad or N s/m]."""

    stiffness: Scalar = quantity((), nonnegative=True, unit="N m/rad or N/m", default=0.0)
    damping: Scalar = quantity((), nonnegative=True, unit="N m s/rad or N s/m", default=0.0)
    rest: Scalar = quantity((), unit="rad or m", default=0.0)

    def effort(self, coordinate: Scalar, rate: Scalar) -> Scalar:
        return -self.stiffness * (coordinate - self.rest) - self.damping * rate

    def energy(self, coordinate: Scalar) -> Scalar:
        return 0.5 * self.stiffness * (coordinate - self.rest) ** 2


class JointLimit(Drive):
    """Stops at `lower` and `upper`: beyond them, at depth s, an effort k s (1 + c ṡ) that never pulls.

    `stiffness` k [N m/rad or N/m], `dissipation` c [s/rad or s/m]: of a blow at speed v about 2/3 c v is lost (Hunt and
    Crossley 1975), and nothing jumps at the stop. Stops are compliant: at rest the coordinate lies effort/k beyond, and
    a blow of an inertia I goes on for v √(I/k). Choose k by what overshoot is allowed, and a step that resolves it (the
    run warns of one that does not).
    """

    lower: Scalar = quantity((), unit="rad or m")
    upper: Scalar = quantity((), unit="rad or m")
    stiffness: Scalar = quantity((), nonnegative=True, unit="N m/rad or N/m")
    dissipation: Scalar = quantity((), nonnegative=True, unit="s/rad or s/m", default=0.0)

    def __post_init__(self):
        super().__post_init__()
        ends = self.lower, self.upper
        if all(is_concrete(end) for end in ends) and np.any(np.asarray(self.lower) > np.asarray(self.upper)):
            raise InvalidInput(f"JointLimit: lower {self.lower} is above upper {self.upper}; swap them")

    def effort(self, coordinate: Scalar, rate: Scalar) -> Scalar:
        return self._push(self.lower - coordinate, -rate) - self._push(coordinate - self.upper, rate)

    def energy(self, coordinate: Scalar) -> Scalar:
        above, below = coordinate - self.upper, self.lower - coordinate
        return 0.5 * self.stiffness * (jnp.maximum(above, 0.0) ** 2 + jnp.maximum(below, 0.0) ** 2)

    def _push(self, depth: Scalar, sinking: Scalar) -> Scalar:
        return self.stiffness * jnp.maximum(depth, 0.0) * jnp.maximum(1.0 + self.dissipation * sinking, 0.0)


class JointMotor(Drive):
    """Effort `gain` (`speed` − ẋ), at most `effort_limit` either way; by default without limit."""

    speed: Scalar = quantity((), unit="rad/s or m/s")
    gain: Scalar = quantity((), nonnegative=True, unit="N m s/rad or N s/m")
    effort_limit: Scalar | None = quantity((), nonnegative=True, unit="N m or N", default=None)

    def effort(self, coordinate: Scalar, rate: Scalar) -> Scalar:
        return _limited(self.gain * (self.speed - rate), self.effort_limit)

    def fastest(self, inverse_inertia: np.ndarray) -> Any:
        return np.asarray(self.gain) * inverse_inertia


class JointServo(Drive):
    """Effort k (`target` − x) − d ẋ, at most `effort_limit` either way: holds a position with the strength it has."""

    target: Scalar = quantity((), unit="rad or m")
    stiffness: Scalar = quantity((), nonnegative=True, unit="N m/rad or N/m")
    damping: Scalar = quantity((), nonnegative=True, unit="N m s/rad or N s/m", default=0.0)
    effort_limit: Scalar | None = quantity((), nonnegative=True, unit="N m or N", default=None)

    def effort(self, coordinate: Scalar, rate: Scalar) -> Scalar:
        return _limited(self.stiffness * (self.target - coordinate) - self.damping * rate, self.effort_limit)


def _limited(effort: Scalar, limit: Scalar | None) -> Scalar:
    return effort if limit is None else jnp.clip(effort, -limit, limit)
