"""Products of 3-vectors and 3×3 matrices by components, and the star operator."""

from typing import Any

import jax.numpy as jnp

from jaxrb.math.arrays import Matrix, Scalar, Vector, components, entries, from_entries, stack


def dot_of(a: Any, b: Any) -> Any:
    """a · b of three components each, of any shape."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross_of(a: Any, b: Any) -> tuple[Any, Any, Any]:
    """The components of a × b, of three components each."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Vector, b: Vector) -> Scalar:
    """a · b, shapes (..., 3)."""
    return dot_of(components(a), components(b))


def cross(a: Vector, b: Vector) -> Vector:
    """a × b, shapes (..., 3)."""
    return stack(*cross_of(components(a), components(b)))


def rate_in_world(rate_in_body: Vector, angular_velocity: Vector, vector: Vector) -> Vector:
    """Rate of change of a vector seen from the world, (ḃ)_O = (ḃ)_O' + ω × b', all three in body components (..., 3).

    `rate_in_body` is the rate of its components in the rotating frame.
    """
    return rate_in_body + cross(angular_velocity, vector)


def hat(v: Vector) -> Matrix:
    """The star operator: the skew matrix v* with v* b = v × b (also called hat)."""
    v1, v2, v3 = components(v)
    zero = jnp.zeros_like(v1)
    return from_entries([[zero, -v3, v2], [v3, zero, -v1], [-v2, v1, zero]])


def vee(m: Matrix) -> Vector:
    """The inverse of `hat`; of a matrix that is not skew, the vector of its skew part."""
    e = entries(m)
    return stack(e[2][1] - e[1][2], e[0][2] - e[2][0], e[1][0] - e[0][1]) * 0.5


def matvec(m: Matrix, v: Vector) -> Vector:
    """m v by components, shapes (..., 3, 3) and (..., 3)."""
    v1, v2, v3 = components(v)
    return stack(*(r[0] * v1 + r[1] * v2 + r[2] * v3 for r in entries(m)))


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """a b by components, shapes (..., 3, 3)."""
    left, right = entries(a), entries(b)
    return from_entries(
        [[r[0] * right[0][j] + r[1] * right[1][j] + r[2] * right[2][j] for j in range(3)] for r in left]
    )


def cofactors(m: Matrix) -> Matrix:
    """The matrix of cofactors, det(m) m⁻ᵀ; its columns are cross products of the columns of m."""
    e = entries(m)
    minor = [
        [
            e[(i + 1) % 3][(j + 1) % 3] * e[(i + 2) % 3][(j + 2) % 3]
            - e[(i + 1) % 3][(j + 2) % 3] * e[(i + 2) % 3][(j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    return from_entries(minor)


def determinant(m: Matrix) -> Scalar:
    """det m by the first row, shape (..., 3, 3)."""
    a, b, c = (_column(m, j) for j in range(3))
    return dot(a, cross(b, c))


def solve(columns: tuple[Vector, Vector, Vector], v: Vector) -> Vector:
    """m⁻¹ v by Cramer's rule for the matrix with these columns. A singular m gives infinities."""
    a, b, c = columns
    bc = cross(b, c)
    inverse_determinant = 1.0 / dot(a, bc)
    return stack(*(inverse_determinant * x for x in (dot(v, bc), dot(a, cross(v, c)), dot(a, cross(b, v)))))


def inverse_rows(columns: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
    """The rows of m⁻¹ for the matrix with these columns. A singular m gives infinities."""
    a, b, c = columns
    bc = cross(b, c)
    inverse_determinant = 1.0 / dot(a, bc)
    p, q, r = (
        stack(*(inverse_determinant * x for x in components(row))) for row in (bc, cross(c, a), cross(a, b))
    )
    return p, q, r


def _column(m: Matrix, j: int) -> Vector:
    return m[..., :, j]
