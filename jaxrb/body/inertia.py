"""The inertia tensor about the centre of mass, in the body frame.

Its kind is a type: a spherical inertia has no gyroscopic term because its class has none, so no program of a sphere
contains one. `Inertia.of` chooses the kind by the shape of the numbers, never by their values.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrb.checks import Checked, as_array, quantity
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Array, Matrix, Scalar, Vector, components, from_entries, stack
from jaxrb.math.rotation import Rotation
from jaxrb.math.safe import unit_or
from jaxrb.math.vector import cross, dot, matmul, solve


class Inertia(Checked):
    """Inertia tensor [kg m²] about the centre of mass, axes of the body frame."""

    rank: eqx.AbstractClassVar[int]  # spherical 0 < principal 1 < full 2: the order in which kinds generalise

    @staticmethod
    def of(value: Any) -> "Inertia":
        """A number: spherical. Three numbers: principal moments. A 3×3 matrix: full. Shapes (), (3,), (3, 3)."""
        if isinstance(value, Inertia):
            return value
        value = as_array("inertia", value)
        if value.ndim == 0:
            return SphericalInertia(value)
        if value.shape == (3,):
            return PrincipalInertia(value)
        if value.shape == (3, 3):
            return FullInertia.from_matrix(value)
        raise WrongStructure(
            f"inertia: shape {value.shape}; give a number (sphere), three principal moments or a 3×3 matrix, and "
            "`replicate` or `jax.vmap` for many bodies"
        )

    def apply(self, angular_velocity: Vector) -> Vector:
        """Angular momentum I ω [kg m²/s] in the body frame."""
        raise NotImplementedError

    def as_matrix(self) -> Matrix:
        """The symmetric 3×3 matrix."""
        raise NotImplementedError

    def moment_about(self, axis: Vector) -> Scalar:
        """Moment of inertia n · I n about the axis through the centre of mass along `axis` (any length)."""
        axis = jnp.asarray(axis)
        n = unit_or(axis, jnp.zeros_like(axis))
        return dot(n, self.apply(n))

    def trace(self) -> Scalar:
        """Sum of the three moments."""
        raise NotImplementedError

    def about(self, offset: Vector, mass: Scalar) -> "FullInertia":
        """Inertia about the point at `offset` (3,) [m] from the centre of mass (parallel axes, Steiner).

        I_O = I + m (d² 1 − d dᵀ).
        """
        return FullInertia.of_six(self.six() + jnp.asarray(mass)[..., None] * parallel_axis(offset))

    def rotated(self, rotation: Rotation) -> "FullInertia":
        """The same inertia in axes from which `rotation` leads to the body frame: R I Rᵀ."""
        r = rotation.as_matrix()
        return FullInertia.from_matrix(matmul(matmul(r, self.as_matrix()), jnp.swapaxes(r, -1, -2)))

    def six(self) -> Array:
        """xx, yy, zz, xy, xz, yz (..., 6)."""
        raise NotImplementedError

    def generalised(self, rank: int) -> "Inertia":
        """The same inertia as a kind of at least that generality."""
        if rank <= self.rank:
            return self
        if rank == 2:
            return FullInertia.of_six(self.six())
        return PrincipalInertia(self.six()[..., :3])


class SphericalInertia(Inertia):
    """The same moment about every axis: spheres, cubes and all regular bodies."""

    rank: ClassVar[int] = 0
    moment: Scalar = quantity((), unit="kg m²")

    def apply(self, angular_velocity: Vector) -> Vector:
        return stack(*(self.moment * w for w in components(angular_velocity)))

    def as_matrix(self) -> Matrix:
        return jnp.asarray(self.moment)[..., None, None] * jnp.eye(3, dtype=jnp.asarray(self.moment).dtype)

    def trace(self) -> Scalar:
        return 3.0 * self.moment

    def six(self) -> Array:
        moment = jnp.asarray(self.moment)
        zero = jnp.zeros_like(moment)
        return stack(moment, moment, moment, zero, zero, zero)


class PrincipalInertia(Inertia):
    """Three moments about the axes of the body frame, which are the principal axes."""

    rank: ClassVar[int] = 1
    moments: Vector = quantity((3,), unit="kg m²")

    def apply(self, angular_velocity: Vector) -> Vector:
        return stack(
            *(i * w for i, w in zip(components(self.moments), components(angular_velocity), strict=True))
        )

    def as_matrix(self) -> Matrix:
        moments = jnp.asarray(self.moments)
        return moments[..., None] * jnp.eye(3, dtype=moments.dtype)

    def trace(self) -> Scalar:
        return jnp.sum(self.moments, axis=-1)

    def six(self) -> Array:
        moments = jnp.asarray(self.moments)
        return jnp.concatenate([moments, jnp.zeros_like(moments)], axis=-1)


class FullInertia(Inertia):
    """A symmetric tensor, kept as its six numbers xx, yy, zz, xy, xz, yz so that it cannot lose its symmetry.

    The off-diagonal numbers are entries of the matrix: minus the products of inertia of some textbooks.
    """

    rank: ClassVar[int] = 2
    components: Array = quantity((6,), unit="kg m²")

    @staticmethod
    def of_six(six: Array) -> "FullInertia":
        """From xx, yy, zz, xy, xz, yz (..., 6)."""
        return FullInertia(six)

    @staticmethod
    def from_matrix(matrix: Matrix) -> "FullInertia":
        """From a symmetric matrix (..., 3, 3); of one that is not, the symmetric part."""
        xp = np if isinstance(matrix, np.ndarray) else jnp
        off = [0.5 * (matrix[..., i, j] + matrix[..., j, i]) for i, j in ((0, 1), (0, 2), (1, 2))]
        return FullInertia(xp.stack([matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 2, 2], *off], axis=-1))

    def apply(self, angular_velocity: Vector) -> Vector:
        return symmetric_apply(self.components, angular_velocity)

    def as_matrix(self) -> Matrix:
        xx, yy, zz, xy, xz, yz = components(self.components)
        return from_entries([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def trace(self) -> Scalar:
        return jnp.sum(jnp.asarray(self.components)[..., :3], axis=-1)

    def six(self) -> Array:
        return self.components


def symmetric_apply(six: Array, v: Vector) -> Vector:
    """Symmetric matrix, given by xx, yy, zz, xy, xz, yz, times a vector."""
    xx, yy, zz, xy, xz, yz = components(six)
    x, y, z = components(v)
    return stack(xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z)


def parallel_axis(offset: Vector) -> Array:
    """d² 1 − d dᵀ as six numbers (..., 6): what a unit mass at `offset` adds to the inertia."""
    x, y, z = components(jnp.asarray(offset))
    return stack(y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z)


def principal_axes(inertia: Inertia) -> tuple[Vector, Matrix]:
    """Principal moments (3,), ascending, and a proper rotation matrix whose columns are their axes in the body frame.

    For reading and drawing. The moments have derivatives where they differ; the axes have none where two moments are
    equal, which is why no dynamics here goes through them.
    """
    moments, axes = jnp.linalg.eigh(inertia.as_matrix())
    sign = jnp.sign(jnp.linalg.det(axes))
    return moments, axes.at[..., :, 2].multiply(sign[..., None])


def solver(inertia: Inertia) -> "InertiaSolver":
    """The inertia made ready for a run: what does not change from step to step is computed here, once."""
    if isinstance(inertia, SphericalInertia):
        return SphericalSolver(inertia, 1.0 / jnp.asarray(inertia.moment))
    if isinstance(inertia, PrincipalInertia):
        i1, i2, i3 = components(inertia.moments)
        inverse = stack(1.0 / i1, 1.0 / i2, 1.0 / i3)
        return PrincipalSolver(inertia, inverse, stack((i2 - i3) / i1, (i3 - i1) / i2, (i1 - i2) / i3))
    inertia = FullInertia(inertia.six())
    xx, yy, zz, xy, xz, yz = components(inertia.components)
    cofactor = [yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy]
    off = [xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz]
    reciprocal = 1.0 / (xx * cofactor[0] + xy * off[0] + xz * off[1])
    return FullSolver(inertia, stack(*(c * reciprocal for c in cofactor + off)))


class InertiaSolver(eqx.Module):
    """An inertia with its inverse. `acceleration(ω, τ)` is Euler's equation I ω̇ = τ − ω × Iω in the body frame."""

    inertia: eqx.AbstractVar[Inertia]

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector | None:
        """ω̇ [rad/s²]; None stands for a torque, or an acceleration, that is zero by type."""
        raise NotImplementedError

    def inverse_invariants(self) -> tuple[Scalar, Scalar, Scalar]:
        """Trace, sum of principal minors and determinant of I⁻¹."""
        raise NotImplementedError

    def response(self, torque: Vector) -> Vector:
        """I⁻¹ τ [rad/s²]: the acceleration that a torque alone would give."""
        raise NotImplementedError

    def implicit_velocity(
        self, start: Vector, guess: Vector, torque: Vector | None, span: Scalar, sweeps: int
    ) -> Vector:
        """Solve ω = start + span · ω̇(ω, τ) by `sweeps` Newton steps from `guess`."""
        omega = guess
        for _ in range(sweeps):
            momentum = self.inertia.apply(omega)
            net = cross(momentum, omega) if torque is None else cross(momentum, omega) + torque
            residual = self.inertia.apply(omega - start) - span * net
            omega = omega - _solve_linearised(self.inertia, omega, momentum, residual, span)
        return omega


def _solve_linearised(
    inertia: Inertia, omega: Vector, momentum: Vector, residual: Vector, span: Scalar
) -> Vector:
    """(I + span (ω* I − (Iω)*))⁻¹ residual by Cramer's rule."""
    xx, yy, zz, xy, xz, yz = components(inertia.six())
    columns = (stack(xx, xy, xz), stack(xy, yy, yz), stack(xz, yz, zz))
    zero = jnp.zeros_like(xx)
    one = jnp.ones_like(xx)
    units = (stack(one, zero, zero), stack(zero, one, zero), stack(zero, zero, one))
    jacobian = [
        column + span * (cross(omega, column) - cross(momentum, unit))
        for column, unit in zip(columns, units, strict=True)
    ]
    return solve(tuple(jacobian), residual)


class SphericalSolver(InertiaSolver):
    """No gyroscopic term: ω × Iω vanishes by type."""

    inertia: SphericalInertia
    inverse: Scalar

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector | None:
        return None if torque is None else self.response(torque)

    def response(self, torque: Vector) -> Vector:
        return stack(*(self.inverse * t for t in components(torque)))

    def implicit_velocity(self, start, guess, torque, span, sweeps):
        if torque is None:
            return start
        return start + span * self.acceleration(start, torque)


class PrincipalSolver(InertiaSolver):
    """ω̇₁ = k₁ ω₂ω₃ + τ₁/I₁ with k₁ = (I₂ − I₃)/I₁, and so on round: six products for a free body."""

    inertia: PrincipalInertia
    inverse: Vector
    coupling: Vector

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector:
        k1, k2, k3 = components(self.coupling)
        w1, w2, w3 = components(angular_velocity)
        free = (k1 * (w2 * w3), k2 * (w3 * w1), k3 * (w1 * w2))
        if torque is None:
            return stack(*free)
        return stack(
            *(f + i * t for f, i, t in zip(free, components(self.inverse), components(torque), strict=True))
        )

    def response(self, torque: Vector) -> Vector:
        return stack(*(i * t for i, t in zip(components(self.inverse), components(torque), strict=True)))

    def inverse_invariants(self) -> tuple[Scalar, Scalar, Scalar]:
        p, q, r = components(self.inverse)
        return p + q + r, p * q + q * r + r * p, p * q * r

    def implicit_velocity(self, start, guess, torque, span, sweeps):
        # The same Newton steps without the products by zero of the general matrix: a third of the time.
        k1, k2, k3 = (span * k for k in components(self.coupling))
        base = start if torque is None else start + span * self.inverse * torque
        b1, b2, b3 = components(base)
        omega = guess
        for _ in range(sweeps):
            w1, w2, w3 = components(omega)
            residual = stack(w1 - b1 - k1 * w2 * w3, w2 - b2 - k2 * w3 * w1, w3 - b3 - k3 * w1 * w2)
            one = jnp.ones_like(w1)
            columns = (
                stack(one, -k2 * w3, -k3 * w2),
                stack(-k1 * w3, one, -k3 * w1),
                stack(-k1 * w2, -k2 * w1, one),
            )
            omega = omega - solve(columns, residual)
        return omega


class FullSolver(InertiaSolver):
    """ω̇ = I⁻¹ (Iω × ω + τ); the inverse is formed once: solving at each stage costs 129 ns a body-step, not 36."""

    inertia: FullInertia
    inverse: Array

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector:
        net = cross(self.inertia.apply(angular_velocity), angular_velocity)
        return self.response(net if torque is None else net + torque)

    def response(self, torque: Vector) -> Vector:
        return symmetric_apply(self.inverse, torque)

    def inverse_invariants(self) -> tuple[Scalar, Scalar, Scalar]:
        xx, yy, zz, xy, xz, yz = components(self.inverse)
        minor = yy * zz - yz * yz
        others = xx * yy - xy * xy + (xx * zz - xz * xz)
        return xx + yy + zz, minor + others, xx * minor - xy * (xy * zz - xz * yz) + xz * (xy * yz - xz * yy)
