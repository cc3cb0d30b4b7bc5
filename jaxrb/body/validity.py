"""Whether an inertia belongs to any distribution of mass, and what to do when it does not."""

from typing import Any, Literal

import numpy as np

from jaxrb.body.inertia import FullInertia, Inertia, PrincipalInertia, SphericalInertia
from jaxrb.checks import as_array, is_concrete, warn
from jaxrb.errors import InvalidInput, WrongStructure

# Relative to the trace. Data sheets and CAD exports round to six digits, so that much is measurement, not error.
TOLERANCE = 1e-6
# Below this the deviation is round-off, of float32 too, and nothing is said: a thin plate has A + B = C exactly.
ROUND_OFF = 1e-7
_RANGE_REFUSED = 1e100
_RANGE_DOUBTFUL = 1e15

OnInvalid = Literal["raise", "warn", "project"]


def valid_inertia(value: Any, *, on_invalid: OnInvalid = "raise", where: str = "inertia") -> Inertia:
    """The inertia if some distribution of mass has it: symmetric, positive, no moment above the sum of the others.

    A violation up to 1e-6 of the trace is projected, with a warning. A larger one is refused ("raise"), let through
    with a warning ("warn"), or replaced by the nearest possible inertia in the second moments ("project"). Values that
    are being traced are let through.

    Raises:
        InvalidInput: naming the moments and what is wrong with them.
    """
    if on_invalid not in ("raise", "warn", "project"):
        raise WrongStructure(f"on_invalid={on_invalid!r}: choose 'raise', 'warn' or 'project'")
    if not isinstance(value, Inertia):
        value = as_array(where, value)
        if value.shape == (3, 3) and is_concrete(value):
            _check_symmetry(where, np.asarray(value), on_invalid)
    inertia = Inertia.of(value)
    numbers = inertia.components if isinstance(inertia, FullInertia) else _moments_of(inertia)
    if not is_concrete(numbers):
        return inertia
    matrices = np.asarray(inertia_matrix(inertia), float)
    worst = _worst_violation(where, matrices, np.asarray(numbers).dtype, on_invalid)
    return _projected(inertia, matrices) if worst else inertia


def inertia_matrix(inertia: Inertia) -> np.ndarray:
    """The matrix (..., 3, 3) on the host, without a call to a device."""
    if isinstance(inertia, FullInertia):
        xx, yy, zz, xy, xz, yz = np.moveaxis(np.asarray(inertia.components), -1, 0)
        return np.stack([np.stack(r, -1) for r in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))], -2)
    return _moments_of(inertia)[..., None] * np.eye(3)


def _moments_of(inertia: Inertia):
    if isinstance(inertia, PrincipalInertia):
        return np.asarray(inertia.moments) if is_concrete(inertia.moments) else inertia.moments
    assert isinstance(inertia, SphericalInertia)
    if not is_concrete(inertia.moment):
        return inertia.moment
    return np.repeat(np.asarray(inertia.moment)[..., None], 3, axis=-1)


def _check_symmetry(where: str, matrix: np.ndarray, on_invalid: OnInvalid) -> None:
    if not np.isfinite(matrix).all():
        raise InvalidInput(f"{where} is {matrix.tolist()} kg m², but must be finite")
    asymmetry = np.abs(matrix - matrix.T).max() / max(np.abs(np.trace(matrix)), np.finfo(float).tiny)
    if asymmetry <= 1e-12:
        return
    message = f"{where} {matrix.tolist()} kg m² is not symmetric: the entries differ by {asymmetry:.1e} of the trace"
    if asymmetry > TOLERANCE and on_invalid == "raise":
        raise InvalidInput(f"{message}; give (M + Mᵀ)/2 if that is what is meant")
    warn(f"{message}; its symmetric part is used")


def _worst_violation(where: str, matrices: np.ndarray, dtype, on_invalid: OnInvalid) -> bool:
    """Raise or warn as asked; True where the inertia is to be projected."""
    moments = np.linalg.eigvalsh(matrices)
    trace = moments.sum(axis=-1)
    _check_range(where, moments)
    gap = moments[..., :2].sum(axis=-1) - moments[..., 2]
    for margin, problem in (
        (moments[..., 0], "a moment is not positive"),
        (gap, "the largest moment exceeds the sum of the two others (triangle inequality)"),
    ):
        relative = (margin / trace).ravel()
        body = int(relative.argmin())
        strict = problem.startswith("a moment")
        broken = relative[body] <= 0 if strict else relative[body] < -ROUND_OFF
        if not broken:
            continue
        name = where if moments.ndim == 1 else f"{where} of body {body}"
        message = (
            f"{name} has principal moments {moments.reshape(-1, 3)[body].tolist()} kg m²: {problem} "
            f"(by {-relative[body]:.1e} of the trace), which no distribution of mass has"
        )
        if on_invalid == "raise" and (strict or relative[body] < -TOLERANCE):
            mend = "check the units and the axes, or use valid_inertia(..., on_invalid='project')"
            raise InvalidInput(f"{message}; {mend}")
        warn(
            f"{message}; "
            + ("it is used as it is" if on_invalid == "warn" else "the nearest possible is used")
        )
        return on_invalid != "warn"
    return False


def _check_range(where: str, moments: np.ndarray) -> None:
    largest = moments[..., 2]
    if not (largest > 0).all():
        raise InvalidInput(
            f"{where} has principal moments {moments.reshape(-1, 3)[int(largest.argmin())].tolist()} kg m², but they "
            "must be positive; give the moments about the centre of mass"
        )
    check_range(where, largest, "kg m²")


def check_range(where: str, values: np.ndarray, unit: str) -> None:
    """Refuse numbers whose products leave the floating range, doubt those that look like a wrong unit."""
    for value in np.ravel(values).astype(float):  # the limits are no numbers of float32
        if not 1.0 / _RANGE_REFUSED <= value <= _RANGE_REFUSED:
            raise InvalidInput(
                f"{where} is {value} {unit}: products of such numbers leave the floating range; choose larger units"
            )
        if not 1.0 / _RANGE_DOUBTFUL <= value <= _RANGE_DOUBTFUL:
            warn(f"{where} is {value} {unit}, outside 1e±15: is the unit right?")
            return


def _projected(inertia: Inertia, matrices: np.ndarray) -> Inertia:
    """The inertia whose second moments Σ = tr(I)/2 − I are clipped at zero."""
    moments, axes = np.linalg.eigh(matrices)
    second = np.maximum(0.5 * moments.sum(axis=-1, keepdims=True) - moments, 0.0)
    repaired = second.sum(axis=-1, keepdims=True) - second
    if not (repaired > 0).all():
        raise InvalidInput(
            f"inertia with principal moments {moments.tolist()} kg m²: the nearest possible is that of a thin "
            "rod, which has no moment about its axis; give the rod a thickness"
        )
    if isinstance(inertia, PrincipalInertia):
        order = np.argsort(np.argsort(np.asarray(inertia.moments), axis=-1), axis=-1)
        return PrincipalInertia(np.take_along_axis(repaired, order, axis=-1))
    return FullInertia.from_matrix((axes * repaired[..., None, :]) @ np.swapaxes(axes, -1, -2))
