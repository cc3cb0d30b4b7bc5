"""Euler and Cardan angles in any of the twelve sequences: three numbers, and a singularity for the price."""

import itertools
from typing import ClassVar, Self

import equinox as eqx
import jax.numpy as jnp

from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Array, Matrix, Scalar, Vector, components, stack
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Drift, Rotation
from jaxrb.math.safe import arctan2, safe_sqrt
from jaxrb.math.vector import cross, dot

SEQUENCES = tuple("".join(s) for s in itertools.product("xyz", repeat=3) if s[0] != s[1] != s[2])


class EulerAngles(Rotation):
    """Rotation as three `angles` (..., 3) [rad] about moving axes, in the order of `sequence`.

    R = R_a(α) R_b(β) R_c(γ). The default "zyx" is yaw, pitch, roll. Where the first and the third axis align (pitch
    ±π/2 for "zyx", β = 0 or π for "zxz") the angles are not unique and their rates are not defined: gimbal lock. There
    the conversion sets the third angle to zero, and `derivative` drops the component that no rate can produce.
    """

    name: ClassVar[str] = "Euler angles"
    angles: Array = eqx.field(converter=jnp.asarray)
    sequence: str = eqx.field(static=True, default="zyx")

    def __check_init__(self):
        if self.sequence not in SEQUENCES:
            raise WrongStructure(
                f"EulerAngles: sequence {self.sequence!r} is none of the twelve: {', '.join(SEQUENCES)}"
            )

    @classmethod
    def identity(cls, dtype=None) -> Self:
        return cls(jnp.zeros(3, dtype=dtype))

    @classmethod
    def exp(cls, rotation_vector: Vector) -> Self:
        return cls.from_rotation(Quaternion.exp(rotation_vector))

    @classmethod
    def from_rotation(cls, other: Rotation, sequence: str = "zyx") -> Self:
        return cls(angles_of(other.as_quaternion_array(), sequence), sequence)

    def __matmul__(self, other: "EulerAngles") -> "EulerAngles":
        return EulerAngles.from_rotation(self._quaternion() @ other._quaternion(), self.sequence)

    def inverse(self) -> "EulerAngles":
        return EulerAngles.from_rotation(self._quaternion().inverse(), self.sequence)

    def log(self) -> Vector:
        return self._quaternion().log()

    def rotate(self, v: Vector) -> Vector:
        return self._quaternion().rotate(v)

    def derivative(self, angular_velocity: Vector) -> "EulerAngles":
        # ω_B = a α̇ + b β̇ + c γ̇ with the three axes seen from the body; Cramer's rule, det = ±cos β or ±sin β.
        a, b, c = self.axes()
        bc = cross(b, c)
        det = dot(a, bc)
        w = angular_velocity
        # Locked to round-off: cos(π/2) is no exact zero. What turns about the common axis goes to the first angle.
        locked = jnp.abs(det) <= 4.0 * jnp.finfo(det.dtype).eps
        inverse = 1.0 / jnp.where(locked, 1.0, det)
        first = jnp.where(locked, dot(w, a), dot(w, bc) * inverse)
        third = jnp.where(locked, 0.0, dot(a, cross(b, w)) * inverse)
        return EulerAngles(stack(first, dot(w, b), third), self.sequence)

    def derivative_world(self, angular_velocity: Vector) -> "EulerAngles":
        return self.derivative(self.unrotate(angular_velocity))

    def axes(self) -> tuple[Vector, Vector, Vector]:
        """The three axes of rotation in the body frame, (..., 3) each: the columns of the map from rates to ω_B."""
        first, second, third = (_unit(letter, self.angles) for letter in self.sequence)
        _, beta, gamma = components(self.angles)
        last = _about(self.sequence[2], gamma)
        b = last.unrotate(second)
        a = last.unrotate(_about(self.sequence[1], beta).unrotate(first))
        return a, b, third

    def normalise(self) -> "EulerAngles":
        """The same angles: any three numbers are a rotation."""
        return self

    def drift(self) -> Drift:
        zero = jnp.zeros_like(self.angles[..., 0])
        return Drift(scale=zero, skew=zero)

    def as_matrix(self) -> Matrix:
        return self._quaternion().as_matrix()

    def as_quaternion_array(self) -> Array:
        return self._quaternion().wxyz

    def _quaternion(self) -> Quaternion:
        alpha, beta, gamma = components(self.angles)
        return (
            _about(self.sequence[0], alpha) @ _about(self.sequence[1], beta) @ _about(self.sequence[2], gamma)
        )


def _about(letter: str, angle: Scalar) -> Quaternion:
    parts = [jnp.cos(0.5 * angle)] + [jnp.zeros_like(angle)] * 3
    parts["xyz".index(letter) + 1] = jnp.sin(0.5 * angle)
    return Quaternion(stack(*parts))


def _unit(letter: str, like: Vector) -> Vector:
    return jnp.zeros_like(like).at[..., "xyz".index(letter)].set(1.0)


def angles_of(wxyz: Array, sequence: str) -> Array:
    """Angles (..., 3) of a quaternion (..., 4) (Bernardes and Viollet 2022, PLoS ONE 17, e0276302).

    The middle angle lies in [0, π] where the first and third axes are the same, else in [−π/2, π/2].
    """
    # The paper's formula is for fixed axes; moving axes are the same turned round.
    i, j, k = ("xyz".index(letter) for letter in reversed(sequence))
    proper = i == k
    if proper:
        k = 3 - i - j
    sign = (i - j) * (j - k) * (k - i) // 2
    w, *v = components(wxyz)
    if proper:
        a, b, c, d = w, v[i], v[j], sign * v[k]
    else:
        a, b, c, d = w - v[j], v[i] + sign * v[k], v[j] + w, sign * v[k] - v[i]
    ab, cd = a * a + b * b, c * c + d * d
    middle = 2.0 * arctan2(safe_sqrt(cd), safe_sqrt(ab))
    half_sum, half_difference = arctan2(b, a), arctan2(d, c)
    # Locked to round-off: only the sum or only the difference of the outer angles is determined.
    tiny = (4.0 * jnp.finfo(wxyz.dtype).eps) ** 2 * (ab + cd)
    last = jnp.where(ab <= tiny, 2.0 * half_difference, 2.0 * half_sum)
    locked = (ab <= tiny) | (cd <= tiny)
    inner = jnp.where(locked, 0.0, half_sum - half_difference)
    outer = jnp.where(locked, last, half_sum + half_difference)
    if not proper:
        outer = sign * outer
        middle = middle - 0.5 * jnp.pi
    return stack(_wrapped(outer), middle, _wrapped(inner))


def _wrapped(angle: Scalar) -> Scalar:
    """The angle moved by a whole turn into [−π, π]."""
    return angle - 2.0 * jnp.pi * jnp.round(angle / (2.0 * jnp.pi))
