"""The classical Runge–Kutta method."""

import operator
from typing import Any, ClassVar

import equinox as eqx
import jax

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.compensation import compensated_sum, no_remainder
from jaxrb.integrators.method import Method, Rates, advanced, average, moved, rates
from jaxrb.math.arrays import Scalar, Vector, by_components


class RungeKutta4(Method):
    """The classical method of order 4 on the numbers of the representation: four evaluations a step.

    (Kutta 1901, Z. Math. Phys. 46, 435.) At equal steps quaternions are about ten times more accurate than matrices.

    `compensated`: a rollout carries what rounding takes from each sum to the next step, at a sixth more time. It
    pays in long runs of float32: after 1e5 steps the attitude is 2 to 1e5 times more accurate (docs/methods.md), most
    where the motion amplifies errors.
    """

    order: ClassVar[int] = 4
    stability_limit: ClassVar[float] = 2.78
    takes_joints: ClassVar[bool] = True

    compensated: bool = eqx.field(static=True, default=False, kw_only=True)

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        return moved(state, dt, self._mean_rates(dynamics, state, dt, torque), dt)

    def first_remainder(self, state: State) -> Rates | None:
        return no_remainder(state) if self.compensated else None

    def free_step(
        self, dynamics: Dynamics, state: State, remainder: Rates | None, dt: Scalar, torque: Vector | None
    ) -> tuple[State, Any]:
        if remainder is None:
            return super().free_step(dynamics, state, remainder, dt, torque)
        with jax.named_scope("compensated"):
            change = jax.tree.map(lambda rate: dt * rate, self._mean_rates(dynamics, state, dt, torque))
            if self.renormalise:
                # In the same sum: a projection after it would round again, and nothing would catch that.
                turn = jax.tree.map(operator.add, change.orientation, state.orientation.projecting_change())
                change = Rates(change.position, turn, change.velocity, change.angular_velocity)
            return compensated_sum(state, remainder, change, dt)

    def _mean_rates(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> Rates:
        half = 0.5 * dt
        k1 = rates(state, dynamics.acceleration(state, torque))
        second = moved(state, half, k1, half)
        k2 = rates(second, dynamics.acceleration(second, torque))
        third = moved(state, half, k2, half)
        k3 = rates(third, dynamics.acceleration(third, torque))
        last = moved(state, dt, k3, dt)
        k4 = rates(last, dynamics.acceleration(last, torque))
        mean = average((1 / 6, 1 / 3, 1 / 3, 1 / 6), [k1, k2, k3, k4])
        if k1.velocity is None:
            return mean
        # The mean of the four velocities, as v + dt (a₁ + a₂ + a₃)/6 (Nyström 1925): where no force depends on the
        # velocity, those of the stages need not be formed: a sphere under gravity takes 16 ns a step instead of 20.
        pushed = by_components(lambda a, b, c: a + b + c, k1.velocity, k2.velocity, k3.velocity)
        position = advanced(state.velocity, dt / 6.0, pushed)
        return Rates(position, mean.orientation, mean.velocity, mean.angular_velocity)
