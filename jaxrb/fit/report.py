"""What a fit hands back: numbers with error bars, what cannot be known, and a page to read."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxrb.body.inertia import FullInertia
from jaxrb.body.validity import inertia_matrix
from jaxrb.fit.free_fall import FreeFall
from jaxrb.fit.residuals import RATIO_COORDINATES
from jaxrb.fit.selection import Tried
from jaxrb.fit.stages import Fitted, Problem
from jaxrb.fit.uncertainty import (
    NAMES,
    PLACES,
    Information,
    jackknife_covariance,
    model_covariance,
    principal,
    ratio_jacobian,
)

# With fewer tosses the jackknife's own error is so large that the wider of the two error bars is quoted.
_FEW_TOSSES = 8


@dataclass(frozen=True)
class StandardErrors:
    """Standard errors (3,) of I/tr(I): `ratios` xx, yy, zz, `products` xy, xz, yz, and `principal`."""

    ratios: np.ndarray
    products: np.ndarray
    principal: np.ndarray


@dataclass(frozen=True)
class Nuisance:
    """What had to be fitted or decided along the way.

    `spin_noise` [rad/s] and `attitude_noise` [rad] are the standard deviations found for one component of one
    sample (`force_noise` [m/s²] that of the specific force), `residual_ratio` the former over the scatter from one
    sample to the next: 1 for a free tumble with white noise, more where something else is in the residuals.
    `angular_drag` c [1/s] is that of a torque −c tr(I) ω; `values` has the number, standard error (model-based) and
    unit of each nuisance by its name in `jaxrb.fit.UNKNOWNS`, `tried` the likelihood ratios of those that were
    tried; `believed` the mean and standard deviation that each was given beforehand. `cut_by` says by what the flights
    were found: "position", "accelerometer", "motion" (stretches without torque) or "declared".
    `integration_error` is the largest error of the simulation in units of the noise; `rejected` counts what was
    left out by reason.
    """

    source: str
    free_fall: FreeFall | None
    spin_noise: float | None
    attitude_noise: float | None
    force_noise: float | None
    residual_ratio: float | None
    angular_drag: float | None
    values: dict[str, tuple[np.ndarray, np.ndarray, str]]
    tried: tuple[Tried, ...]
    flights_used: int
    samples_used: int
    rejected: dict[str, int]
    cut_by: str
    integration_error: float
    stages: tuple[str, ...]
    believed: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class InertiaFit:
    """An inertia from a recording.

    `inertia` [kg m²] has trace 1 unless its scale was given or seen (`scale_known`); `trace` is its trace [kg m²]
    with `trace_error`, 0 where it was given or is only a convention. `ratios` (3,) are I_xx, I_yy, I_zz over tr(I)
    in the body frame, `principal_ratios` (3,) the principal moments over tr(I), ascending, with their axes as
    columns of `principal_axes` (3, 3). `standard_errors` and `covariance` (6, 6) of I/tr(I) as xx, yy, zz, xy, xz,
    yz are the robust ones (`error_kind` says how made); `model_*` believe in independent noise and are shown
    beside.
    """

    inertia: FullInertia
    scale_known: bool
    trace: float
    trace_error: float
    ratios: np.ndarray
    products: np.ndarray
    principal_ratios: np.ndarray
    principal_axes: np.ndarray
    standard_errors: StandardErrors
    covariance: np.ndarray
    model_standard_errors: StandardErrors
    model_covariance: np.ndarray
    error_kind: str
    identifiable: dict[str, bool]
    nuisance: Nuisance
    evidence: tuple[Problem, Fitted] = field(repr=False)

    def save_html(self, file: str | Path) -> Path:
        """Write a page with the table, residuals, bounds and advice: one self-contained file (needs [view])."""
        from jaxrb.fit.page import write_page

        return write_page(self, file)

    def summary(self) -> str:
        """A page of text."""
        from jaxrb.fit.words import summary

        return summary(self)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and text, for JSON."""
        n = self.nuisance

        def errors(which: StandardErrors) -> dict[str, list[float]]:
            return {key: getattr(which, key).tolist() for key in ("ratios", "products", "principal")}

        return {
            "inertia": inertia_matrix(self.inertia).tolist(),
            "scale_known": self.scale_known,
            "trace_kg_m2": self.trace,
            "trace_error_kg_m2": self.trace_error,
            "ratios": self.ratios.tolist(),
            "products": self.products.tolist(),
            "principal_ratios": self.principal_ratios.tolist(),
            "principal_axes": self.principal_axes.tolist(),
            "standard_errors": errors(self.standard_errors),
            "model_standard_errors": errors(self.model_standard_errors),
            "error_kind": self.error_kind,
            "covariance_order": list(NAMES),
            "covariance": self.covariance.tolist(),
            "identifiable": self.identifiable,
            "nuisance": {
                "source": n.source,
                "free_fall": None if n.free_fall is None else n.free_fall.as_dict(),
                "spin_noise_rad_s": n.spin_noise,
                "attitude_noise_rad": n.attitude_noise,
                "residual_ratio": n.residual_ratio,
                "force_noise_m_s2": n.force_noise,
                "angular_drag_1_s": n.angular_drag,
                "values": {
                    name: {"value": value.tolist(), "standard_error": error.tolist(), "unit": unit}
                    for name, (value, error, unit) in n.values.items()
                },
                "tried": [tried._asdict() for tried in n.tried],
                "flights_used": n.flights_used,
                "samples_used": n.samples_used,
                "rejected": n.rejected,
                "cut_by": n.cut_by,
                "integration_error_in_noise": n.integration_error,
                "stages": list(n.stages),
                "believed": {name: list(pair) for name, pair in n.believed.items()},
            },
        }


def inertia_fit(
    problem: Problem,
    fitted: Fitted,
    ratios: np.ndarray,
    info: Information,
    toss: np.ndarray,
    nuisance: Nuisance,
    trace: float | None,
    correlation: float = 1.0,
) -> InertiaFit:
    """Put a fit together from `ratios` (3, 3), the information on what was fitted, and each flight's toss.

    `correlation`: samples that tell as much as one would if noise were white.
    """
    shared, used = np.asarray(fitted.solution.shared), fitted.weight > 0
    scaled = "scale" in problem.residual.unknowns
    # Six ratios, and the logarithm of the scale.
    jacobian = np.zeros((7, len(shared)))
    jacobian[:6, :RATIO_COORDINATES] = ratio_jacobian(shared)
    if scaled:
        jacobian[6, problem.residual.place("scale")] = 1.0
    whole_model = jacobian @ model_covariance(info) @ jacobian.T
    whole_robust, kind = _quoted(info, jacobian, whole_model, toss, used, correlation)
    model, robust = whole_model[:6, :6], whole_robust[:6, :6]
    values, errors, axes = principal(ratios, robust)
    _, model_errors, _ = principal(ratios, model)
    size = 1.0 if trace is None else trace
    if scaled:
        size = problem.unit * float(np.exp(shared[problem.residual.place("scale")][0]))
    # A host array in float64; it takes a state's dtype when a run is prepared.
    inertia = FullInertia(np.array([ratios[place] for place in PLACES]) * size)
    return InertiaFit(
        inertia=inertia,
        scale_known=scaled or trace is not None,
        trace=size,
        trace_error=size * float(np.sqrt(max(whole_robust[6, 6], 0.0))) if scaled else 0.0,
        ratios=np.diag(ratios).copy(),
        products=np.array([ratios[place] for place in PLACES[3:]]),
        principal_ratios=values,
        principal_axes=axes,
        standard_errors=_standard_errors(robust, errors),
        covariance=robust,
        model_standard_errors=_standard_errors(model, model_errors),
        model_covariance=model,
        error_kind=kind,
        identifiable={
            **{f"ratio_{name}": True for name in NAMES},
            "scale": scaled,
            "mass": False,
            "centre of mass": "lever_arm" in problem.residual.unknowns,
        },
        nuisance=nuisance,
        evidence=(problem, fitted),
    )


def _quoted(info: Information, jacobian, model, toss, used, correlation) -> tuple[np.ndarray, str]:
    """The covariance to quote, and what it is."""
    tosses = len(np.unique(toss[used]))
    inner = jackknife_covariance(info, toss, used)
    if inner is None:
        # With noise of correlation time τ the sum of N scores has the variance of N/τ independent ones.
        return (
            correlation * model,
            f"one toss only: model-based, × √{correlation:.1f} for correlated residuals",
        )
    robust = jacobian @ inner @ jacobian.T
    if tosses >= _FEW_TOSSES:
        return robust, f"jackknife over {tosses} tosses"
    # Correlations of the jackknife, deviations of the wider: scaling rows and columns keeps it a covariance.
    deviation = np.sqrt(np.maximum(np.diag(robust), 1e-300))
    scale = np.maximum(np.sqrt(np.diag(model)) / deviation, 1.0)
    return robust * np.outer(scale, scale), f"jackknife over only {tosses} tosses, or model-based where wider"


def _standard_errors(covariance: np.ndarray, of_principal: np.ndarray) -> StandardErrors:
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return StandardErrors(deviation[:3], deviation[3:], of_principal)
