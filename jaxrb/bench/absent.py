"""Whether the program of a scene holds anything of effects that the scene has not."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxrb.accuracy.cost import without
from jaxrb.body.state import State
from jaxrb.effects import (
    AngularSpring,
    BodyThruster,
    Buoyancy,
    CentralGravity,
    CustomForce,
    GravityGradient,
    LinearDrag,
    MagneticTorque,
    MagnusForce,
    Motor,
    MutualGravity,
    PlateAerodynamics,
    PrescribedMotion,
    PrescribedTorque,
    QuadraticDrag,
    SpringDamper,
    UniformGravity,
    WindField,
    Wrench,
)
from jaxrb.geometry.primitives import Pose
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.contact_library import CONTACT_SCENES
from jaxrb.scene.library import SCENES
from jaxrb.scene.scene import Scene
from jaxrb.scene.step import step


def _still(time: Any, parameters: Any) -> Pose:
    return Pose(jnp.zeros(3), Quaternion(jnp.asarray([1.0, 0.0, 0.0, 0.0])))


# One of each. Constraints and contact decide how a step is made; scenes with and without them are compared elsewhere.
EFFECTS = (
    UniformGravity(),
    CentralGravity(1.0, (0.0, 0.0, 9.0)),
    GravityGradient(1.0, (0.0, 0.0, 9.0)),
    MutualGravity(),
    LinearDrag(0.1, angular_coefficient=0.1, wind=(1.0, 0.0, 0.0)),
    QuadraticDrag(0.1, 1.0),
    WindField(LinearDrag(0.1), lambda position, time, parameters: 0.1 * position),
    Buoyancy(1e-3),
    MagnusForce(0.1),
    PlateAerodynamics((0.0, 0.0, 1.0), 0.1),
    SpringDamper(1.0),
    AngularSpring(1.0),
    BodyThruster((0.0, 0.0, 1.0)),
    PrescribedTorque((0.0, 0.0, 1.0)),
    MagneticTorque((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    Motor((0.0, 0.0, 1.0), 1.0, 1.0, torque_limit=0.1),
    PrescribedMotion(_still),
    CustomForce(lambda body, state, parameters: Wrench(force=-state.position)),
)
# Bodies that are held or touch can be neither held again nor driven.
_NO_MOTION = ("heavy_top", "lagrange_top", *CONTACT_SCENES)


def lowered(scene: Scene, state: State, **options: Any) -> str:
    """What goes to the compiler of one step."""
    return jax.jit(lambda s, y: step(s, y)).lower(scene, state).as_text(**options)


def same_program(name: str, effects: Sequence[Any] = EFFECTS) -> bool:
    """Whether the built-in scene, given effects and rid of them again, is byte for byte the one that never had any."""
    example = (SCENES | CONTACT_SCENES)[name]()
    scene, state = example.scene, example.state()
    own = len(scene.effects)
    added = tuple(e for e in effects if not (isinstance(e, PrescribedMotion) and name in _NO_MOTION))
    crowded = Scene(scene.bodies, (*scene.effects, *added))
    again = without(crowded, range(own, own + len(added)))
    return lowered(again, state) == lowered((SCENES | CONTACT_SCENES)[name]().scene, state)
