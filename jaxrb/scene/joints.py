"""Joints as a user reads and closes them: errors, reactions, assembly."""

import jax
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.effects.effect import Wrench
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.joints.readings import JointError, error_of, reactions_of
from jaxrb.math.arrays import Vector
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import applied_torque


@jax.jit
def joint_error(scene: Scene, state: State) -> JointError:
    """How far each joint is open, in the order of the scene's effects: gap [m], angle [rad] and rate, (joints,) each.

    Raises:
        WrongStructure: a scene without joints.
    """
    _check(scene, state, "joint_error")
    return error_of(scene.prepared(state.dtype), state)


def joint_reactions(scene: Scene, state: State, torque: Vector | None = None) -> tuple[Wrench, ...]:
    """What each joint of the scene exerts on its body a, one `Wrench` for each joint among the effects.

    `force` (k, 3) [N] in the world at the anchor of a, and `torque` (k, 3) [N m] about it in the frame of a, for the k
    joints in the value; body b feels the opposite. Drives are not in it. Where joints say a thing twice, what each
    bears is not determined: the smallest forces that do are returned.

    Args:
        scene, state: as for `step`.
        torque: applied body torque [N m], (n, 3) or (3,).
    """
    _check(scene, state, "joint_reactions")
    return _reactions(scene, state, applied_torque(torque, state))


def assembled(scene: Scene, state: State) -> State:
    """The state with all joints closed, found by Newton's method from a rough one.

    Bodies move and turn along what the joints' forces would do to them, heavy ones less; then velocities lose what
    opens joints, by the smallest change of kinetic energy. Differentiable, forward and reverse.

    Raises:
        InvalidInput: the joints cannot be closed from there, by how much (not while being traced).
        WrongStructure: a scene without joints.
    """
    _check(scene, state, "assembled")
    closed, error = _assembled(scene, state)
    if is_concrete(error.gap):
        gap, angle = (float(np.max(part, initial=0.0)) for part in (error.gap, error.angle))
        limit = 1e-8 if state.dtype == np.float64 else 1e-3
        if not (gap <= limit * (1.0 + float(np.abs(closed.position).max())) and angle <= limit):
            raise InvalidInput(
                f"assembled: from this start the joints stay open by {gap:.3g} m and {angle:.3g} rad; start nearer to "
                "how the parts fit, and look whether they can"
            )
    return closed


def _check(scene: Scene, state: State, where: str) -> None:
    check_fit(scene, state)
    if not scene.jointed:
        raise WrongStructure(f"{where}: the scene has no joints; put BallJoint, Hinge, … among its effects")


@jax.jit
def _reactions(scene: Scene, state: State, torque: Vector | None) -> tuple[Wrench, ...]:
    return reactions_of(scene.prepared(state.dtype), state, torque)


@jax.jit
def _assembled(scene: Scene, state: State) -> tuple[State, JointError]:
    dynamics = scene.prepared(state.dtype)
    closed = dynamics.joints.assembled(dynamics, state)
    return closed, error_of(dynamics, closed)
