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
NEVER = {
    "scale": "torque-free motion is the same for any multiple of the inertia",
    "mass": "rotation in free flight does not depend on it",
    "centre of mass": "it is taken as the recorded point, which falls freely",
}


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
    tried. `cut_by` says by what the flights were found: "position", "accelerometer" or "declared".
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
        return "\n".join([*self._table(), *self._unknown(), *self._circumstances()])

    def _table(self) -> list[str]:
        robust, model = self.standard_errors, self.model_standard_errors
        # Two digits of the smallest error bar.
        smallest = max(float(np.min(robust.ratios)), 1e-9)
        digits = int(np.clip(1 - np.floor(np.log10(smallest)), 4, 9))
        width = digits + 5
        rows = [
            f"Inertia ratios I/tr(I) of {self.nuisance.source}",
            f"{'':10s}{'value':>{width}s}  {'± robust':>{width}s}  {'± model':>{width}s}",
        ]
        groups = (
            (("I_xx", "I_yy", "I_zz"), self.ratios, robust.ratios, model.ratios),
            (("I_xy", "I_xz", "I_yz"), self.products, robust.products, model.products),
            (
                ("smallest", "middle", "largest"),
                self.principal_ratios,
                robust.principal,
                model.principal,
            ),
        )
        for names, values, errors, others in groups:
            rows += [
                f"  {n:8s}{v:{width}.{digits}f}  {e:{width}.{digits}f}  {o:{width}.{digits}f}"
                for n, v, e, o in zip(names, values, errors, others)
            ]
        return [*rows, f"  (± robust: {self.error_kind})"]

    def _unknown(self) -> list[str]:
        known = [name for name, yes in self.identifiable.items() if yes]
        lines = [f"Determined: {', '.join(known)}."]
        for name, reason in NEVER.items():
            if name == "scale" and self.scale_known:
                how = "Taken as given: scale" if self.trace_error == 0.0 else "Determined by the wheel: scale"
                error = "" if self.trace_error == 0.0 else f" ± {self.trace_error:.2g}"
                lines.append(f"{how}, tr(I) = {self.trace:.6g}{error} kg m².")
            elif name == "centre of mass" and "lever_arm" in self.nuisance.values:
                arm, error, _ = self.nuisance.values["lever_arm"]
                lines.append(
                    "Determined: centre of mass; the accelerometer is at "
                    f"({', '.join(f'{a:.4f} ± {e:.2g}' for a, e in zip(arm, error))}) m from it."
                )
            else:
                lines.append(f"Not determined: {name}; {reason}.")
        return lines

    def _circumstances(self) -> list[str]:
        n = self.nuisance
        lines = [f"Used: {n.flights_used} free flights, {n.samples_used} samples."]
        if n.cut_by == "declared":
            lines.append("No positions to cut by: each toss was taken as one free flight.")
        elif n.cut_by == "accelerometer":
            lines.append("Flights were found by the accelerometer: where it shows nothing but the spin.")
        if n.rejected:
            lines.append(
                "Left out: " + ", ".join(f"{count} × {why}" for why, count in n.rejected.items()) + "."
            )
        if n.free_fall is not None:
            lines.append(f"Acceleration: {n.free_fall.sentence()}.")
        noises = ((n.spin_noise, "rad/s in angular velocity"), (n.attitude_noise, "rad in attitude"))
        found = [f"{value:.3g} {what}" for value, what in noises if value is not None]
        lines.append(
            f"Noise of a sample: {', '.join(found)}; "
            f"simulation error at most {n.integration_error:.1e} of it."
        )
        if n.residual_ratio is not None:
            lines.append(
                f"Residuals are {n.residual_ratio:.1f} times the scatter from sample to sample (ideal: 1)."
            )
        for name, (value, error, unit) in n.values.items():
            numbers = ", ".join(f"{v:.3g} ± {e:.2g}" for v, e in zip(value, error))
            lines.append(
                f"{name.replace('_', ' ').capitalize()}: {numbers} {unit if unit != '1' else ''}".rstrip()
                + "."
            )
        if n.tried:
            words = [
                f"{t.name} {t.likelihood_ratio:.1f} of {t.threshold:.1f} ({'needed' if t.needed else 'not needed'})"
                for t in n.tried
            ]
            lines.append(f"Tried, by likelihood ratio and what it must exceed: {'; '.join(words)}.")
        return [*lines, *(f"Fit: {stage}." for stage in n.stages[-1:])]

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
) -> InertiaFit:
    """Put a fit together from `ratios` (3, 3), the information on what was fitted, and each flight's toss."""
    shared, used = np.asarray(fitted.solution.shared), fitted.weight > 0
    scaled = "scale" in problem.residual.unknowns
    # Six ratios, and the logarithm of the scale.
    jacobian = np.zeros((7, len(shared)))
    jacobian[:6, :RATIO_COORDINATES] = ratio_jacobian(shared)
    if scaled:
        jacobian[6, problem.residual.place("scale")] = 1.0
    whole_model = jacobian @ model_covariance(info) @ jacobian.T
    whole_robust, kind = _quoted(info, jacobian, whole_model, toss, used)
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


def _quoted(info: Information, jacobian, model, toss, used) -> tuple[np.ndarray, str]:
    """The covariance to quote, and what it is."""
    tosses = len(np.unique(toss[used]))
    inner = jackknife_covariance(info, toss, used)
    if inner is None:
        return model, "one toss only: model-based, which real recordings exceed several times"
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
