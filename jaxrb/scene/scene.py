"""A scene: bodies, and the effects that act on them."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxrb.body import diagnostics
from jaxrb.body.body import Body, count_of, freedoms_of, stacked
from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.checks import Checked
from jaxrb.contact import contact_of
from jaxrb.effects.dynamics import Dynamics, prepare
from jaxrb.effects.effect import Effect
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.effects.prescribed_motion import PrescribedMotion
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.euler_angles import EulerAngles
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.freedoms import check_driven, check_joints, check_motion
from jaxrb.scene.initial import check_held, initial_state
from jaxrb.scene.start import check_start


class Scene(Checked):
    """Bodies and effects. A scene is a tree of numbers: differentiate with respect to any, `vmap` over any.

    `bodies`: one `Body`, or a tuple; each may carry a bodies axis (`replicate`). Effects name bodies by their number in
    this order, from 0.
    """

    bodies: Any  # a Body or several; afterwards a tuple[Body, ...]
    effects: Any = ()  # an Effect or several; afterwards a tuple[Effect, ...]

    def __post_init__(self):
        bodies, effects = self.bodies, self.effects
        self.bodies = bodies = tuple(bodies) if isinstance(bodies, (list, tuple)) else (bodies,)
        self.effects = effects = tuple(effects) if isinstance(effects, (list, tuple)) else (effects,)
        if not bodies or not all(isinstance(body, Body) for body in bodies):
            raise WrongStructure(f"Scene.bodies: {bodies!r}; give a Body, or a tuple of at least one Body")
        for effect in effects:
            if isinstance(effect, type):
                raise WrongStructure(
                    f"Scene.effects: {effect.__name__} is a class; write {effect.__name__}(…)"
                )
            if not isinstance(effect, Effect):
                raise WrongStructure(
                    f"Scene.effects: {effect!r} is no effect; wrap a function in CustomForce"
                )
            effect.check(self.count)
        check_joints(effects)

    @property
    def jointed(self) -> bool:
        """Whether there are joints among the effects."""
        return any(effect.joins for effect in self.effects)

    @property
    def count(self) -> int:
        """Number of bodies."""
        return sum(count_of(body) or 1 for body in self.bodies)

    def stacked(self) -> MassProperties:
        """Mass, centre of mass and inertia of all bodies with a leading bodies axis."""
        return stacked(self.bodies)

    def prepared(self, dtype: Any) -> Dynamics:
        """The equations of motion for states of this floating type."""
        effects = tuple(effect.with_shapes(self.bodies) for effect in self.effects)
        contact = contact_of(self.bodies, self.effects)
        bodies, freedoms = self.stacked(), freedoms_of(self.bodies)
        joints = None
        if self.jointed:
            from jaxrb.joints.system import joints_of  # only scenes with joints load them

            joints = joints_of(self.effects, freedoms, bodies)
        return prepare(bodies, effects, dtype, contact, freedoms, joints)

    def state(
        self,
        position: Any = None,
        orientation: Any = None,
        velocity: Any = None,
        angular_velocity: Any = None,
        *,
        time: Any = 0.0,
        rotation: type[Rotation] = Quaternion,
        dtype: Any = None,
        assemble: bool = False,
    ) -> State:
        """A checked state of this scene, at rest at the origin where nothing else is said.

        Args:
            position: centres of mass in the world frame [m], (n, 3), or (3,) for all bodies.
            orientation: R_WB as any `Rotation`, wxyz (n, 4) or (4,), or matrices (n, 3, 3) or (3, 3).
            velocity: in the world frame [m/s], (n, 3) or (3,).
            angular_velocity: in the body frame [rad/s], (n, 3) or (3,).
            time: [s].
            rotation: the representation to run in: Quaternion, RotationMatrix or EulerAngles.
            dtype: floating type; by default that of the arrays given, else JAX's default.
            assemble: move the bodies so that the scene's joints are closed (`rb.assembled`).

        Raises:
            InvalidInput: numbers that are not finite, orientations that are no rotations; with body and value. Joints
                that are open, and by how much.
            WrongStructure: shapes that do not fit.
        """
        state = initial_state(
            self.count, position, orientation, velocity, angular_velocity, time, rotation, dtype
        )
        check_motion(freedoms_of(self.bodies), state)
        check_start(self, state)
        given = {"velocity": velocity, "angular_velocity": angular_velocity}
        state = _placed(self, state, position, given)
        if not self.jointed:
            return state
        return _fitted(self, state, assemble)


def _placed(scene: Scene, state: State, position: Any, given: dict[str, Any]) -> State:
    """The state with held and driven bodies in their place; a position that contradicts the hold is refused."""
    if not any(isinstance(effect, (FixedPoint, PrescribedMotion)) for effect in scene.effects):
        return state
    placed = _completed(scene, state)
    if position is not None:
        check_held(state, placed)
    check_driven(scene.effects, given, state, placed)
    return placed


def _fitted(scene: Scene, state: State, assemble: bool) -> State:
    """The state if its joints are closed, or with its joints closed."""
    # Not at the top: what closes joints for users is told of scenes, and so imports this file.
    from jaxrb.joints.readings import check_closed
    from jaxrb.scene import joints

    if isinstance(state.orientation, EulerAngles):
        raise WrongStructure(
            "state: joints take quaternions and matrices, not Euler angles; choose rotation=Quaternion"
        )
    if assemble:
        return joints.assembled(scene, state)
    check_closed(joints.joint_error(scene, state), scene.effects, state)
    return state


@jax.jit
def _completed(scene: Scene, state: State) -> State:
    return scene.prepared(state.dtype).complete(state)


def check_fit(scene: Scene, state: State) -> None:
    """Refuse a state that belongs to a scene with another number of bodies."""
    if not isinstance(scene, Scene):
        raise WrongStructure(f"scene: {type(scene).__name__} is no Scene; write rb.Scene(bodies, effects)")
    if not isinstance(state, State):
        raise WrongStructure(f"state: {type(state).__name__} is no State; make one with scene.state(...)")
    shape = jnp.shape(state.position)
    if shape != (scene.count, 3):
        mend = "make it with scene.state(...) of this scene"
        if len(shape) == 3:
            mend = "this looks like a batch of worlds: use jax.vmap over them"
        raise WrongStructure(f"state: positions {shape} do not fit a scene of {scene.count} bodies; {mend}")


def refuse_contact(scene: Scene, where: str, mend: str) -> None:
    """Refuse a scene with rigid contact: where only forces act, its bodies would fall through the floor."""
    if any(isinstance(effect, RigidContact) for effect in scene.effects):
        raise WrongStructure(
            f"{where}: RigidContact acts by impulses between steps, which {where} does not take; {mend}"
        )


@jax.jit
def energy(scene: Scene, state: State) -> Scalar:
    """Total energy [J]: kinetic, and the potential of every effect that has one."""
    check_fit(scene, state)
    dynamics = scene.prepared(state.dtype)
    total = jnp.sum(diagnostics.kinetic_energy(dynamics.bodies, state))
    for effect in dynamics.effects:
        potential = effect.potential_energy_of(dynamics.bodies, state)
        total = total if potential is None else total + potential
    return total


@jax.jit
def momentum(scene: Scene, state: State) -> Vector:
    """Total momentum (3,) [kg m/s] in the world frame."""
    check_fit(scene, state)
    return jnp.sum(diagnostics.momentum(scene.prepared(state.dtype).bodies, state), axis=0)


@jax.jit
def angular_momentum(scene: Scene, state: State) -> Vector:
    """Total angular momentum (3,) [kg m²/s] about the origin of the world, in the world frame."""
    check_fit(scene, state)
    return jnp.sum(diagnostics.angular_momentum(scene.prepared(state.dtype).bodies, state), axis=0)
