"""The classical Runge–Kutta method."""

from typing import ClassVar

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.method import Method, average, moved, rates
from jaxrb.math.arrays import Scalar, Vector


class RungeKutta4(Method):
    """The classical method of order 4 on the numbers of the representation: four evaluations a step.

    (Kutta 1901, Z. Math. Phys. 46, 435.) At equal steps quaternions are about ten times more accurate than matrices.
    """

    order: ClassVar[int] = 4
    stability_limit: ClassVar[float] = 2.78

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        half = 0.5 * dt
        k1 = rates(state, dynamics.acceleration(state, torque))
        second = moved(state, half, k1, half)
        k2 = rates(second, dynamics.acceleration(second, torque))
        third = moved(state, half, k2, half)
        k3 = rates(third, dynamics.acceleration(third, torque))
        last = moved(state, dt, k3, dt)
        k4 = rates(last, dynamics.acceleration(last, torque))
        return moved(state, dt, average((1 / 6, 1 / 3, 1 / 3, 1 / 6), [k1, k2, k3, k4]), dt)
