"""The abstract rotation: what everything above this floor knows of an orientation.

An orientation R_WB maps body coordinates to world coordinates. Angular velocity is given in the body frame unless a
name says otherwise. All methods accept leading batch axes.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.math.arrays import Array, Matrix, Scalar, Vector
from jaxrb.math.safe import norm, unit_or


class Drift(NamedTuple):
    """How far the numbers have left the rotation group. Both are zero for an exact rotation.

    `scale` is the relative error of length that the rotation would give a vector (a quaternion "breathes", a matrix
    grows evenly); `skew` is the largest |cosine| between two axes that should be perpendicular.
    """

    scale: Scalar
    skew: Scalar


class Rotation(eqx.Module):
    """A rotation in three dimensions. `a @ b` first applies b, then a."""

    name: eqx.AbstractClassVar[str]

    @classmethod
    def identity(cls, dtype=None) -> Self:
        """The rotation by nothing."""
        raise NotImplementedError

    @classmethod
    def exp(cls, rotation_vector: Vector) -> Self:
        """Rotation about `rotation_vector` (..., 3) by its length [rad]."""
        raise NotImplementedError

    @classmethod
    def cayley(cls, rotation_vector: Vector) -> Self:
        """The rotation by which the implicit midpoint rule advances this representation over ω·dt.

        It solves y₁ = y₀ + f((y₀ + y₁)/2) for the representation's own kinematic equation, and agrees with `exp` to
        third order.
        """
        raise NotImplementedError

    @classmethod
    def from_rotation(cls, other: "Rotation") -> Self:
        """The same rotation in this representation."""
        raise NotImplementedError

    def __matmul__(self, other: Self) -> Self:
        raise NotImplementedError

    def inverse(self) -> Self:
        """The opposite rotation."""
        raise NotImplementedError

    def log(self) -> Vector:
        """The rotation vector (..., 3) of length at most π; at π either sign is right, and one is chosen."""
        raise NotImplementedError

    def rotate(self, v: Vector) -> Vector:
        """R v: body coordinates to world coordinates."""
        raise NotImplementedError

    def unrotate(self, v: Vector) -> Vector:
        """Rᵀ v: world coordinates to body coordinates."""
        return self.inverse().rotate(v)

    def derivative(self, angular_velocity: Vector) -> Self:
        """Time derivative of the numbers for an angular velocity in the body frame [rad/s]."""
        raise NotImplementedError

    def derivative_world(self, angular_velocity: Vector) -> Self:
        """Time derivative of the numbers for an angular velocity in the world frame [rad/s] (the lecture's form)."""
        raise NotImplementedError

    def normalise(self) -> Self:
        """The nearest exact rotation."""
        raise NotImplementedError

    def renormalise(self) -> Self:
        """The projection that the stepping methods use: cheap, and exact to the square of the drift."""
        return self.normalise()

    def projecting_change(self) -> Self:
        """What has to be added to the numbers to project them, to the square of the drift, in full relative precision.

        Nothing, for a representation whose numbers are always a rotation.
        """
        return jax.tree.map(jnp.zeros_like, self)

    def turned(self, wxyz: Array, *, renormalise: bool) -> Self:
        """The rotation after a further one in the body frame, a unit quaternion (..., 4), projected if so asked.

        Formed as self + small change, the projection in the same sum: a single rounding a step. After 1e6 steps the
        direction is off by 2e-13 where product and `renormalise` leave 3e-12.
        """
        raise NotImplementedError

    def drift(self) -> Drift:
        """How far the numbers are from an exact rotation."""
        raise NotImplementedError

    def as_matrix(self) -> Matrix:
        """The rotation matrix (..., 3, 3); its columns are the body axes in the world frame."""
        raise NotImplementedError

    def as_quaternion_array(self) -> Array:
        """wxyz (..., 4), scalar first."""
        raise NotImplementedError

    @classmethod
    def from_axis_angle(cls, axis: Vector | Sequence[float], angle: Scalar) -> Self:
        """Rotation by `angle` [rad] about `axis` (..., 3), which need not have length one."""
        axis = jnp.asarray(axis)
        return cls.exp(unit_or(axis, jnp.zeros_like(axis)) * jnp.asarray(angle)[..., None])

    def as_axis_angle(self) -> tuple[Vector, Scalar]:
        """Unit axis (..., 3) and angle in [0, π]; at the identity the axis is z and the angle 0."""
        vector = self.log()
        z = jnp.zeros_like(vector).at[..., 2].set(1.0)
        return unit_or(vector, z), norm(vector)

    def angle_to(self, other: "Rotation") -> Scalar:
        """Angle [rad] of the rotation that takes `self` to `other`, in [0, π]."""
        return norm((self.inverse() @ type(self).from_rotation(other)).log())


def coordinates(rotation: Rotation) -> list[jax.Array]:
    """The arrays of numbers that a rotation consists of."""
    return jax.tree.leaves(rotation)
