"""Velocity Verlet for translation and rotation."""

from typing import ClassVar

import equinox as eqx

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.euler import turned
from jaxrb.integrators.method import Method, advanced
from jaxrb.math.arrays import Scalar, Vector


class VelocityVerlet(Method):
    """Half a kick, a whole drift, half a kick. Order 2.

    The first half kick of the spin is explicit and the second implicit in the gyroscopic term (`newton_steps` of
    Newton's method from ω itself), which makes the step of a free body symmetric in time; the drift is the exact finite
    rotation. Forces that depend on velocity see the extrapolated velocity at the end of the step: still order 2, no
    longer symmetric. The force is evaluated twice a step.
    (Verlet 1967, Phys. Rev. 159, 98; Swope et al. 1982, J. Chem. Phys. 76, 637.)
    """

    order: ClassVar[int] = 2
    stability_limit: ClassVar[float] = 2.0
    takes_joints: ClassVar[bool] = True
    newton_steps: int = eqx.field(static=True, default=3)

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        half = 0.5 * dt
        first = dynamics.acceleration(state, torque)
        velocity = advanced(state.velocity, half, first.linear)
        omega = advanced(state.angular_velocity, half, first.angular)
        end = State(
            advanced(state.position, dt, velocity),
            turned(state.orientation, dt * omega),
            advanced(velocity, half, first.linear),
            advanced(omega, half, first.angular),
            state.time + dt,
        )
        wrench = dynamics.wrench(end, torque)
        return State(
            end.position,
            end.orientation,
            advanced(velocity, half, dynamics.linear_acceleration(wrench)),
            dynamics.inertia.implicit_velocity(
                omega, end.angular_velocity, wrench.torque, half, self.newton_steps
            ),
            state.time,
        )
