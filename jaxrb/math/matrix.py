"""Rotation matrices: columns are the body axes in the world frame, Ṙ = R ω*."""

import operator
from typing import ClassVar, Self

import equinox as eqx
import jax.numpy as jnp

from jaxrb.math.arrays import Array, Matrix, Vector, by_components, components, entries, from_entries, stack
from jaxrb.math.quaternion import Quaternion, less_identity
from jaxrb.math.rotation import Drift, Rotation
from jaxrb.math.safe import cosc, sinc
from jaxrb.math.vector import cofactors, cross, determinant, dot, hat, matmul, matvec


class RotationMatrix(Rotation):
    """Rotation as `matrix` (..., 3, 3)."""

    name: ClassVar[str] = "rotation matrix"
    matrix: Array = eqx.field(converter=jnp.asarray)

    @classmethod
    def identity(cls, dtype=None) -> Self:
        return cls(jnp.eye(3, dtype=dtype))

    @classmethod
    def exp(cls, rotation_vector: Vector) -> Self:
        # Rodrigues: cos θ 1 + sinc θ v* + cosc θ v vᵀ, all smooth at zero.
        return cls(_rodrigues(rotation_vector, *_rodrigues_factors(rotation_vector)))

    @classmethod
    def cayley(cls, rotation_vector: Vector) -> Self:
        # (1 − v*/2)⁻¹ (1 + v*/2), the midpoint rule for Ṙ = R ω*; its angle is 2 atan(|v|/2).
        v = rotation_vector
        inverse = 1.0 / (1.0 + 0.25 * dot(v, v))
        return cls(_rodrigues(v, inverse, 0.5 * inverse))

    @classmethod
    def from_rotation(cls, other: Rotation) -> Self:
        return cls(other.as_matrix())

    def __matmul__(self, other: "RotationMatrix") -> "RotationMatrix":
        return RotationMatrix(matmul(self.matrix, other.matrix))

    def inverse(self) -> "RotationMatrix":
        return RotationMatrix(jnp.swapaxes(self.matrix, -1, -2))

    def log(self) -> Vector:
        # arccos((tr R − 1)/2) loses half the digits at 0 and π and its derivative; the quaternion loses none.
        return Quaternion(self.as_quaternion_array()).log()

    def rotate(self, v: Vector) -> Vector:
        return matvec(self.matrix, v)

    def derivative(self, angular_velocity: Vector) -> "RotationMatrix":
        # Ṙ = R ω*, row by row: r' = r × ω.
        a, b, c = components(angular_velocity)
        rows = [[y * c - z * b, z * a - x * c, x * b - y * a] for x, y, z in entries(self.matrix)]
        return RotationMatrix(from_entries(rows))

    def derivative_world(self, angular_velocity: Vector) -> "RotationMatrix":
        # Ṙ = ω* R, the lecture's form: each column obeys x' = ω × x.
        return RotationMatrix(matmul(hat(angular_velocity), self.matrix))

    def normalise(self) -> "RotationMatrix":
        return self.polar()

    def renormalise(self) -> "RotationMatrix":
        # One step of Newton and Schulz towards the polar factor, X (3 − XᵀX)/2: 54 products, no root, no division.
        x = self.matrix
        gram = entries(matmul(jnp.swapaxes(x, -1, -2), x))
        factor = [[0.5 * ((3.0 if i == j else 0.0) - gram[i][j]) for j in range(3)] for i in range(3)]
        return RotationMatrix(matmul(x, from_entries(factor)))

    def projecting_change(self) -> "RotationMatrix":
        return RotationMatrix(matmul(self.matrix, from_entries(_missing_stretch(self.matrix))))

    def turned(self, wxyz: Array, *, renormalise: bool) -> "RotationMatrix":
        # R P = R + R (P − 1), and the Newton–Schulz step is another small change, R (1 − RᵀR)/2.
        x = self.matrix
        small = less_identity(wxyz)
        if renormalise:
            # (1 + M) P − 1 = (P − 1) + M + M (P − 1). The last is small where P is, but without it the projection
            # would be that of R and not of R P, and at large steps drift would grow.
            missing = _missing_stretch(x)
            turned = entries(matmul(from_entries(missing), from_entries(small)))
            small = [[small[i][j] + (missing[i][j] + turned[i][j]) for j in range(3)] for i in range(3)]
        change = matmul(x, from_entries(small))
        return RotationMatrix(by_components(operator.add, x, change) if x.ndim == 3 else x + change)

    def polar(self, iterations: int = 6) -> "RotationMatrix":
        """The nearest rotation matrix, by Higham's scaled Newton iteration X ← (gX + X⁻ᵀ/g)/2.

        Treats the three axes alike. About 50 products and a division an iteration; two iterations suffice after a
        step, six from anywhere with positive determinant. (Higham 1986, SIAM J. Sci. Stat. Comput. 7, 1160.)
        """
        x = self.matrix
        for _ in range(iterations):
            inverse_transposed = cofactors(x) / determinant(x)[..., None, None]
            size = jnp.sum(inverse_transposed**2, axis=(-1, -2)) / jnp.sum(x**2, axis=(-1, -2))
            scale = size[..., None, None] ** 0.25
            x = 0.5 * (scale * x + inverse_transposed / scale)
        return RotationMatrix(x)

    def gram_schmidt(self) -> "RotationMatrix":
        """Orthogonalise column after column: cheaper than `polar`, and the first axis keeps all of its error.

        24 products, 2 roots, 2 divisions.
        """
        x, y = self.matrix[..., :, 0], self.matrix[..., :, 1]
        x = x / jnp.sqrt(dot(x, x))[..., None]
        y = y - dot(x, y)[..., None] * x
        y = y / jnp.sqrt(dot(y, y))[..., None]
        return RotationMatrix(jnp.stack([x, y, cross(x, y)], axis=-1))

    def drift(self) -> Drift:
        columns = [self.matrix[..., :, j] for j in range(3)]
        lengths = [dot(c, c) for c in columns]
        cosines = [
            jnp.abs(dot(columns[i], columns[j])) / jnp.sqrt(lengths[i] * lengths[j])
            for i, j in ((0, 1), (0, 2), (1, 2))
        ]
        scale = jnp.sqrt(sum(lengths) / 3.0) - 1.0
        return Drift(scale=scale, skew=jnp.maximum(jnp.maximum(cosines[0], cosines[1]), cosines[2]))

    def as_matrix(self) -> Matrix:
        return self.matrix

    def as_quaternion_array(self) -> Array:
        return Quaternion.from_matrix(self.matrix).wxyz


def _missing_stretch(x: Matrix) -> list[list[Array]]:
    """(1 − RᵀR)/2: the stretch that makes a matrix that is nearly a rotation one."""
    gram = entries(matmul(jnp.swapaxes(x, -1, -2), x))
    return [[0.5 * ((1.0 if i == j else 0.0) - gram[i][j]) for j in range(3)] for i in range(3)]


def _rodrigues_factors(v: Vector) -> tuple[Array, Array]:
    squared = dot(v, v)
    return sinc(squared), cosc(squared)


def _rodrigues(v: Vector, sine: Array, versine: Array) -> Matrix:
    """1 + sine·v* + versine·(v*)²."""
    v1, v2, v3 = components(v)
    s1, s2, s3 = sine * v1, sine * v2, sine * v3
    c12, c13, c23 = versine * v1 * v2, versine * v1 * v3, versine * v2 * v3
    c11, c22, c33 = versine * v1 * v1, versine * v2 * v2, versine * v3 * v3
    return jnp.stack(
        [
            stack(1.0 - c22 - c33, c12 - s3, c13 + s2),
            stack(c12 + s3, 1.0 - c11 - c33, c23 - s1),
            stack(c13 - s2, c23 + s1, 1.0 - c11 - c22),
        ],
        axis=-2,
    )
