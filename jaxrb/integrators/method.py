"""The abstract method, and the algebra of states and their rates that the methods share."""

import functools
import operator
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax

from jaxrb.body.state import State
from jaxrb.effects.dynamics import Acceleration, Dynamics
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Array, Scalar, Vector, by_components
from jaxrb.math.rotation import Rotation


class Method(eqx.Module):
    """One way to advance a state by one step. Methods are written once, for every representation of rotations.

    `renormalise` projects the orientation back to an exact rotation after each step. Switched off, the drift of the
    representation shows.
    """

    order: eqx.AbstractClassVar[int]
    # dt times the fastest rate of the effects must stay below this for the step to be stable.
    stability_limit: eqx.AbstractClassVar[float]
    needs_group: ClassVar[bool] = False  # True where Euler angles cannot serve
    symmetric: ClassVar[bool] = False  # True where a step of −dt undoes a step of dt
    one_angle: ClassVar[bool] = (
        True  # True where it asks nothing of an orientation but its derivative, exp or cayley
    )

    takes_joints: ClassVar[bool] = (
        False  # True where it asks for the accelerations alone, whatever they depend on
    )

    renormalise: bool = eqx.field(static=True, default=True, kw_only=True)

    def advance(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None) -> State:
        """The state one step of `dt` [s] later, before projection."""
        raise NotImplementedError

    def project(self, orientation: Rotation) -> Rotation:
        """The orientation after a step, as an exact rotation if so asked."""
        return orientation.renormalise() if self.renormalise else orientation

    def first_remainder(self, state: State) -> Any:
        """What a run carries from step to step beside the state; None for a method that carries nothing."""
        return None

    def free_step(
        self, dynamics: Dynamics, state: State, remainder: Any, dt: Scalar, torque: Vector | None
    ) -> tuple[State, Any]:
        """One step without contact: advance, project, count the time; and what to carry to the next."""
        new = self.advance(dynamics, state, dt, torque)
        orientation = self.project(new.orientation)
        return State(
            new.position, orientation, new.velocity, new.angular_velocity, state.time + dt
        ), remainder

    def first_carry(self, dynamics: Dynamics, state: State) -> Any:
        """What `carried_step` wants to be given at the start of a run."""
        if dynamics.joints is not None and not self.takes_joints:
            raise WrongStructure(
                f"{type(self).__name__} takes bodies to fly freely between pushes, which jointed ones do not; use "
                "RungeKutta4, VelocityVerlet, ImplicitMidpoint, or rb.solve"
            )
        memory = None if dynamics.contact is None else dynamics.contact.first_memory(state)
        return self.first_remainder(state), memory

    def held(self, dynamics: Dynamics, state: State) -> State:
        """The state as a run carries it from step to step; `shown` undoes it."""
        if not dynamics.nothing_between:
            return state
        held = dynamics.eased(state, one_angle=self.one_angle and self.first_remainder(state) is None)
        if held is state or not self.renormalise:
            return held
        # Once for the whole run: an angle needs no projection after it.
        return eqx.tree_at(lambda s: s.orientation.rotation, held, state.orientation.renormalise())

    def carried_step(
        self, dynamics: Dynamics, state: State, carry: Any, dt: Scalar, torque: Vector | None = None
    ) -> tuple[State, Any]:
        """One whole step within a run, with constrained bodies in their place, and what to carry to the next."""
        remainder, memory = carry
        with jax.named_scope(type(self).__name__):
            start = dynamics.eased(state, one_angle=self.one_angle and remainder is None)
            new, remainder = self.free_step(dynamics, start, remainder, dt, torque)
            new = dynamics.restored(state, new, renormalise=self.renormalise)
        if dynamics.contact is not None:
            with jax.named_scope("RigidContact"):
                new, memory = dynamics.contact.resolved(dynamics, state, new, dt, memory)
        return dynamics.complete(new), (remainder, memory)

    def step(self, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None = None) -> State:
        """One whole step on its own."""
        return self.carried_step(dynamics, state, self.first_carry(dynamics, state), dt, torque)[0]


def contact_report(carry: Any) -> Any:
    """What contact has done so far, of what `carried_step` carries; None in a scene without contact."""
    return None if carry[1] is None else carry[1].report


class Rates(eqx.Module):
    """Time derivative of a state. None is a rate that is zero by type."""

    position: Vector
    orientation: Rotation
    velocity: Vector | None
    angular_velocity: Vector | None


def rates(state: State, acceleration: Acceleration) -> Rates:
    """The derivative of a state whose accelerations are known."""
    return Rates(
        state.velocity,
        state.orientation.derivative(state.angular_velocity),
        acceleration.linear,
        acceleration.angular,
    )


def moved(state: State, span: Scalar, rate: Rates, after: Scalar) -> State:
    """state + span · rate, at time state.time + after."""
    return State(
        advanced(state.position, span, rate.position),
        jax.tree.map(lambda x, r: advanced(x, span, r), state.orientation, rate.orientation),
        advanced(state.velocity, span, rate.velocity),
        advanced(state.angular_velocity, span, rate.angular_velocity),
        state.time + after,
    )


def moved_by_mean(state: State, span: Scalar, weights: tuple[float, ...], stages: list[Rates]) -> State:
    """state + span · Σ weights · stages, for weights that add up to one.

    Each sum is formed at once: as a mean and then a move it is one more loop over the bodies, a tenth of a sphere's
    step.
    """

    def summed(value: Array, *given: Array | None) -> Array:
        if all(rate is given[0] for rate in given):
            return advanced(value, span, given[0])
        return by_components(lambda x, *parts: x + span * _weighted(weights, parts), value, *given)

    return State(
        summed(state.position, *(stage.position for stage in stages)),
        jax.tree.map(summed, state.orientation, *(stage.orientation for stage in stages)),
        summed(state.velocity, *(stage.velocity for stage in stages)),
        summed(state.angular_velocity, *(stage.angular_velocity for stage in stages)),
        state.time + span,
    )


def advanced(value: Array, span: Scalar, rate: Array | None) -> Array:
    """value + span · rate; a rate of None leaves the value alone, and nothing is compiled."""
    return value if rate is None else by_components(lambda x, r: x + span * r, value, rate)


def average(weights: tuple[float, ...], values: list[Any]) -> Any:
    """Weighted sum of trees whose weights add up to one. A leaf that never changed stays itself, at no cost."""

    def mean(*leaves: Array) -> Array:
        if all(leaf is leaves[0] for leaf in leaves):
            return leaves[0]
        return by_components(lambda *parts: _weighted(weights, parts), *leaves)

    return jax.tree.map(mean, *values)


def _weighted(weights: tuple[float, ...], parts: Sequence[jax.Array]) -> jax.Array:
    return functools.reduce(operator.add, [w * part for w, part in zip(weights, parts, strict=True)])
