"""Log-Cholesky coordinates: any numbers give an inertia that some distribution of mass has, and back.

The moments of a body obey the triangle inequality exactly when its second moments
Σ = ∫ r rᵀ dm = ½ tr(I) 1 − I are positive definite, and a positive definite matrix is L Lᵀ with a positive
diagonal. Logarithms of that diagonal make the coordinates free: no constraint, no boundary in reach. All
functions are smooth and go both ways.

Source: Rucker and Wensing 2022, "Smooth parameterization of rigid-body inertia", IEEE RA-L 7(2), 2771. Their
upper triangular factor is kept for the ten parameters; the inertia alone uses the lower one.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput
from jaxrb.math.arrays import Array, Matrix, Scalar, Vector

_BELOW = ((1, 0), (2, 0), (2, 1))


class MassMoments(NamedTuple):
    """Zeroth, first and second moments of a body's mass about the origin of its frame.

    `mass` () [kg], `first_moment` (3,) [kg m] = mass × centre of mass, `inertia` (3, 3) [kg m²] about the
    origin.
    """

    mass: Scalar
    first_moment: Vector
    inertia: Matrix


def second_moments(inertia: Matrix) -> Matrix:
    """Σ = ½ tr(I) 1 − I (..., 3, 3) [kg m²]; its own inverse up to the factor: I = tr(Σ) 1 − Σ."""
    inertia = jnp.asarray(inertia)
    trace = jnp.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    return 0.5 * trace * jnp.eye(3, dtype=inertia.dtype) - inertia


def inertia_of_second_moments(second: Matrix) -> Matrix:
    """I = tr(Σ) 1 − Σ (..., 3, 3)."""
    trace = jnp.trace(second, axis1=-2, axis2=-1)[..., None, None]
    return trace * jnp.eye(3, dtype=second.dtype) - second


def inertia_from_coordinates(coordinates: Array) -> Matrix:
    """Inertia (3, 3) [kg m²] from six log-Cholesky coordinates: log L₁₁, log L₂₂, log L₃₃, L₂₁, L₃₁, L₃₂."""
    return inertia_of_second_moments(_gram(coordinates[:3], coordinates[3:]))


def coordinates_from_inertia(inertia: Matrix) -> Array:
    """The six coordinates (6,) of an inertia (3, 3).

    Raises:
        InvalidInput: if the numbers are known and no distribution of mass has this inertia. Traced: NaN.
    """
    lower = _cholesky(second_moments(inertia), "inertia", inertia)
    return jnp.concatenate([jnp.log(jnp.diagonal(lower)), jnp.stack([lower[i, j] for i, j in _BELOW])])


def ratios_from_coordinates(coordinates: Array) -> Matrix:
    """I / tr I (3, 3) from five coordinates: log L₁₁, log L₂₂, L₂₁, L₃₁, L₃₂ of a Σ with L₃₃ = 1.

    A body's scale has no coordinate here, since torque-free motion does not depend on it.
    """
    log_diagonal = jnp.concatenate([coordinates[:2], jnp.zeros_like(coordinates[:1])])
    second = _gram(log_diagonal, coordinates[2:])
    return inertia_of_second_moments(second / (2.0 * jnp.trace(second)))


def coordinates_from_ratios(inertia: Matrix) -> Array:
    """The five coordinates (5,) of an inertia of any scale. Raises as `coordinates_from_inertia`."""
    six = coordinates_from_inertia(inertia)
    return jnp.concatenate([six[:2] - six[2], six[3:] * jnp.exp(-six[2])])


def moved_ratios(coordinates: Array, step: Array) -> Array:
    """Five coordinates a step (5,) away, in the body's own measure: L K(step) with K of these same coordinates.

    Lower triangular matrices are a group, so any step leads to coordinates, and a step of one changes a thin plate by
    as much of itself as it changes a sphere. Plain sums ran off to plates from which no way led back.
    """
    d2, (l21, l31, l32) = jnp.exp(coordinates[1]), coordinates[2:]
    (k1, k2), (k21, k31, k32) = jnp.exp(step[:2]), step[2:]
    below = jnp.stack([l21 * k1 + d2 * k21, l31 * k1 + l32 * k21 + k31, l32 * k2 + k32])
    return jnp.concatenate([coordinates[:2] + step[:2], below])


def moments_from_coordinates(coordinates: Array) -> MassMoments:
    """Mass, first moment and inertia from ten coordinates α, d₁ d₂ d₃, s₁₂ s₂₃ s₁₃, t₁ t₂ t₃.

    The pseudo-inertia [[Σ, h], [hᵀ, m]] is U Uᵀ with the U of `factor_from_coordinates`.
    """
    upper = factor_from_coordinates(coordinates)
    pseudo = upper @ upper.T
    return MassMoments(pseudo[3, 3], pseudo[:3, 3], inertia_of_second_moments(pseudo[:3, :3]))


def factor_from_coordinates(coordinates: Array) -> Matrix:
    """U (4, 4) = e^α [[e^d₁, s₁₂, s₁₃, t₁], [0, e^d₂, s₂₃, t₂], [0, 0, e^d₃, t₃], [0, 0, 0, 1]]."""
    alpha, d, (s12, s23, s13), t = (
        coordinates[0],
        jnp.exp(coordinates[1:4]),
        coordinates[4:7],
        coordinates[7:],
    )
    zero, one = jnp.zeros_like(alpha), jnp.ones_like(alpha)
    rows = [
        (d[0], s12, s13, t[0]),
        (zero, d[1], s23, t[1]),
        (zero, zero, d[2], t[2]),
        (zero, zero, zero, one),
    ]
    return jnp.exp(alpha) * jnp.stack([jnp.stack(row) for row in rows])


def coordinates_from_moments(moments: MassMoments) -> Array:
    """The ten coordinates (10,) of a body's moments. Raises as `coordinates_from_inertia`."""
    upper = factor_from_moments(moments)
    alpha = jnp.log(upper[3, 3])
    unit = upper / upper[3, 3]
    d = jnp.log(jnp.diagonal(unit)[:3])
    return jnp.concatenate([alpha[None], d, jnp.stack([unit[0, 1], unit[1, 2], unit[0, 2]]), unit[:3, 3]])


def factor_from_moments(moments: MassMoments) -> Matrix:
    """The upper triangular U (4, 4) with a positive diagonal. Raises as `coordinates_from_inertia`."""
    first = jnp.asarray(moments.first_moment)
    mass = jnp.asarray(moments.mass, first.dtype)
    pseudo = jnp.block(
        [[second_moments(moments.inertia), first[:, None]], [first[None, :], mass[None, None]]]
    )
    # The lower factor of the matrix read backwards is the upper one, read backwards.
    return _cholesky(pseudo[::-1, ::-1], "mass, first moment and inertia", pseudo)[::-1, ::-1]


def _gram(log_diagonal: Array, below: Array) -> Matrix:
    """L Lᵀ of a lower triangular L."""
    d1, d2, d3 = jnp.exp(log_diagonal)
    l21, l31, l32 = below
    xy, xz, yz = d1 * l21, d1 * l31, l21 * l31 + d2 * l32
    yy, zz = l21 * l21 + d2 * d2, l31 * l31 + l32 * l32 + d3 * d3
    return jnp.stack([jnp.stack([d1 * d1, xy, xz]), jnp.stack([xy, yy, yz]), jnp.stack([xz, yz, zz])])


def _cholesky(matrix: Array, name: str, value: Array) -> Array:
    lower = jnp.linalg.cholesky(matrix)
    if is_concrete(lower) and not np.all(np.isfinite(np.asarray(lower))):
        raise InvalidInput(
            f"{name} {np.asarray(value).tolist()}: no distribution of mass with three dimensions has it "
            "(each moment must be below the sum of the other two). Give a thin plate a little thickness."
        )
    return lower
