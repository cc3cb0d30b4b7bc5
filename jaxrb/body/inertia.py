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
from jaxrb.math.arrays import Array, Matrix, Scalar, Vector, components, entries, from_entries, stack
from jaxrb.math.rotation import Rotation
from jaxrb.math.safe import unit_or
from jaxrb.math.vector import dot, dot_of


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
        r = entries(rotation.as_matrix())
        scaled = self._rows_times_tensor(r)
        six = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        return FullInertia.of_six(stack(*(dot_of(scaled[i], r[j]) for i, j in six)))

    def _rows_times_tensor(self, rows: list[list[Array]]) -> list[list[Array]]:
        """The entries of R I, of the entries of R."""
        tensor = entries(self.as_matrix())
        return [[dot_of(row, tensor[j]) for j in range(3)] for row in rows]

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

    def _rows_times_tensor(self, rows: list[list[Array]]) -> list[list[Array]]:
        return [[r * self.moment for r in row] for row in rows]

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

    def _rows_times_tensor(self, rows: list[list[Array]]) -> list[list[Array]]:
        moments = components(self.moments)
        return [[r * moment for r, moment in zip(row, moments, strict=True)] for row in rows]

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
    return stack(*symmetric_of(components(six), components(v)))


def symmetric_of(six: Any, v: Any) -> tuple[Any, Any, Any]:
    """The same of six and three components, of any shape."""
    xx, yy, zz, xy, xz, yz = six
    x, y, z = v
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


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
