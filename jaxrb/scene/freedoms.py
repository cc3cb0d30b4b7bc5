"""What bodies that are not free demand of a scene and of its states; checked on the host."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrb.body.freedom import FREE, Freedom, angular_mask, linear_mask, name_of, restricted
from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.effects.effect import Effect
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.effects.prescribed_motion import PrescribedMotion
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import InvalidInput, WrongStructure


def check_struck_plainly(run: str, freedoms: Sequence[Freedom], effects: Sequence[Effect]) -> None:
    """Refuse rigid contact of bodies that are not free, or that resists turning, in a `run` whose impacts know neither.

    Raises:
        WrongStructure: naming the body and what else to do.
    """
    driven = {effect.body: effect for effect in effects if isinstance(effect, PrescribedMotion)}
    for effect in effects:
        if not isinstance(effect, RigidContact):
            continue
        if effect.resists:
            raise WrongStructure(
                f"{run}: RigidContact resists rolling or spinning, which this run does not know; use rb.rollout"
            )
        for body in effect.chosen(len(freedoms)):
            if freedoms[body] == FREE and body not in driven:
                continue
            what = "moves as PrescribedMotion says" if body in driven else name_of(freedoms[body])
            raise WrongStructure(
                f"{run}: RigidContact of body {body}, which {what}: the impacts of this run do not know that; use "
                "rb.rollout, leave it out by bodies=(…), or give what stands still to RigidContact(against=…)"
            )


def check_joints(effects: Sequence[Effect]) -> None:
    """Refuse joints beside what moves bodies in ways that joints do not know.

    Raises:
        WrongStructure: naming the effect, the body and what else to do.
    """
    joints: list[Any] = [effect for effect in effects if effect.joins]
    if not joints:
        return
    jointed = {body for joint in joints for body in joint.members}
    for effect in effects:
        if isinstance(effect, PrescribedMotion) and effect.body in jointed:
            raise WrongStructure(
                f"PrescribedMotion: body {effect.body} has a joint, whose forces its acceleration would enter; drive "
                "it by JointServo or JointMotor"
            )
        if isinstance(effect, FixedPoint) and (effect.bodies is None or jointed & set(effect.bodies)):
            raise WrongStructure(
                "FixedPoint: it holds a body that has a joint; hold the point by BallJoint(bodies=(body, None)) instead"
            )


def check_motion(freedoms: Sequence[Freedom], state: State) -> None:
    """Refuse a state in which a body moves as its freedom forbids. Traced numbers are not looked at.

    Raises:
        InvalidInput: naming the body, the velocity and the component.
    """
    if restricted(freedoms) is None:
        return
    for name, unit, value, mask in (
        ("velocity", "m/s", state.velocity, linear_mask(freedoms)),
        ("angular_velocity", "rad/s", state.angular_velocity, angular_mask(freedoms)),
    ):
        if not is_concrete(value):
            continue
        bad = (np.asarray(value) != 0) & ~mask
        if bad.any():
            body, axis = np.argwhere(bad)[0]
            raise InvalidInput(
                f"state.{name} of body {body} is {np.asarray(value)[body].tolist()} {unit}, but the body "
                f"{name_of(freedoms[body])}: its component {axis} must be zero"
            )


def check_driven(effects: Sequence[Effect], given: dict[str, Any], state: State, placed: State) -> None:
    """Refuse velocities that contradict a prescribed motion, where the user gave any but zero.

    Raises:
        InvalidInput: naming the body and both velocities.
    """
    for effect in effects:
        if not isinstance(effect, PrescribedMotion):
            continue
        for name, value in given.items():
            here, there = getattr(state, name), getattr(placed, name)
            if value is None or not (is_concrete(here) and is_concrete(there)):
                continue
            here, there = np.asarray(here, float)[effect.body], np.asarray(there, float)[effect.body]
            if here.any() and np.abs(here - there).max() > 1e-4 * (1.0 + np.abs(there).max()):
                raise InvalidInput(
                    f"state.{name} of body {effect.body} is {here.tolist()}, but its PrescribedMotion gives it "
                    f"{there.tolist()}; leave it zero"
                )
