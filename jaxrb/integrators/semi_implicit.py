"""Semi-implicit (symplectic) Euler: what most game and robotics engines step with."""

from typing import ClassVar

import equinox as eqx

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.euler import turned
from jaxrb.integrators.method import Method, Rates, advanced, moved
from jaxrb.math.arrays import Scalar, Vector


class SemiImplicitEuler(Method):
    """First the velocities from the old pose, then the pose from the new velocities. Order 1.

    Bounded energy error for forces that depend on position alone; Euler's gyroscopic term, which depends on ω, is taken
    explicitly and is not covered by that. `finite_rotation` as in `ExplicitEuler`.
    (Hairer, Lubich, Wanner, "Geometric Numerical Integration", 2006, section I.1.)
    """

    order: ClassVar[int] = 1
    stability_limit: ClassVar[float] = 2.0
    takes_joints: ClassVar[bool] = True
    finite_rotation: bool = eqx.field(static=True, default=False)

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        acceleration = dynamics.acceleration(state, torque)
        velocity = advanced(state.velocity, dt, acceleration.linear)
        omega = advanced(state.angular_velocity, dt, acceleration.angular)
        if self.finite_rotation:
            position, orientation = (
                advanced(state.position, dt, velocity),
                turned(state.orientation, dt * omega),
            )
            return State(position, orientation, velocity, omega, state.time)
        pose = moved(state, dt, Rates(velocity, state.orientation.derivative(omega), None, None), dt)
        return State(pose.position, pose.orientation, velocity, omega, state.time)
