"""All ten inertial parameters of a body as one unknown of `rb.fit`, with a prior and a bounding shape if wished.

The pseudo-inertia J = [[Σ, h], [hᵀ, m]] moves as U₀ K Kᵀ U₀ᵀ, with U₀ the factor of the start and K the factor of ten
log-Cholesky coordinates (Rucker and Wensing 2022, IEEE RA-L 7(2), 2771). Upper triangular matrices are a group, so
every J that is positive definite is reached, no step leads out of them, and a step of one changes any body by as much
of itself.

The prior is the log-determinant (entropic) divergence D(J ‖ J₀) = tr(J₀⁻¹J) − log det(J₀⁻¹J) − 4, which knows neither
units nor axes (Lee, Wensing, Park 2020, "Geometric robot dynamic identification", IEEE T-RO 36(2), 348). A mass
distribution inside an ellipsoid has ∫ (1 − xᵀS⁻¹x) dm ≥ 0, and whatever obeys that has one (Wensing, Kim, Slotine 2018,
"Linear matrix inequalities for physically consistent inertial parameter identification", IEEE RA-L 3(1), 60).
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.inertia import FullInertia
from jaxrb.body.mass_properties import MassProperties
from jaxrb.errors import InvalidInput
from jaxrb.fit.parametrise import (
    MassMoments,
    factor_from_coordinates,
    factor_from_moments,
    inertia_of_second_moments,
)
from jaxrb.geometry.primitives import Box, Ellipsoid, Sphere
from jaxrb.math.arrays import Array, Matrix, Scalar

PARAMETERS = ("mass", "h_x", "h_y", "h_z", "I_xx", "I_yy", "I_zz", "I_xy", "I_xz", "I_yz")
_SERIES = 0.05  # below this, e²ˣ − 1 − 2x is summed as a series: terms to x⁷ leave 1e-14
_ON_BOUND = 1e-3  # of the whole: a bound with less to spare is said to be reached


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass, centre of mass and inertia of one body as an unknown of `rb.fit` (a leaf of the tree it starts from).

    The scene's function is given a `MassProperties` in its place, for `rb.Body.from_mass_properties`.

    Args:
        start: a `Body` or `MassProperties` to begin from.
        prior: a `Body` or `MassProperties` that the fit is pulled towards; adds `prior_weight` × D to half the sum of
            squares. Where the data say nothing, the least D decides.
        prior_weight: positive; n is worth about as much as n samples of one number, off by a standard deviation where
            a parameter is off by its whole.
        within: `Box`, `Ellipsoid` or `Sphere` that holds all mass, in the frame in which the centre of mass is given.
            Exact for ellipsoids; of a box the three conditions ∫ (b² − x²) dm ≥ 0, one for each pair of faces, which
            are necessary, not sufficient.

    Raises:
        InvalidInput: a start or prior that no distribution of mass has, a start outside the bounding shape.
    """

    start: Any
    prior: Any = None
    prior_weight: float = 1.0
    within: Any = None

    def __post_init__(self):
        if not (np.isfinite(self.prior_weight) and self.prior_weight > 0):
            raise InvalidInput(f"Inertial: prior_weight is {self.prior_weight}, but must be positive.")
        if self.within is not None and not isinstance(self.within, (Box, Ellipsoid, Sphere)):
            raise InvalidInput(
                f"Inertial: within is {self.within!r}; give rb.Box, rb.Ellipsoid or rb.Sphere around it."
            )
        for body in (self.start, self.prior):
            if body is not None:
                factor(body)
        spare = self.spare(jnp.zeros(self.size))
        if spare.size and float(spare.min()) <= 0:
            raise InvalidInput(
                f"Inertial: the start has no place inside {self.within!r}: of its second moments "
                f"{[round(1 - float(s), 4) for s in spare]} are used, and must be below 1. Start smaller or nearer."
            )

    @property
    def size(self) -> int:
        """Numbers of a step."""
        return len(PARAMETERS)

    @property
    def penalised(self) -> bool:
        """Whether it adds to the cost by itself."""
        return self.prior is not None or self.within is not None

    def moved(self, step: Array) -> Matrix:
        """Factor (4, 4) of the pseudo-inertia a step (10,) away from the start."""
        return factor(self.start) @ factor_from_coordinates(step)

    def value(self, step: Array) -> MassProperties:
        """The body a step (10,) away."""
        return properties_of_factor(self.moved(step))

    def penalty(self, step: Array, barrier: Scalar) -> Array:
        """Residuals (R,) whose half sum of squares is prior_weight × D − barrier × Σ log of what bounds spare."""
        upper, rows = self.moved(step), []
        if self.prior is not None:
            rows.append(jnp.sqrt(2.0 * self.prior_weight) * divergence_residuals(upper, factor(self.prior)))
        # At most the whole is spared, so the logarithm is negative.
        rows.append(jnp.sqrt(2.0 * barrier) * jnp.sqrt(-jnp.log(self._spare(upper))))
        return jnp.concatenate(rows)

    def spare(self, step: Array) -> Array:
        """What each condition of the bounding shape has to spare (B,): 1 for a point at its centre, 0 on the bound."""
        return self._spare(self.moved(step))

    def reached(self, step: Array) -> bool:
        """Whether the bounding shape holds the estimate back."""
        return bool(np.any(np.asarray(self.spare(step)) < _ON_BOUND))

    def relative(self, step: Array) -> np.ndarray:
        """Derivative (10, 10) by a step of `PARAMETERS` about the frame's origin, in units m, m ℓ, m ℓ² of the body.

        ℓ² = tr(Σ)/m: so that changes of different units can be compared.
        """

        def parameters(step):
            upper = self.moved(step)
            pseudo = upper @ upper.T
            inertia = inertia_of_second_moments(pseudo[:3, :3])
            return pseudo[3, 3], pseudo[:3, 3], FullInertia.from_matrix(inertia).six()

        mass, _, six = (np.asarray(part) for part in parameters(step))
        length = np.sqrt(0.5 * six[:3].sum() / mass)
        units = np.repeat([mass, mass * length, mass * length**2], [1, 3, 6])
        by_step = jax.jacfwd(lambda s: jnp.concatenate([jnp.atleast_1d(part) for part in parameters(s)]))
        return np.asarray(by_step(step)) / units[:, None]

    def relative_names(self, name: str) -> list[str]:
        """Of the rows of `relative`."""
        return [f"{name}.{parameter}" if name else parameter for parameter in PARAMETERS]

    def _spare(self, upper: Matrix) -> Array:
        if self.within is None:
            return jnp.zeros((0,), upper.dtype)
        second = jnp.sum(upper[:3] ** 2, axis=1) / upper[3, 3] ** 2  # [m²] about the frame's origin
        if isinstance(self.within, Box):
            return 1.0 - second / jnp.asarray(self.within.half_extents) ** 2
        radii = self.within.radii if isinstance(self.within, Ellipsoid) else self.within.radius
        return 1.0 - jnp.sum(second / jnp.asarray(radii) ** 2, keepdims=True)


def factor(body: Any) -> Matrix:
    """Upper triangular factor (4, 4) of a body's pseudo-inertia, about the origin of the frame of its centre of mass.

    Raises:
        InvalidInput: if the numbers are known and no distribution of mass with three dimensions has them.
    """
    center, mass = jnp.asarray(body.center_of_mass, float), jnp.asarray(body.mass, float)
    inertia = jnp.asarray(body.inertia.as_matrix(), float)
    # About the centre of mass the first moment is zero; the factor then moves there without a loss of digits.
    own = factor_from_moments(MassMoments(mass, jnp.zeros(3, center.dtype), inertia))
    return own.at[:3, 3].set(own[3, 3] * center)


def properties_of_factor(upper: Matrix) -> MassProperties:
    """Mass, centre of mass and inertia of a factor (4, 4): its upper left block is that about the centre of mass."""
    block = upper[:3, :3]
    inertia = FullInertia.from_matrix(inertia_of_second_moments(block @ block.T))
    return MassProperties(upper[3, 3] ** 2, upper[:3, 3] / upper[3, 3], inertia)


def divergence_residuals(upper: Matrix, towards: Matrix) -> Array:
    """Ten numbers whose sum of squares is the log-determinant divergence of J = U Uᵀ from J₀ = U₀ U₀ᵀ.

    With K = U₀⁻¹ U the trace is Σ K_ij² and the determinant Π K_ii²: D = Σ (K_ii² − 1 − 2 log K_ii) + Σ_{i<j} K_ij².
    """
    ratio = jax.scipy.linalg.solve_triangular(towards, upper)
    return jnp.concatenate([_signed_root(jnp.log(jnp.diagonal(ratio))), ratio[np.triu_indices(4, 1)]])


def entropic_divergence(body: Any, towards: Any) -> Scalar:
    """D(J ‖ J₀) of two bodies (`Body` or `MassProperties`): 0 where equal; the same in any units and axes."""
    return jnp.sum(divergence_residuals(factor(body), factor(towards)) ** 2)


def _signed_root(x: Array) -> Array:
    """sign(x) √(e²ˣ − 1 − 2x), smooth through zero, where it is √2 x."""
    near = jnp.abs(x) < _SERIES
    far, small = jnp.where(near, 1.0, x), jnp.where(near, x, 0.0)
    # (e²ˣ − 1 − 2x) / 2x² = Σ 2ⁿ⁻¹ xⁿ⁻² / n!
    series = jnp.polyval(
        jnp.asarray([2 / 2835, 1 / 315, 4 / 315, 2 / 45, 2 / 15, 1 / 3, 2 / 3, 1.0], x.dtype), small
    )
    root = jnp.sign(far) * jnp.sqrt(jnp.expm1(2.0 * far) - 2.0 * far)
    return jnp.where(near, np.sqrt(2.0) * small * jnp.sqrt(series), root)
