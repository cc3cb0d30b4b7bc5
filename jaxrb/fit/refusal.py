"""What the data cannot say: open directions of the inertia ratios, and requests that no free flight can meet."""

from collections.abc import Sequence

import numpy as np

from jaxrb.errors import InvalidInput, NotIdentifiable
from jaxrb.fit.profile import held, profile_rises
from jaxrb.fit.residuals import RATIO_COORDINATES
from jaxrb.fit.stages import Fitted, Problem
from jaxrb.fit.uncertainty import UNKNOWN, Directions, directions, fitted_information, in_words

# Half a χ² by which the fit must worsen before a direction counts as measured. In each flight noise gives
# about ±1 to a wobble whose frequency is free to be chosen: the sum grows as the root of their number.
_REAL, _REAL_A_FLIGHT = 15.0, 5.0
CAN_BE_REQUIRED = ("scale", "mass", "centre of mass")


class RatiosNotIdentifiable(NotIdentifiable):
    """The motion leaves directions of the inertia ratios open.

    `null_vectors` (n, 6) are those directions as changes of I/tr(I): xx, yy, zz, xy, xz, yz.
    """

    def __init__(self, message: str, null_vectors: np.ndarray):
        super().__init__(message)
        self.null_vectors = null_vectors


class ParametersNotIdentifiable(NotIdentifiable):
    """Mass, scale or centre of mass was asked for and leaves no trace in the recording.

    `null_vectors` (n, 10) are directions of mass, first moment (3) and inertia about the centre of mass (xx, yy, zz,
    xy, xz, yz) along which nothing that was recorded changes.
    """

    def __init__(self, message: str, null_vectors: np.ndarray):
        super().__init__(message)
        self.null_vectors = null_vectors


def check_names(required: Sequence[str]) -> None:
    """Refuse a name that is not among those that can be required."""
    for name in required:
        if name not in CAN_BE_REQUIRED:
            raise InvalidInput(f"fit_inertia: required has {name!r}; known are {', '.join(CAN_BE_REQUIRED)}.")


def check_required(
    required: Sequence[str], ratios: np.ndarray, scale_seen: bool, centre_seen: bool, source: str
) -> None:
    """Raise for what was asked for and cannot be seen; `ratios` (3, 3) is I/tr(I)."""
    missing, null = [], []
    six = np.array([ratios[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
    if "scale" in required and not scale_seen:
        missing.append(
            "the scale of the inertia: torque-free motion is the same for any multiple of it (null vector: the inertia "
            "itself). Give trace=…, or record a wheel of known momentum turning in the body"
        )
        null.append(np.concatenate([np.zeros(4), six]))
    if "mass" in required:
        missing.append(
            "the mass: free flight does not depend on it (null vector: mass alone, the inertia about its centre "
            "held). Weigh the body"
        )
        null.append(np.eye(10)[0])
    if "centre of mass" in required and not centre_seen:
        missing.append(
            "the centre of mass: rotation does not depend on where the axes' origin is (null vectors: the three first "
            "moments). Record an accelerometer and ask with centre_of_mass=True"
        )
        null.extend(np.eye(10)[1:4])
    if missing:
        raise ParametersNotIdentifiable(
            f"{source}: the recording does not determine {'; nor '.join(missing)}.", np.array(null)
        )


def open_directions(problem: Problem, fitted: Fitted) -> Directions:
    """The directions of the ratios that the data do not determine."""
    problem.progress("checking that each direction is really seen")
    # Where a sphere explains the data as well, it is the honest place to look from: the fit may have bent the
    # inertia to suit the noise, and there noise poses as a wobble.
    shared = np.asarray(fitted.solution.shared)
    sphere = held(problem, fitted, np.concatenate([np.zeros(RATIO_COORDINATES), shared[RATIO_COORDINATES:]]))
    if float(sphere.cost) - float(fitted.solution.cost) < 2.0 * _real(fitted):
        return _open_at(problem, fitted, sphere)
    return _open_at(problem, fitted, fitted.solution)


def _open_at(problem: Problem, fitted: Fitted, solution) -> Directions:
    found = directions(fitted_information(problem, solution, fitted.weight), np.asarray(solution.shared))
    unknown = found.deviation > UNKNOWN
    moves = found.move[:, :RATIO_COORDINATES]
    rises = profile_rises(problem, fitted, solution, moves, np.where(unknown, np.inf, found.deviation))
    unknown |= np.array([rise < min(_real(fitted), 0.3 * foretold) for rise, foretold in rises])
    return Directions(*(part[unknown] for part in found))


def _real(fitted: Fitted) -> float:
    return _REAL + _REAL_A_FLIGHT * float(np.sqrt(fitted.weight.sum()))


def refusal(problem: Problem, open_: Directions) -> str:
    """The open directions in words, what the spin was, and what to record instead."""
    spin = np.concatenate([problem.spin[f.start : f.stop] for f in problem.flights.flights])
    moment, axes = np.linalg.eigh(spin.T @ spin)
    angle = np.degrees(np.arctan2(np.sqrt(max(moment[:2].sum(), 0.0)), np.sqrt(moment[2])))
    axis = axes[:, 2] * np.sign(axes[np.argmax(np.abs(axes[:, 2])), 2])
    open_words = "; ".join(in_words(open_.rows))
    return (
        f"{problem.recording.source}: the motion determines {5 - len(open_.deviation)} of the 5 inertia "
        f"ratios. Left open: {open_words}. Changing the inertia that way changes nothing that was recorded. "
        f"The spin stays within {angle:.2g}° (root mean square) of the body axis "
        f"({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}). Record tosses that tumble, about several "
        "axes; a pure spin about a principal axis shows only that it is one. The scale of the inertia and "
        "the mass stay unknown in any free flight."
    )
