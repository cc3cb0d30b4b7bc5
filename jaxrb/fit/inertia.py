"""A recording becomes an inertia, with error bars and a word on what cannot be known."""

import warnings
from collections.abc import Callable

import jax
import numpy as np

from jaxrb.errors import InvalidInput, JaxrbWarning, NotIdentifiable, RunFailed
from jaxrb.fit.free_fall import FreeFall, fit_free_fall
from jaxrb.fit.least_squares import Solution
from jaxrb.fit.packing import spin_noise
from jaxrb.fit.parametrise import coordinates_from_ratios, ratios_from_coordinates
from jaxrb.fit.report import InertiaFit, Nuisance, inertia_fit
from jaxrb.fit.residuals import RATIO_COORDINATES, TrajectoryResidual
from jaxrb.fit.segments import STANDARD_GRAVITY, Flights, find_flights
from jaxrb.fit.stages import Fitted, Problem, held, profile_rises, search, substeps_for
from jaxrb.fit.uncertainty import UNKNOWN, Directions, directions, in_words, information
from jaxrb.io.recording import Recording
from jaxrb.math import Quaternion

# Half a χ² by which the fit must worsen before a direction counts as measured. In each flight noise gives
# about ±1 to a wobble whose frequency is free to be chosen: the sum grows as the root of their number.
_REAL, _REAL_A_FLIGHT = 15.0, 5.0
# Residuals this many times the scatter from sample to sample are more than noise; a tracker's smoothing alone
# makes it 3.
_MISFIT = 6.0


class RatiosNotIdentifiable(NotIdentifiable):
    """The motion leaves directions of the inertia ratios open.

    `null_vectors` (n, 6) are those directions as changes of I/tr(I): xx, yy, zz, xy, xz, yz.
    """

    def __init__(self, message: str, null_vectors: np.ndarray):
        super().__init__(message)
        self.null_vectors = null_vectors


def fit_inertia(
    recording: Recording,
    *,
    trace: float | None = None,
    angular_drag: bool = False,
    gravity: float = STANDARD_GRAVITY,
    minimum_samples: int = 7,
    start: np.ndarray | None = None,
    max_iterations: int = 200,
    progress: Callable[[str], None] | None = None,
) -> InertiaFit:
    """Inertia of a tumbling body from its free flights, by least squares on whole trajectories.

    Torque-free motion fixes the inertia only up to its scale, so the result has trace 1 unless `trace` gives
    the scale from elsewhere; mass and centre of mass are never seen. Everything is computed in float64, also
    where JAX's default is float32 (inside a local `jax.enable_x64(True)`; no global setting is touched).

    Args:
        recording: with angular velocity, orientation or both. With positions, free flights are cut out of it
            and the free-fall acceleration is measured beside; without, each toss is taken as one free flight.
        trace: tr(I) [kg m²], if known.
        angular_drag: also fit a torque −c tr(I) ω. Left out where there is drag, it biases the smallest
            moment.
        gravity: expected free-fall acceleration [m/s²], to find flights by.
        minimum_samples: shorter flights are left out.
        start: (3, 3) inertia of any scale to start from; by default a sphere.
        max_iterations: of each least-squares problem.
        progress: called with a line of text now and then.

    Raises:
        InvalidInput: for a recording without rotation or without flights, or a bad option.
        NotIdentifiable: if the motion leaves the ratios open, such as a spin about one principal axis; the
            message names the open directions and `null_vectors` holds them.
    """
    if recording.angular_velocity is None and recording.orientation is None:
        raise InvalidInput(
            f"{recording.source}: neither angular_velocity nor orientation; the inertia leaves no trace."
        )
    if trace is not None and not (np.isfinite(trace) and trace > 0):
        raise InvalidInput(f"fit_inertia: trace is {trace}, but must be a positive number [kg m²].")
    flights = find_flights(recording, gravity=gravity, minimum_samples=minimum_samples)
    if not len(flights):
        raise InvalidInput(f"{recording.source}: no toss has the 3 samples that a flight needs.")
    with jax.enable_x64(True):
        problem = _problem(recording, flights, angular_drag, progress or (lambda line: None))
        fitted = search(problem, _starts(start, angular_drag), max_iterations)
        info = information(fitted.solution.normal, fitted.weight)
        shared = np.asarray(fitted.solution.shared)
        misfit = _misfit(problem, fitted)
        open_ = _open_directions(problem, fitted)
        if len(open_.deviation):
            if misfit > _MISFIT:
                raise RunFailed(f"{recording.source}: no free tumble was found that fits. {_doubt(misfit)}")
            raise RatiosNotIdentifiable(_refusal(problem, open_), open_.rows)
        if misfit > _MISFIT:
            warnings.warn(f"{recording.source}: {_doubt(misfit)}", JaxrbWarning, stacklevel=2)
        ratios = np.asarray(ratios_from_coordinates(shared[:RATIO_COORDINATES]))
        nuisance = _nuisance(problem, fitted, _free_fall(recording, flights), misfit)
        toss = np.array([flight.toss for flight in flights.flights])
        return inertia_fit(ratios, shared, info, toss, fitted.weight > 0, nuisance, trace)


def _starts(start: np.ndarray | None, drag: bool) -> list[np.ndarray]:
    """Coordinates to begin from: the caller's, a sphere, and three discs."""
    # A disc's moments obey A + B = C; this one has a little thickness.
    discs = [np.eye(3) + 0.9 * np.diag(row) for row in np.eye(3)]
    inertias = [*([] if start is None else [np.asarray(start, float)]), np.eye(3), *discs]
    return [np.concatenate([coordinates_from_ratios(i), np.zeros(int(drag))]) for i in inertias]


def _misfit(problem: Problem, fitted: Fitted) -> float:
    """Residuals of the angular velocity over what they scatter by from one sample to the next."""
    if not problem.residual.use_spin:
        return 0.0
    return float(fitted.scales[0] / spin_noise(problem.recording, problem.flights))


def _doubt(misfit: float) -> str:
    return (
        f"The residuals are {misfit:.1f} times the scatter from sample to sample, so something besides a "
        "free tumble and noise is in them: air drag (try angular_drag), a contact, a wrong unit or frame, "
        "or a poor start. Neither the value nor its error bar can be trusted."
    )


def _problem(recording: Recording, flights: Flights, drag: bool, progress: Callable[[str], None]) -> Problem:
    spin = recording.angular_velocity
    residual = TrajectoryResidual(
        substeps=substeps_for(recording, flights),
        use_spin=spin is not None,
        use_attitude=recording.orientation is not None,
        drag=drag,
    )
    return Problem(
        recording, flights, _differentiated(recording) if spin is None else spin, residual, progress
    )


def _differentiated(recording: Recording) -> np.ndarray:
    """Mean angular velocity (N, 3) [rad/s] of the interval after each sample, from the attitudes."""
    attitude = np.asarray(recording.orientation)
    turn = np.asarray((Quaternion(attitude[:-1]).inverse() @ Quaternion(attitude[1:])).log())
    spin = turn / np.diff(recording.time)[:, None]
    spin = np.concatenate([spin, spin[-1:]])
    ends = recording.starts[1:] - 1
    spin[ends] = spin[ends - 1]
    return spin


def _free_fall(recording: Recording, flights: Flights) -> FreeFall | None:
    tosses = {flight.toss for flight in flights.flights}
    return fit_free_fall(recording, flights) if recording.position is not None and len(tosses) > 1 else None


def _open_directions(problem: Problem, fitted: Fitted) -> Directions:
    """The directions that the data do not determine."""
    problem.progress("checking that each direction is really seen")
    # Where a sphere explains the data as well, it is the honest place to look from: the fit may have bent the
    # inertia to suit the noise, and there noise poses as a wobble.
    shared = np.asarray(fitted.solution.shared)
    sphere = held(problem, fitted, np.concatenate([np.zeros(RATIO_COORDINATES), shared[RATIO_COORDINATES:]]))
    if float(sphere.cost) - float(fitted.solution.cost) < 2.0 * _real(fitted):
        return _open_at(problem, fitted, sphere)
    return _open_at(problem, fitted, fitted.solution)


def _open_at(problem: Problem, fitted: Fitted, solution: Solution) -> Directions:
    found = directions(information(solution.normal, fitted.weight), np.asarray(solution.shared))
    unknown = found.deviation > UNKNOWN
    rises = profile_rises(problem, fitted, solution, found.move, np.where(unknown, np.inf, found.deviation))
    unknown |= np.array([rise < min(_real(fitted), 0.3 * foretold) for rise, foretold in rises])
    return Directions(*(part[unknown] for part in found))


def _real(fitted: Fitted) -> float:
    return _REAL + _REAL_A_FLIGHT * float(np.sqrt(fitted.weight.sum()))


def _refusal(problem: Problem, open_: Directions) -> str:
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


def _nuisance(problem: Problem, fitted: Fitted, fall: FreeFall | None, misfit: float) -> Nuisance:
    flights = problem.flights.flights
    shared = np.asarray(fitted.solution.shared)
    rejected = dict(problem.flights.rejected)
    misfits = int(np.sum(fitted.weight == 0))
    if misfits:
        rejected["residuals 4 times the usual"] = misfits
    used = fitted.weight > 0
    return Nuisance(
        source=problem.recording.source,
        free_fall=fall,
        spin_noise=float(fitted.scales[0]) if problem.residual.use_spin else None,
        attitude_noise=float(fitted.scales[1]) if problem.residual.use_attitude else None,
        residual_ratio=misfit if problem.residual.use_spin else None,
        angular_drag=float(shared[RATIO_COORDINATES]) if problem.residual.drag else None,
        flights_used=int(used.sum()),
        samples_used=int(sum(len(flight) for flight, use in zip(flights, used) if use)),
        rejected=rejected,
        declared_flights=problem.flights.declared,
        integration_error=fitted.integration_error,
        stages=tuple(fitted.stages),
    )
