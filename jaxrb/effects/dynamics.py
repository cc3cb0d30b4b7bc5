"""The equations of motion of a scene: bodies and effects made ready for a run.

An integrator sees nothing else of a scene. What does not change from step to step (inverse masses and inertias, the
cast to the state's precision) is computed here, once a run.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body.euler_equation import InertiaSolver, solver
from jaxrb.body.freedom import (
    FIXED,
    FREE,
    Freedom,
    angular_mask,
    axis_of,
    kept,
    linear_mask,
    moves,
    name_of,
    restricted,
    rotating_inertia,
    turns_freely,
)
from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.body.unturned import Unturned, eased, plain
from jaxrb.effects.effect import Effect, Wrench
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.effects.prescribed_motion import PrescribedMotion
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion


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
    driven: tuple[PrescribedMotion, ...] = ()
    joints: Any = None  # what solves for the forces of joints (`joints/system.py`); None where there are none
    freedoms: tuple[Freedom, ...] | None = eqx.field(static=True, default=None)  # None: every body is free

    def wrench(self, state: State, torque: Vector | None = None) -> Wrench:
        """Sum of all effects, the applied body torque and the forces of joints, in the components that can move."""
        state = self.seen(state)
        total = self.applied(state, torque)
        return total if self.joints is None else self.joints.wrench(self, state, total)

    def applied(self, state: State, torque: Vector | None) -> Wrench:
        """The same without the forces of joints, at a state that was `seen`."""
        total = Wrench(torque=torque)
        for effect in self.effects:
            total = total + effect.wrench_on(self.bodies, state)
        for fixed in self.fixed_points:
            total = fixed.about_point(total, state)
        if self.freedoms is None:
            return total
        return Wrench(
            kept(total.force, linear_mask(self.freedoms)), kept(total.torque, angular_mask(self.freedoms))
        )

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
        for constraint in (*self.fixed_points, *self.driven):
            state = constraint.complete(state)
        return state if self.joints is None else self.joints.complete(self, state)

    def eased(self, state: State, *, one_angle: bool) -> State:
        """The state as a method is to advance it: an orientation that cannot change is one that no method updates, and
        one that changes by an angle is that angle, where the method and the representation can do with `one_angle`."""
        if self.freedoms is None or turns_freely(self.freedoms) or isinstance(state.orientation, Unturned):
            return state
        axis = axis_of(self.freedoms)
        if axis is not None and not (
            one_angle and isinstance(state.orientation, (Quaternion, RotationMatrix))
        ):
            return state
        return eqx.tree_at(lambda s: s.orientation, state, eased(state.orientation, axis))

    @property
    def nothing_between(self) -> bool:
        """Whether the method alone changes the state from step to step: a run may then carry it as `eased`."""
        return self.contact is None and self.joints is None and not self.fixed_points and not self.driven

    def restored(self, old: State, new: State, *, renormalise: bool) -> State:
        """The advanced state as it was given before the step, `eased` or not; what cannot move is where it was."""
        if self.freedoms is None:
            return new
        position = new.position if moves(self.freedoms) else old.position
        orientation: Any = new.orientation
        if isinstance(old.orientation, Unturned):
            orientation = orientation.carried()
        else:
            orientation = plain(orientation, renormalise=renormalise)
        return State(position, orientation, new.velocity, new.angular_velocity, new.time)

    def seen(self, state: State) -> State:
        """The state as effects see it, also in the middle of a step: driven bodies where they then are."""
        if self.freedoms is None:
            return state
        state = eqx.tree_at(lambda s: s.orientation, state, plain(state.orientation))
        for driver in self.driven:
            state = driver.complete(state)
        return state


def prepare(
    bodies: MassProperties,
    effects: tuple[Effect, ...],
    dtype: Any,
    contact: Any = None,
    freedoms: tuple[Freedom, ...] | None = None,
    joints: Any = None,
) -> Dynamics:
    """The dynamics of bodies (with a bodies axis) under effects, for states of this floating type.

    `freedoms`: of each body; None is free.
    """

    def cast(leaf: Any) -> Any:
        return jnp.asarray(leaf, dtype) if eqx.is_inexact_array(leaf) else leaf

    bodies, effects, contact, joints = jax.tree.map(cast, (bodies, effects, contact, joints))
    fixed = tuple(effect for effect in effects if isinstance(effect, FixedPoint))
    _check_held_once(fixed, bodies.mass.shape[0])
    driven = tuple(effect for effect in effects if isinstance(effect, PrescribedMotion))
    freedoms = _freedoms(freedoms, fixed, driven, bodies.mass.shape[0])
    rotating = rotating_inertia(bodies.inertia, freedoms)
    for point in fixed:
        rotating = point.inertia_about_point(MassProperties(bodies.mass, bodies.center_of_mass, rotating))
    resolved = (FixedPoint, PrescribedMotion, RigidContact)
    active = tuple(effect for effect in effects if not isinstance(effect, resolved))
    return Dynamics(
        bodies,
        1.0 / bodies.mass,
        solver(rotating),
        active,
        fixed,
        contact,
        driven,
        joints,
        restricted(freedoms),
    )


def _freedoms(
    given: tuple[Freedom, ...] | None,
    fixed: tuple[FixedPoint, ...],
    driven: tuple[PrescribedMotion, ...],
    count: int,
) -> tuple[Freedom, ...]:
    """The freedom of each body; one whose motion is given has none of its own."""
    freedoms = [FREE] * count if given is None else list(given)
    for driver in driven:
        if freedoms[driver.body] != FREE:
            raise WrongStructure(
                f"PrescribedMotion: body {driver.body} {name_of(freedoms[driver.body])}, or is driven already; "
                "prescribe the motion of a free body, once"
            )
        freedoms[driver.body] = FIXED
    for point in fixed:
        for body in point.chosen(count):
            if freedoms[body] != FREE:
                raise WrongStructure(
                    f"FixedPoint: body {body} {name_of(freedoms[body])} or is driven; hold a point of a free body, or "
                    "restrict the body alone"
                )
    return tuple(freedoms)


def _check_held_once(fixed: tuple[FixedPoint, ...], count: int) -> None:
    held = [body for point in fixed for body in point.chosen(count)]
    for body in held:
        if held.count(body) > 1:
            raise WrongStructure(
                f"body {body} is held by more than one FixedPoint; hold one point of it, and another by a stiff spring"
            )
