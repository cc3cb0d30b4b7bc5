"""Unit quaternions: Hamilton product, scalar first, q and −q are the same rotation."""

from typing import ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.math.arrays import Array, Matrix, Scalar, Vector, components, entries, from_entries, stack
from jaxrb.math.rotation import Drift, Rotation
from jaxrb.math.safe import arctan_ratio, cosine, norm, normalise, sinc
from jaxrb.math.vector import dot


class Quaternion(Rotation):
    """Rotation as `wxyz` (..., 4): [cos θ/2, u sin θ/2]."""

    name: ClassVar[str] = "quaternion"
    wxyz: Array = eqx.field(converter=jnp.asarray)

    @classmethod
    def identity(cls, dtype=None) -> Self:
        return cls(jnp.asarray([1.0, 0.0, 0.0, 0.0], dtype=dtype))

    @classmethod
    def random(cls, key: Array, shape: tuple[int, ...] = (), dtype=None) -> Self:
        """Uniformly distributed rotations of the given batch shape: normalised Gaussian 4-vectors."""
        return cls(normalise(jax.random.normal(key, (*shape, 4), dtype or float)))

    @classmethod
    def exp(cls, rotation_vector: Vector) -> Self:
        half_squared = 0.25 * dot(rotation_vector, rotation_vector)
        factor = 0.5 * sinc(half_squared)
        return cls(stack(cosine(half_squared), *(factor * c for c in components(rotation_vector))))

    @classmethod
    def cayley(cls, rotation_vector: Vector) -> Self:
        # (1 + u)/(1 − u) with u = [0, v/4], the midpoint rule for q̇ = ½ q [0, ω]; its angle is 4 atan(|v|/4).
        u1, u2, u3 = (0.25 * c for c in components(rotation_vector))
        squared = u1 * u1 + u2 * u2 + u3 * u3
        inverse = 1.0 / (1.0 + squared)
        twice = 2.0 * inverse
        return cls(stack((1.0 - squared) * inverse, u1 * twice, u2 * twice, u3 * twice))

    @classmethod
    def of_tangent(cls, vector: Vector) -> Self:
        """Rotation about `vector` (..., 3) by 2 atan of its length (Gibbs, Rodrigues): [1, g]/√(1 + |g|²)."""
        x, y, z = components(vector)
        cosine = 1.0 / jnp.sqrt(1.0 + (x * x + y * y + z * z))
        return cls(stack(cosine, cosine * x, cosine * y, cosine * z))

    @classmethod
    def from_rotation(cls, other: Rotation) -> Self:
        return cls(other.as_quaternion_array())

    @classmethod
    def from_matrix(cls, matrix: Matrix) -> Self:
        """Of a rotation matrix (..., 3, 3), by the largest of the four squared components (Shepperd 1978)."""
        m = entries(matrix)
        t = (m[0][0], m[1][1], m[2][2])
        squares = [1.0 + t[0] + t[1] + t[2]] + [1.0 + 2.0 * t[i] - (t[0] + t[1] + t[2]) for i in range(3)]
        sums = {(i, j): m[i][j] + m[j][i] for i, j in ((0, 1), (0, 2), (1, 2))}
        skew = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1])
        candidates = [
            [squares[0], skew[0], skew[1], skew[2]],
            [skew[0], squares[1], sums[0, 1], sums[0, 2]],
            [skew[1], sums[0, 1], squares[2], sums[1, 2]],
            [skew[2], sums[0, 2], sums[1, 2], squares[3]],
        ]
        best, chosen = squares[0], candidates[0]
        for square, candidate in zip(squares[1:], candidates[1:], strict=True):
            better = square > best
            best = jnp.where(better, square, best)
            chosen = [jnp.where(better, new, old) for new, old in zip(candidate, chosen, strict=True)]
        # Each candidate is 4 qᵢ q with qᵢ ≥ ½, so this normalisation is safe and also repairs small drift.
        return cls(normalise(stack(*chosen)))

    def __matmul__(self, other: "Quaternion") -> "Quaternion":
        return Quaternion(product(self.wxyz, other.wxyz))

    def conjugate(self) -> "Quaternion":
        """[w, −x, −y, −z]: the inverse of a unit quaternion."""
        w, x, y, z = components(self.wxyz)
        return Quaternion(stack(w, -x, -y, -z))

    def inverse(self) -> "Quaternion":
        return Quaternion(self.conjugate().wxyz / jnp.sum(self.wxyz**2, axis=-1, keepdims=True))

    def log(self) -> Vector:
        w, x, y, z = components(self.wxyz)
        # −q is the same rotation; the half turn with w = 0 keeps the sign it has.
        sign = jnp.where(w < 0, -1.0, 1.0).astype(w.dtype)
        factor = 2.0 * sign * arctan_ratio(x * x + y * y + z * z, sign * w)
        return stack(factor * x, factor * y, factor * z)

    def rotate(self, v: Vector) -> Vector:
        # v + 2w (u × v) + 2u × (u × v): 18 products against 28 for q v q*.
        return _rotate(components(self.wxyz), v)

    def unrotate(self, v: Vector) -> Vector:
        w, x, y, z = components(self.wxyz)
        return _rotate([-w, x, y, z], v)

    def unrotation_change(self, v: Vector) -> Vector:
        """Rᵀ v − v without cancellation: for small rotations of full relative precision."""
        w, x, y, z = components(self.wxyz)
        return stack(*_rotation_change([-w, x, y, z], v))

    def derivative(self, angular_velocity: Vector) -> "Quaternion":
        # q̇ = ½ q [0, ω_B]; the half goes on ω, three products instead of four.
        w, x, y, z = components(self.wxyz)
        a, b, c = (0.5 * component for component in components(angular_velocity))
        return Quaternion(
            stack(-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a)
        )

    def derivative_world(self, angular_velocity: Vector) -> "Quaternion":
        # q̇ = ½ [0, ω_W] q: the lecture's form.
        zero = jnp.zeros_like(angular_velocity[..., :1])
        return Quaternion(product(jnp.concatenate([zero, 0.5 * angular_velocity], axis=-1), self.wxyz))

    def normalise(self) -> "Quaternion":
        return Quaternion(normalise(self.wxyz))

    def renormalise(self) -> "Quaternion":
        # No guard for zero here: a quaternion that shrank to nothing during a run must show as not finite.
        parts = components(self.wxyz)
        w, x, y, z = parts
        inverse = 1.0 / jnp.sqrt(w * w + x * x + y * y + z * z)
        return Quaternion(stack(*(part * inverse for part in parts)))

    def projecting_change(self) -> "Quaternion":
        parts = components(self.wxyz)
        scale = _missing_scale(parts)
        return Quaternion(stack(*(scale * part for part in parts)))

    def turned(self, wxyz: Array, *, renormalise: bool) -> "Quaternion":
        # q p = q + q (p − 1); the rounding of p₀ − 1 lies along q itself and is projected away.
        parts = components(self.wxyz)
        p0, p1, p2, p3 = components(wxyz)
        scale = p0 - 1.0
        if renormalise:
            # Along q p, not along q: at half a turn a step the two are perpendicular, and beyond the error would grow.
            missing = _missing_scale(parts)
            scale = scale + missing * p0
            p1, p2, p3 = (p + missing * p for p in (p1, p2, p3))
        change = components(product(self.wxyz, stack(scale, p1, p2, p3)))
        return Quaternion(stack(*(part + c for part, c in zip(parts, change, strict=True))))

    def drift(self) -> Drift:
        scale = norm(self.wxyz) - 1.0
        return Drift(scale=scale, skew=jnp.zeros_like(scale))

    def as_matrix(self) -> Matrix:
        small = less_identity(self.wxyz)
        return from_entries(
            [[1 + e if i == j else e for j, e in enumerate(row)] for i, row in enumerate(small)]
        )

    def as_quaternion_array(self) -> Array:
        return self.wxyz


def _missing_scale(parts: list[jax.Array]) -> jax.Array:
    """1/|q| − 1 of a quaternion that is nearly a unit one."""
    w, x, y, z = parts
    return 0.5 * (1.0 - (w * w + x * x + y * y + z * z))


def product(a: Array, b: Array) -> Array:
    """Hamilton product of two (..., 4) arrays: [s₁s₂ − v₁·v₂, s₁v₂ + s₂v₁ + v₁ × v₂]."""
    a0, a1, a2, a3 = components(a)
    b0, b1, b2, b3 = components(b)
    return stack(
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
        a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
    )


def less_identity(wxyz: Array) -> list[list[jax.Array]]:
    """The entries of R − 1 of a unit quaternion (..., 4), to full relative precision for small rotations."""
    w, x, y, z = components(wxyz)
    xx, yy, zz = 2 * x * x, 2 * y * y, 2 * z * z
    xy, xz, yz, wx, wy, wz = 2 * x * y, 2 * x * z, 2 * y * z, 2 * w * x, 2 * w * y, 2 * w * z
    return [[-yy - zz, xy - wz, xz + wy], [xy + wz, -xx - zz, yz - wx], [xz - wy, yz + wx, -xx - yy]]


def _rotate(q: list[jax.Array], v: Vector) -> Vector:
    return stack(*(part + c for part, c in zip(components(v), _rotation_change(q, v), strict=True)))


def _rotation_change(q: list[jax.Array], v: Vector) -> list[jax.Array]:
    w, x, y, z = q
    v1, v2, v3 = components(v)
    t1, t2, t3 = 2.0 * (y * v3 - z * v2), 2.0 * (z * v1 - x * v3), 2.0 * (x * v2 - y * v1)
    return [w * t1 + (y * t3 - z * t2), w * t2 + (z * t1 - x * t3), w * t3 + (x * t2 - y * t1)]


def attitude_error(a: Array, b: Array) -> Scalar:
    """2·min|a ∓ b| [rad] of two unit quaternions (..., 4): the measure of the reference answers.

    Unlike 2 arccos|a·b| it resolves angles far below √eps.
    """
    return 2.0 * jnp.minimum(norm(a - b), norm(a + b))
