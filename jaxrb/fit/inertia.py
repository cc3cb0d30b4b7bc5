"""A recording becomes an inertia, with error bars and a word on what cannot be known."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.errors import InvalidInput, JaxrbWarning, NotIdentifiable, RunFailed
from jaxrb.fit.free_fall import FreeFall, fit_free_fall
from jaxrb.fit.packing import spin_noise
from jaxrb.fit.parametrise import coordinates_from_ratios, ratios_from_coordinates
from jaxrb.fit.problem import Prior
from jaxrb.fit.refusal import RatiosNotIdentifiable, check_names, check_required, open_directions, refusal
from jaxrb.fit.report import InertiaFit, Nuisance, inertia_fit
from jaxrb.fit.residuals import RATIO_COORDINATES, UNKNOWNS, TrajectoryResidual
from jaxrb.fit.segments import STANDARD_GRAVITY, Flights, find_flights
from jaxrb.fit.selection import Tried, candidates, choose, start_of, values
from jaxrb.fit.several import as_one, differentiated, guessed_trace
from jaxrb.fit.stages import Fitted, Problem, search, substeps_for
from jaxrb.fit.uncertainty import fitted_information, model_covariance
from jaxrb.io.recording import Recording

# Residuals this many times the scatter from sample to sample are more than noise; a tracker's smoothing alone
# makes it 3.
_MISFIT = 6.0
_DOUBTFUL = 1.5  # where it goes with a refusal: what is not in the model may be why


@dataclass(frozen=True)
class _Wishes:
    """The options of `fit_inertia` that shape the problem."""

    trace: float | None
    always: tuple[str, ...]
    among: tuple[str, ...]
    force: bool
    huber: float
    prior: Mapping[str, tuple[float, float]]
    max_iterations: int


def fit_inertia(
    recording: Recording | Sequence[Recording],
    *,
    trace: float | None = None,
    angular_drag: bool = False,
    nuisances: Sequence[str] | Literal["auto"] = (),
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
            it by positions, else by an accelerometer; without both, each toss is taken as one free flight.
        trace: tr(I) [kg m²], if known.
        angular_drag: also fit a torque −c tr(I) ω; the same as "linear_drag" among the nuisances. Left out where there
            is drag, it biases the smallest moment.
        nuisances: names of `jaxrb.fit.UNKNOWNS` to be fitted too, or "auto": those that the recording calls for, each
            by its likelihood ratio (Bayesian information criterion).
        centre_of_mass: also fit the lever arm from the centre of mass to the accelerometer, from its specific force.
        required: any of "scale", "mass", "centre of mass"; what the recording cannot give raises.
        huber: standard deviations beyond which a sample's pull stops growing, such as 2.5; None is least squares.
        prior: mean and standard deviation of nuisances by name, in their units; of "scale", tr(I) [kg m²].
        gravity: expected free-fall acceleration [m/s²], to find flights by.
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
    wishes = _wishes(recording, trace, angular_drag, nuisances, centre_of_mass, huber, prior, max_iterations)
    check_names(required)
    flights = find_flights(recording, gravity=gravity, minimum_samples=minimum_samples)
    if not len(flights):
        raise InvalidInput(f"{recording.source}: no toss has the 3 samples that a flight needs.")
    with jax.enable_x64(True):
        problem = _problem(recording, flights, wishes, progress or (lambda line: None))
        starts, always = _starts(problem, start), wishes.always
        fitted = search(problem, starts)
        if "linear_drag" in wishes.among and _misfit(problem, fitted) > _MISFIT:
            # Where drag bends the track far enough, the search without it ends nowhere near.
            with_drag = problem.with_free((*always, "linear_drag"))
            other = search(with_drag, starts)
            if other.scales[0] < fitted.scales[0]:
                problem, fitted, always = with_drag, other, (*always, "linear_drag")
        problem, fitted, tried = choose(problem, fitted, always, wishes.among)
        misfit = _misfit(problem, fitted)
        _refuse(problem, fitted, misfit)
        if misfit > _MISFIT:
            warnings.warn(f"{recording.source}: {_doubt(misfit)}", JaxrbWarning, stacklevel=2)
        shared = np.asarray(fitted.solution.shared)
        ratios = np.asarray(ratios_from_coordinates(shared[:RATIO_COORDINATES]))
        scale_seen = trace is not None or "scale" in wishes.always
        check_required(required, ratios, scale_seen, centre_of_mass, recording.source)
        info = fitted_information(problem, fitted.solution, fitted.weight)
        nuisance = _nuisance(
            problem, fitted, _free_fall(recording, flights), misfit, tried, model_covariance(info)
        )
        toss = np.array([flight.toss for flight in flights.flights])
        return inertia_fit(problem, fitted, ratios, info, toss, nuisance, trace)


def _wishes(recording, trace, drag, nuisances, centre, huber, prior, max_iterations) -> _Wishes:
    """Options, checked."""
    if trace is not None and not (np.isfinite(trace) and trace > 0):
        raise InvalidInput(f"fit_inertia: trace is {trace}, but must be a positive number [kg m²].")
    if huber is not None and not huber > 0:
        raise InvalidInput(f"fit_inertia: huber is {huber}, but must be positive [standard deviations].")
    if centre and recording.specific_force is None:
        raise NotIdentifiable(
            f"{recording.source}: the centre of mass was asked for, and rotation does not depend on it; record an "
            "accelerometer (specific_force)."
        )
    able = candidates(recording.angular_velocity is not None, recording.orientation is not None)
    named = () if nuisances == "auto" else tuple(nuisances)
    for name in (*named, *(prior or {})):
        if name != "scale" and name not in able:
            raise InvalidInput(
                f"fit_inertia: nuisance {name!r} is not known or leaves no trace in {recording.source}; there "
                f"{', '.join(able)} can be fitted."
            )
    always = dict.fromkeys([*(("linear_drag",) if drag else ()), *named])
    if recording.internal_momentum is not None and trace is None:
        always["scale"] = None
    if centre:
        always |= dict.fromkeys(("lever_arm", "accelerometer_bias"))
    among = tuple(name for name in able if name not in always) if nuisances == "auto" else ()
    return _Wishes(
        trace, tuple(always), among, centre, np.inf if huber is None else huber, prior or {}, max_iterations
    )


def _problem(recording: Recording, flights: Flights, wishes: _Wishes, progress) -> Problem:
    measured = recording.angular_velocity
    residual = TrajectoryResidual(
        substeps=substeps_for(recording, flights),
        use_spin=measured is not None,
        use_attitude=recording.orientation is not None,
        use_force=wishes.force,
        unknowns=(*wishes.always, *wishes.among),
    )
    spin = differentiated(recording) if measured is None else measured
    unit = 1.0 if wishes.trace is None else wishes.trace
    if "scale" in wishes.always:
        unit = guessed_trace(recording, flights, spin)
    problem = Problem(
        recording, flights, spin, residual, np.ones(residual.shared_size), progress, unit, wishes.huber,
        _prior(residual, wishes.prior, unit), wishes.max_iterations,
    )  # fmt: skip
    return problem.with_free(wishes.always)


def _prior(
    residual: TrajectoryResidual, beliefs: Mapping[str, tuple[float, float]], unit: float
) -> Prior | None:
    if not beliefs:
        return None
    mean, precision = np.zeros(residual.shared_size), np.zeros(residual.shared_size)
    for name, (value, deviation) in beliefs.items():
        if not (np.isfinite(value) and deviation > 0) or (name == "scale" and not value > 0):
            raise InvalidInput(
                f"fit_inertia: prior of {name!r} is ({value}, {deviation}); give mean and deviation > 0."
            )
        if name not in residual.unknowns:
            raise InvalidInput(f"fit_inertia: prior of {name!r}, which is not fitted; add it to nuisances.")
        if name == "scale":  # its coordinate is a logarithm
            value, deviation = np.log(value / unit), deviation / value
        mean[residual.place(name)], precision[residual.place(name)] = value, deviation**-2.0
    return Prior(jnp.asarray(mean), jnp.diag(jnp.asarray(precision)))


def _starts(problem: Problem, start: np.ndarray | None) -> list[np.ndarray]:
    """Coordinates to begin from: the caller's, a sphere, and three discs."""
    # A disc's moments obey A + B = C; this one has a little thickness.
    discs = [np.eye(3) + 0.9 * np.diag(row) for row in np.eye(3)]
    inertias = [*([] if start is None else [np.asarray(start, float)]), np.eye(3), *discs]
    return [start_of(problem, np.asarray(coordinates_from_ratios(i))) for i in inertias]


def _refuse(problem: Problem, fitted: Fitted, misfit: float) -> None:
    """Raise where the motion leaves the inertia open."""
    source = problem.recording.source
    open_ = open_directions(problem, fitted)
    if len(open_.deviation):
        if misfit > _MISFIT:
            raise RunFailed(f"{source}: no free tumble was found that fits. {_doubt(misfit)}")
        doubt = f" {_doubt(misfit)}" if misfit > _DOUBTFUL else ""
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


def _misfit(problem: Problem, fitted: Fitted) -> float:
    """Residuals of the angular velocity over what they scatter by from one sample to the next."""
    if not problem.residual.use_spin:
        return 0.0
    return float(fitted.scales[0] / spin_noise(problem.recording, problem.flights))


def _doubt(misfit: float) -> str:
    return (
        f"The residuals are {misfit:.1f} times the scatter from sample to sample, so something besides a "
        'free tumble and noise is in them: air drag or an instrument\'s errors (try nuisances="auto"), a contact, a '
        "wrong unit or frame, or a poor start. Neither the value nor its error bar can be trusted."
    )


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
) -> Nuisance:
    flights = problem.flights.flights
    rejected = dict(problem.flights.rejected)
    misfits = int(np.sum(fitted.weight == 0))
    if misfits:
        rejected["residuals 4 times the usual"] = misfits
    used = fitted.weight > 0
    found = {name: pair for name, pair in values(problem, fitted, covariance).items() if name != "scale"}
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
    )
