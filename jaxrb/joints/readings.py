"""What can be read off joints: how far they are open, and what they bear."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.effects.effect import Wrench
from jaxrb.errors import InvalidInput
from jaxrb.joints.joint import Joint
from jaxrb.joints.rows import places
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.vector import cross


class JointError(eqx.Module):
    """How far each joint of a scene is open, in the order of the effects (joints,).

    `gap` [m] between the points that should meet, or of the distance; `angle` [rad] of the attitude or axis; `rate`
    [m/s or rad/s]: the largest at which a constraint of the joint opens.
    """

    gap: Scalar
    angle: Scalar
    rate: Scalar


def joints_in(effects: tuple[Any, ...]) -> tuple[Joint, ...]:
    """The joints among effects."""
    return tuple(effect for effect in effects if isinstance(effect, Joint))


def error_of(dynamics: Any, state: State) -> JointError:
    """The errors of the joints of a dynamics that has some."""
    system, joints = dynamics.joints, joints_in(dynamics.effects)
    found = [joint.misfit(*places(state, joint.pairs(system.count))) for joint in joints]
    gap, angle = (jnp.concatenate(parts) for parts in zip(*found))
    first = np.cumsum([0, *(joint.count for joint in joints)])
    owner = np.asarray([first[number] + own for number, own in system.owners], np.int32)
    rate = jnp.zeros_like(gap).at[owner].max(jnp.abs(system.opening(state)))
    return JointError(gap, angle, rate)


def reactions_of(dynamics: Any, state: State, torque: Vector | None) -> tuple[Wrench, ...]:
    """What each joint value exerts on its bodies a: force (k, 3) at the anchor, torque (k, 3) about it."""
    system = dynamics.joints
    state = dynamics.seen(state)
    rows = system.rows(state)
    size = system.forces(dynamics, state, dynamics.applied(state, torque), rows)
    owners = np.asarray(system.owners, np.int32)
    found = []
    for number, joint in enumerate(joints_in(dynamics.effects)):
        chosen = np.nonzero(owners[:, 0] == number)[0].astype(np.int32)
        own = owners[chosen, 1]
        force, about_centre = (
            jnp.zeros((joint.count, 3), state.dtype).at[own].add(size[chosen, None] * part[chosen, 0])
            for part in (rows.linear, rows.angular)
        )
        a, _ = places(state, joint.pairs(system.count))
        arm = joint.spread(joint.anchor_a)  # type: ignore[attr-defined]
        found.append(Wrench(force, about_centre - cross(arm, a.orientation.unrotate(force))))
    return tuple(found)


def check_closed(error: JointError, effects: tuple[Any, ...], state: State) -> None:
    """Refuse a state that opens a joint. Traced numbers are not looked at.

    Raises:
        InvalidInput: naming the joint, by how much it is open, and the mend.
    """
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((error, state))):
        return
    rounding = 1e-9 if state.dtype == jnp.float64 else 2e-5
    reach = 1.0 + float(jnp.max(jnp.abs(state.position), initial=0.0))
    speed = 1.0 + sum(
        float(jnp.max(jnp.abs(part), initial=0.0)) for part in (state.velocity, state.angular_velocity)
    )
    named = [(type(joint).__name__, joint, k) for joint in joints_in(effects) for k in range(joint.count)]
    for what, unit, values, most in (
        ("is open by", "m", error.gap, rounding * reach),
        ("is turned out of place by", "rad", error.angle, rounding),
        ("opens with", "m/s or rad/s", error.rate, rounding * reach * speed),
    ):
        values = np.asarray(values, float)
        if not (values > most).any():
            continue
        worst = int(values.argmax())
        name, joint, k = named[worst]
        pair = joint.pairs(state.position.shape[0])[k].tolist()
        ends = (
            f"bodies {pair[0]} and {pair[1]}"
            if joint.bodies[1] is not None
            else f"body {pair[0]} and the world"
        )
        raise InvalidInput(
            f"state: the {name} between {ends} {what} {values[worst]:.3g} {unit}; give positions and velocities that "
            "fit, or ask for scene.state(…, assemble=True), which moves the bodies"
        )
