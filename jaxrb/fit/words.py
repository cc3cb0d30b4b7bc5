"""A fit in words: the table, what cannot be known and why, and how the numbers came about."""

import numpy as np

from jaxrb.fit.report import InertiaFit, Nuisance

NEVER = {
    "scale": "torque-free motion is the same for any multiple of the inertia",
    "mass": "rotation in free flight does not depend on it",
    "centre of mass": "it is taken as the recorded point, which falls freely",
}


def summary(found: InertiaFit) -> str:
    """A page of text."""
    return "\n".join([*_table(found), *_unknown(found), *_circumstances(found.nuisance)])


def _table(found: InertiaFit) -> list[str]:
    robust, model = found.standard_errors, found.model_standard_errors
    # Two digits of the smallest error bar.
    smallest = max(float(np.min(robust.ratios)), 1e-9)
    digits = int(np.clip(1 - np.floor(np.log10(smallest)), 4, 9))
    width = digits + 5
    rows = [
        f"Inertia ratios I/tr(I) of {found.nuisance.source}",
        f"{'':10s}{'value':>{width}s}  {'± robust':>{width}s}  {'± model':>{width}s}",
    ]
    groups = (
        (("I_xx", "I_yy", "I_zz"), found.ratios, robust.ratios, model.ratios),
        (("I_xy", "I_xz", "I_yz"), found.products, robust.products, model.products),
        (
            ("smallest", "middle", "largest"),
            found.principal_ratios,
            robust.principal,
            model.principal,
        ),
    )
    for names, values, errors, others in groups:
        rows += [
            f"  {n:8s}{v:{width}.{digits}f}  {e:{width}.{digits}f}  {o:{width}.{digits}f}"
            for n, v, e, o in zip(names, values, errors, others)
        ]
    return [*rows, f"  (± robust: {found.error_kind})"]


def _unknown(found: InertiaFit) -> list[str]:
    known = [name for name, yes in found.identifiable.items() if yes]
    lines = [f"Determined: {', '.join(known)}."]
    for name, reason in NEVER.items():
        if name == "scale" and found.scale_known:
            how = "Taken as given: scale" if found.trace_error == 0.0 else "Determined by the wheel: scale"
            error = "" if found.trace_error == 0.0 else f" ± {found.trace_error:.2g}"
            lines.append(f"{how}, tr(I) = {found.trace:.6g}{error} kg m².")
        elif name == "centre of mass" and "lever_arm" in found.nuisance.values:
            arm, error, _ = found.nuisance.values["lever_arm"]
            lines.append(
                "Determined: centre of mass; the accelerometer is at "
                f"({', '.join(f'{a:.4f} ± {e:.2g}' for a, e in zip(arm, error))}) m from it."
            )
        else:
            lines.append(f"Not determined: {name}; {reason}.")
    return lines


def _circumstances(n: Nuisance) -> list[str]:
    lines = [f"Used: {n.flights_used} free flights, {n.samples_used} samples."]
    if n.cut_by == "declared":
        lines.append("No positions to cut by: each toss was taken as one free flight.")
    elif n.cut_by == "accelerometer":
        lines.append("Flights were found by the accelerometer: where it shows nothing but the spin.")
    elif n.cut_by == "motion":
        lines.append(
            "Flights were found by the motion: the longest stretch of each toss that needs no torque."
        )
    if n.rejected:
        lines.append("Left out: " + ", ".join(f"{count} × {why}" for why, count in n.rejected.items()) + ".")
    if n.free_fall is not None:
        lines.append(f"Acceleration: {n.free_fall.sentence()}.")
    noises = ((n.spin_noise, "rad/s in angular velocity"), (n.attitude_noise, "rad in attitude"))
    found = [f"{value:.3g} {what}" for value, what in noises if value is not None]
    lines.append(
        f"Noise of a sample: {', '.join(found)}; simulation error at most {n.integration_error:.1e} of it."
    )
    if n.residual_ratio is not None:
        lines.append(
            f"Residuals are {n.residual_ratio:.1f} times the scatter from sample to sample (ideal: 1)."
        )
    for name, (value, error, unit) in n.values.items():
        numbers = ", ".join(f"{v:.3g} ± {e:.2g}" for v, e in zip(value, error))
        lines.append(
            f"{name.replace('_', ' ').capitalize()}: {numbers} {unit if unit != '1' else ''}".rstrip() + "."
        )
    if n.believed:
        words = [f"{name} {mean:g} ± {deviation:g}" for name, (mean, deviation) in n.believed.items()]
        lines.append(f"Believed beforehand: {', '.join(words)}.")
    if n.tried:
        words = [
            f"{t.name} {t.likelihood_ratio:.1f} of {t.threshold:.1f} ({'needed' if t.needed else 'not needed'})"
            for t in n.tried
        ]
        lines.append(f"Tried, by likelihood ratio and what it must exceed: {'; '.join(words)}.")
    return [*lines, *(f"Fit: {stage}." for stage in n.stages[-1:])]
