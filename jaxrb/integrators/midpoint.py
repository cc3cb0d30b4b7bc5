"""The implicit midpoint rule."""

from typing import ClassVar

import equinox as eqx
import jax

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.method import Method, advanced
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.rotation import Rotation


class ImplicitMidpoint(Method):
    """y₁ = y₀ + dt f((y₀ + y₁)/2). Order 2, symmetric in time, keeps every quadratic invariant: |q|, RᵀR, the energy
    and the squared momentum of a free body, all to round-off.

    The orientation is solved in closed form (a Cayley map); the gyroscopic term by Newton's method; the wrench by
    repetition: `sweeps` rounds, of which each gains a factor (dt·rate/2)² for oscillations of that rate. For stiff
    springs take smaller steps or more sweeps.
    (Hairer, Lubich, Wanner, "Geometric Numerical Integration", 2006, section IV.2.1.)
    """

    order: ClassVar[int] = 2
    stability_limit: ClassVar[float] = 1.0
    takes_joints: ClassVar[bool] = True
    needs_group: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True
    sweeps: int = eqx.field(static=True, default=5)

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        half = 0.5 * dt
        velocity, omega = state.velocity, state.angular_velocity
        # Joints are among the effects.
        sweeps = self.sweeps if dynamics.effects or dynamics.fixed_points else 1
        for _ in range(sweeps):
            middle = State(
                advanced(state.position, half, velocity),
                _halfway(state.orientation, _carried(state.orientation, dt * omega)),
                velocity,
                omega,
                state.time + half,
            )
            wrench = dynamics.wrench(middle, torque)
            velocity = advanced(state.velocity, half, dynamics.linear_acceleration(wrench))
            # The last rounds start from a converged ω: one Newton step each; a free body takes all of them at once.
            newton = 1 if sweeps > 1 else self.sweeps
            omega = dynamics.inertia.implicit_velocity(
                state.angular_velocity, omega, wrench.torque, half, newton
            )
        return State(
            advanced(state.position, dt, velocity),
            _carried(state.orientation, dt * omega),
            2.0 * velocity - state.velocity if velocity is not state.velocity else velocity,
            2.0 * omega - state.angular_velocity if omega is not state.angular_velocity else omega,
            state.time,
        )


def _carried(orientation: Rotation, rotation_vector: Vector) -> Rotation:
    return orientation @ type(orientation).cayley(rotation_vector)


def _halfway(a: Rotation, b: Rotation) -> Rotation:
    return jax.tree.map(lambda x, y: x if x is y else 0.5 * (x + y), a, b)
