"""What `fit_inertia` was asked for, checked, and the problem that follows from it. Host side."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.errors import InvalidInput, NotIdentifiable
from jaxrb.fit.metre import METRIC_SCALE
from jaxrb.fit.problem import Prior
from jaxrb.fit.residuals import TrajectoryResidual
from jaxrb.fit.segments import Flights
from jaxrb.fit.selection import candidates
from jaxrb.fit.several import differentiated, guessed_trace
from jaxrb.fit.stages import Problem, substeps_for
from jaxrb.io.recording import Recording

# What is believed of a nuisance that nobody asked for by name: mean and standard deviation, as instruments and bodies
# that are thrown have them. One throw with a wheel hardly tells a bias from a momentum: without a bound on it, biases
# of 0.8 rad/s were chosen, and moments came out 12 % wrong.
BELIEFS = {
    "linear_drag": (0.0, 0.05),
    "quadratic_drag": (0.0, 0.005),
    "gyro_bias": (0.0, 0.05),
    "gyro_scale": (0.0, 0.01),
    "tilt": (0.0, 0.05),
    "delay": (0.0, 0.005),
    METRIC_SCALE: (0.0, 0.05),
}


@dataclass(frozen=True)
class Wishes:
    """The options of `fit_inertia` that shape the problem."""

    trace: float | None
    always: tuple[str, ...]
    among: tuple[str, ...]
    force: bool
    huber: float
    prior: Mapping[str, tuple[float, float]]
    max_iterations: int
    metre: bool = False  # whether the metric scale is wanted; it is found beside the rotations


def wishes_of(recording, trace, drag, nuisances, centre, huber, prior, max_iterations) -> Wishes:
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
    able = candidates(
        recording.angular_velocity is not None,
        recording.orientation is not None,
        _shows_metre(recording, nuisances),
    )
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
    prior = {**{name: BELIEFS[name] for name in among}, **(prior or {})}
    wanted = METRIC_SCALE in (*always, *among)
    always, among = (tuple(name for name in names if name != METRIC_SCALE) for names in (always, among))
    bound = np.inf if huber is None else huber
    return Wishes(trace, always, among, centre, bound, prior, max_iterations, wanted)


def _shows_metre(recording: Recording, nuisances: Any) -> bool:
    """Whether to look for an error of the metre: by itself only where tosses enough can show it."""
    return recording.position is not None and (nuisances != "auto" or recording.tosses > 1)


def problem_of(
    recording: Recording, flights: Flights, wishes: Wishes, progress, masked: np.ndarray
) -> Problem:
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
        _prior(residual, wishes.prior, unit), wishes.max_iterations, masked,
    )  # fmt: skip
    return problem.with_free(wishes.always)


def _prior(
    residual: TrajectoryResidual, beliefs: Mapping[str, tuple[float, float]], unit: float
) -> Prior | None:
    if not beliefs:
        return None
    mean, precision = np.zeros(residual.shared_size), np.zeros(residual.shared_size)
    for name, (value, deviation) in beliefs.items():
        if name == METRIC_SCALE and np.isfinite(value) and deviation > 0:
            continue  # weighed where it is found
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
