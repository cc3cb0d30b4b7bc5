"""The equations of motion of a scene: bodies and effects made ready for a run.

An integrator sees nothing else of a scene. What does not change from step to step (inverse masses and inertias, the
cast to the state's precision) is computed here, once a run.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body.euler_equation import InertiaSolver, solver
from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.effects.effect import Effect, Wrench
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Scalar, Vector


class Acceleration(eqx.Module):
    """v̇ (n, 3) [m/s²] in the world frame and ω̇ (n, 3) [rad/s²] in the body frame; None is zero by type."""

    linear: Vector | None
    angular: Vector | None


class Dynamics(eqx.Module):
    """Newton's and Euler's equations of a scene's bodies under its effects. Arrays have the bodies axis."""

    bodies: MassProperties
    inverse_mass: Scalar
    inertia: InertiaSolver
    effects: tuple[Effect, ...]
    fixed_points: tuple[FixedPoint, ...]
    contact: Any = (
        None  # what resolves the bodies' contacts after a step (`contact/step.py`); None where none can be
    )

    def wrench(self, state: State, torque: Vector | None = None) -> Wrench:
        """Sum of all effects and the applied body torque."""
        total = Wrench(torque=torque)
        for effect in self.effects:
            total = total + effect.wrench_on(self.bodies, state)
        for fixed in self.fixed_points:
            total = fixed.about_point(total, state)
        return total

    def linear_acceleration(self, wrench: Wrench) -> Vector | None:
        """v̇ = F/m."""
        return None if wrench.force is None else wrench.force * self.inverse_mass[:, None]

    def acceleration(self, state: State, torque: Vector | None = None) -> Acceleration:
        """The accelerations at a state."""
        wrench = self.wrench(state, torque)
        angular = self.inertia.acceleration(state.angular_velocity, wrench.torque)
        return Acceleration(self.linear_acceleration(wrench), angular)

    def complete(self, state: State) -> State:
        """The state with everything that constraints determine put in its place."""
        for fixed in self.fixed_points:
            state = fixed.complete(state)
        return state


def prepare(bodies: MassProperties, effects: tuple[Effect, ...], dtype: Any, contact: Any = None) -> Dynamics:
    """The dynamics of bodies (with a bodies axis) under effects, for states of this floating type."""

    def cast(leaf: Any) -> Any:
        return jnp.asarray(leaf, dtype) if eqx.is_inexact_array(leaf) else leaf

    bodies, effects, contact = jax.tree.map(cast, (bodies, effects, contact))
    fixed = tuple(effect for effect in effects if isinstance(effect, FixedPoint))
    _check_held_once(fixed, bodies.mass.shape[0])
    rotating = bodies.inertia
    for point in fixed:
        rotating = point.inertia_about_point(MassProperties(bodies.mass, bodies.center_of_mass, rotating))
    active = tuple(effect for effect in effects if not isinstance(effect, (FixedPoint, RigidContact)))
    return Dynamics(bodies, 1.0 / bodies.mass, solver(rotating), active, fixed, contact)


def _check_held_once(fixed: tuple[FixedPoint, ...], count: int) -> None:
    held = [body for point in fixed for body in point.chosen(count)]
    for body in held:
        if held.count(body) > 1:
            raise WrongStructure(
                f"body {body} is held by more than one FixedPoint; hold one point of it, and another by a stiff spring"
            )
