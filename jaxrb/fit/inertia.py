"""A recording becomes an inertia, with error bars and a word on what cannot be known."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import jax
import numpy as np

from jaxrb.errors import InvalidInput, JaxrbWarning, NotIdentifiable, RunFailed
from jaxrb.fit.free_fall import FreeFall, fit_free_fall
from jaxrb.fit.metre import METRIC_SCALE, Metre, metric_scale
from jaxrb.fit.parametrise import ratios_from_coordinates
from jaxrb.fit.passes import DOUBTFUL, MISFIT, free_flights_fitted, misfit_of
from jaxrb.fit.refusal import RatiosNotIdentifiable, check_names, check_required, open_directions, refusal
from jaxrb.fit.report import InertiaFit, Nuisance, inertia_fit
from jaxrb.fit.residuals import RATIO_COORDINATES, UNKNOWNS
from jaxrb.fit.segments import STANDARD_GRAVITY, Flights, find_flights
from jaxrb.fit.selection import Tried, values
from jaxrb.fit.several import as_one
from jaxrb.fit.stages import Fitted, Problem
from jaxrb.fit.uncertainty import fitted_information, model_covariance
from jaxrb.fit.wishes import Wishes, wishes_of
from jaxrb.io.recording import Recording


def fit_inertia(
    recording: Recording | Sequence[Recording],
    *,
    trace: float | None = None,
    angular_drag: bool = False,
    nuisances: Sequence[str] | Literal["auto"] = "auto",
    centre_of_mass: bool = False,
    required: Sequence[str] = (),
    huber: float | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
    gravity: float = STANDARD_GRAVITY,
    minimum_samples: int = 7,
    start: np.ndarray | None = None,
    max_iterations: int = 200,
    progress: Callable[[str], None] | None = None,
) -> InertiaFit:
    """Inertia of a tumbling body from its free flights, by least squares on whole trajectories.

    Torque-free motion fixes the inertia only up to its scale, so the result has trace 1 unless `trace` gives
    the scale from elsewhere, or the recording has the momentum of a wheel that turns in the body; mass is never seen.
    Everything is computed in float64, also where JAX's default is float32 (inside a local `jax.enable_x64(True)`; no
    global setting is touched).

    Args:
        recording: one or several of one body, with angular velocity, orientation or both. Free flights are cut out of
            it by positions, else by an accelerometer; without both, each toss is taken as one free flight, or, where
            that does not fit, its longest stretch without torque.
        trace: tr(I) [kg m²], if known.
        angular_drag: also fit a torque −c tr(I) ω; the same as "linear_drag" among the nuisances. Left out where there
            is drag, it biases the smallest moment.
        nuisances: names of `jaxrb.fit.UNKNOWNS` to be fitted too, or "auto": all that such a recording could show, each
            with a belief about its size (`jaxrb.fit.wishes.BELIEFS`, or yours by `prior`), and told for each whether
            the recording calls for it (Bayesian information criterion).
        centre_of_mass: also fit the lever arm from the centre of mass to the accelerometer, from its specific force.
        required: any of "scale", "mass", "centre of mass"; what the recording cannot give raises.
        huber: standard deviations beyond which a sample's pull stops growing, such as 2.5; None is least squares.
        prior: mean and standard deviation of nuisances by name, in their units; of "scale", tr(I) [kg m²].
        gravity: expected free-fall acceleration [m/s²], to find flights and the metric scale by; the default is known
            to what it differs by on Earth, any other is taken as exact.
        minimum_samples: shorter flights are left out.
        start: (3, 3) inertia of any scale to start from; by default a sphere.
        max_iterations: of each least-squares problem.
        progress: called with a line of text now and then.

    Raises:
        InvalidInput: for a recording without rotation or without flights, or a bad option.
        NotIdentifiable: if the motion leaves the ratios open, such as a spin about one principal axis, or cannot give
            what is `required`; the message names the open directions and `null_vectors` holds them.
    """
    recording = as_one(recording)
    if recording.angular_velocity is None and recording.orientation is None:
        raise InvalidInput(
            f"{recording.source}: neither angular_velocity nor orientation; the inertia leaves no trace."
        )
    wishes = wishes_of(
        recording, trace, angular_drag, nuisances, centre_of_mass, huber, prior, max_iterations
    )
    check_names(required)
    flights = find_flights(recording, gravity=gravity, minimum_samples=minimum_samples)
    if not len(flights):
        raise InvalidInput(f"{recording.source}: no toss has the 3 samples that a flight needs.")
    with jax.enable_x64(True):
        problem, fitted, tried, correlation = free_flights_fitted(
            recording, flights, wishes, start, progress or (lambda line: None), max(minimum_samples, 3)
        )
        flights = problem.flights
        misfit = misfit_of(problem, fitted)
        _refuse(problem, fitted, misfit)
        if misfit > MISFIT:
            warnings.warn(f"{recording.source}: {_doubt(misfit)}", JaxrbWarning, stacklevel=2)
        shared = np.asarray(fitted.solution.shared)
        ratios = np.asarray(ratios_from_coordinates(shared[:RATIO_COORDINATES]))
        scale_seen = trace is not None or "scale" in wishes.always
        check_required(required, ratios, scale_seen, centre_of_mass, recording.source)
        info = fitted_information(problem, fitted.solution, fitted.weight)
        fall = _free_fall(recording, flights)
        metre = _metre(fall, wishes, nuisances == "auto", gravity, recording.source)
        shown = [*tried, metre.tried] if metre is not None and nuisances == "auto" else tried
        nuisance = _nuisance(
            problem, fitted, fall, misfit, shown, model_covariance(info), wishes.prior, metre
        )
        toss = np.array([flight.toss for flight in flights.flights])
        return inertia_fit(problem, fitted, ratios, info, toss, nuisance, trace, correlation)


def _refuse(problem: Problem, fitted: Fitted, misfit: float) -> None:
    """Raise where the motion leaves the inertia open."""
    source = problem.recording.source
    open_ = open_directions(problem, fitted)
    if len(open_.deviation):
        if misfit > MISFIT:
            raise RunFailed(f"{source}: no free tumble was found that fits. {_doubt(misfit)}")
        doubt = f" {_doubt(misfit)}" if misfit > DOUBTFUL else ""
        raise RatiosNotIdentifiable(refusal(problem, open_) + doubt, open_.rows)
    if "scale" in problem.residual.unknowns:
        found = model_covariance(fitted_information(problem, fitted.solution, fitted.weight))
        error = float(
            np.sqrt(found[problem.residual.place("scale")][0, problem.residual.place("scale").start])
        )
        if not 0.0 < error < 1.0:
            raise NotIdentifiable(
                f"{source}: the wheel's torque is lost in the noise (relative error of the scale {error:.2g}). "
                "Turn the wheel faster, or leave internal_momentum away and fit the ratios alone."
            )


def _doubt(misfit: float) -> str:
    return (
        f"The residuals are {misfit:.1f} times the scatter from sample to sample, so something besides a "
        'free tumble and noise is in them: air drag or an instrument\'s errors (try nuisances="auto"), a contact, a '
        "wrong unit or frame, or a poor start. Neither the value nor its error bar can be trusted."
    )


def _metre(fall: FreeFall | None, wishes: Wishes, auto: bool, gravity: float, source: str) -> Metre | None:
    """The metric scale where it is wanted; left out where nobody asked by name and the free fall is not there."""
    if not wishes.metre or (auto and fall is None):
        return None
    return metric_scale(fall, gravity, wishes.prior.get(METRIC_SCALE), source)


def _free_fall(recording: Recording, flights: Flights) -> FreeFall | None:
    tosses = {flight.toss for flight in flights.flights}
    return fit_free_fall(recording, flights) if recording.position is not None and len(tosses) > 1 else None


def _nuisance(
    problem: Problem,
    fitted: Fitted,
    fall: FreeFall | None,
    misfit: float,
    tried: list[Tried],
    covariance: np.ndarray,
    believed: Mapping[str, tuple[float, float]],
    metre: Metre | None,
) -> Nuisance:
    flights = problem.flights.flights
    rejected = {**problem.recording.left_out, **problem.flights.rejected}
    misfits = int(np.sum(fitted.weight == 0))
    if misfits:
        rejected["residuals 4 times the usual"] = misfits
    used = fitted.weight > 0
    found = {name: pair for name, pair in values(problem, fitted, covariance).items() if name != "scale"}
    if metre is not None:
        found[METRIC_SCALE] = (np.array([metre.value]), np.array([metre.error]))
    drag, scales = found.get("linear_drag"), fitted.scales
    return Nuisance(
        source=problem.recording.source,
        free_fall=fall,
        spin_noise=float(scales[0]) if problem.residual.use_spin else None,
        attitude_noise=float(scales[1]) if problem.residual.use_attitude else None,
        force_noise=float(scales[2]) if problem.residual.use_force else None,
        residual_ratio=misfit if problem.residual.use_spin else None,
        angular_drag=None if drag is None else float(drag[0][0]),
        values={name: (*pair, UNKNOWNS[name][1]) for name, pair in found.items()},
        tried=tuple(tried),
        flights_used=int(used.sum()),
        samples_used=int(sum(len(flight) for flight, use in zip(flights, used) if use)),
        rejected=rejected,
        cut_by=problem.flights.cut_by,
        integration_error=fitted.integration_error,
        stages=tuple(fitted.stages),
        believed=dict(believed),
    )
