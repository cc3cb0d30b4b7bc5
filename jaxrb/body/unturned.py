"""Orientations that never change, or by one angle alone: what methods see where the bodies of a scene can do no more.

They stand in a method's states during a step; effects and users see the rotation in its own representation.
"""

from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body.state import State
from jaxrb.math.arrays import Array, Matrix, Scalar, Vector
from jaxrb.math.rational import half_turn, less_turns
from jaxrb.math.rotation import Drift, Rotation
from jaxrb.math.stacking import stack


class Unturned(Rotation):
    """A rotation whose time derivative is zero by type, so that no method compiles an update of it.

    Turning it by anything gives itself.
    """

    name: ClassVar[str] = "unturned"
    rotation: Any  # a Rotation; in a derivative its numbers are None, which is zero by type

    def whole(self, renormalise: bool) -> Any:
        """The rotation in its own representation, projected if it changed and if so asked."""
        return self.rotation

    def carried(self) -> Self:
        """As it goes into the next step of a run that carries it."""
        return self

    @classmethod
    def identity(cls, dtype: Any = None) -> Self:
        return cls(None)

    @classmethod
    def exp(cls, rotation_vector: Vector) -> Self:
        return cls(None)

    @classmethod
    def cayley(cls, rotation_vector: Vector) -> Self:
        return cls(None)

    @classmethod
    def from_rotation(cls, other: Rotation) -> Self:
        return cls(plain(other))

    def __matmul__(self, other: Any) -> Self:
        return self

    def inverse(self) -> Self:
        return type(self)(self.whole(False).inverse())

    def log(self) -> Vector:
        return self.whole(False).log()

    def rotate(self, v: Vector) -> Vector:
        return self.whole(False).rotate(v)

    def unrotate(self, v: Vector) -> Vector:
        return self.whole(False).unrotate(v)

    def derivative(self, angular_velocity: Vector) -> Self:
        return jax.tree.map(lambda _: None, self)

    def derivative_world(self, angular_velocity: Vector) -> Self:
        return jax.tree.map(lambda _: None, self)

    def normalise(self) -> Self:
        return self

    def projecting_change(self) -> Self:
        return jax.tree.map(lambda _: None, self)

    def turned(self, wxyz: Array, *, renormalise: bool) -> Self:
        return self

    def drift(self) -> Drift:
        return self.rotation.drift()

    def as_matrix(self) -> Matrix:
        return self.whole(False).as_matrix()

    def as_quaternion_array(self) -> Array:
        return self.whole(False).as_quaternion_array()

    def angle_to(self, other: Rotation) -> Scalar:
        return self.whole(False).angle_to(plain(other))


class OneAxis(Unturned):
    """A `rotation`, turned further by `angle` (n, 1) [rad] about the body axis `axis`, which stays where it is.

    Its only number that changes is the angle, and the rate of that is a component of the angular velocity: exact for a
    constant rate, whatever the method. In a derivative the rotation's numbers are None; in a further rotation `angle`
    is the whole rotation vector (n, 3). A run carries it so from step to step: a quaternion formed in each step would
    take four fifths of the time of bodies in a plane.
    """

    name: ClassVar[str] = "one axis"
    angle: Any = None
    axis: int = eqx.field(static=True, default=0)

    @classmethod
    def exp(cls, rotation_vector: Vector) -> Self:
        return cls(None, rotation_vector)

    @classmethod
    def cayley(cls, rotation_vector: Vector) -> Self:
        return cls(None, rotation_vector)  # y₁ = y₀ + dt ω, for an angle

    def __matmul__(self, other: Any) -> Self:
        return type(self)(self.rotation, self.angle + self._about(other.angle), self.axis)

    def derivative(self, angular_velocity: Vector) -> Self:
        nothing = jax.tree.map(lambda _: None, self.rotation)
        return type(self)(nothing, self._about(angular_velocity), self.axis)

    def whole(self, renormalise: bool) -> Any:
        """The rotation and the angle in one, in the rotation's representation, projected if so asked."""
        cosine, sine = half_turn(self.angle[..., 0])
        parts = [cosine, *3 * [jnp.zeros_like(cosine)]]
        parts[1 + self.axis] = sine
        return self.rotation.turned(stack(*parts), renormalise=renormalise)

    def derivative_world(self, angular_velocity: Vector) -> Self:
        return self.derivative(self.unrotate(angular_velocity))

    def carried(self) -> Self:
        # A growing angle would lose digits in each sum; after two whole turns a quaternion is what it was.
        return type(self)(self.rotation, less_turns(self.angle), self.axis)

    def _about(self, vector: Vector) -> Array:
        return vector[..., self.axis : self.axis + 1]


def eased(orientation: Any, axis: int | None) -> Any:
    """The orientation of bodies that turn about this axis of theirs alone, or not at all (None), for a method."""
    if axis is None:
        return Unturned(orientation)
    return OneAxis(orientation, jnp.zeros_like(orientation.as_quaternion_array()[..., :1]), axis)


def plain(orientation: Any, *, renormalise: bool = False) -> Any:
    """The orientation as everything but a method knows it."""
    return orientation.whole(renormalise) if isinstance(orientation, Unturned) else orientation


def shown(state: State) -> State:
    """A state that a method `held`, as everything but a run knows it."""
    if not isinstance(state.orientation, Unturned):
        return state
    return eqx.tree_at(lambda s: s.orientation, state, plain(state.orientation))
