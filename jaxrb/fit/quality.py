"""What readings and residuals say of themselves: full scale, ends that are not free, correlation. Host side."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.compilation import jit
from jaxrb.fit.flights import Flight, Flights
from jaxrb.fit.stages import Fitted, Problem
from jaxrb.io.recording import Recording

_AT_FULL_SCALE = 3  # samples in a row that show the largest number of all, to the last digit
_ENDS = 6  # samples at either end of a flight that may be trimmed
_SURE = 4.0  # standard deviations of a mean square by which an end must exceed the inside


def saturated(recording: Recording) -> np.ndarray:
    """(N,) True where a component of the angular velocity stands at its largest reading: it was larger, unseen."""
    spin = recording.angular_velocity
    found = np.zeros(len(recording.time), bool)
    if spin is None:
        return found
    for component in np.abs(spin).T:
        top = component >= component.max() * (1.0 - 1e-9)
        if component.max() == 0.0 or np.mean(top) > 0.5:  # at rest, or a spin that does not change
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], top.astype(int), [0]]))).reshape(-1, 2)
        for a, b in edges:
            found[a:b] |= b - a >= _AT_FULL_SCALE
    return found


@jit
def _channels(residual, shared, local, data):
    return jax.vmap(jax.vmap(lambda phi, d: jnp.stack(residual.channels(shared, phi, d))))(local, data)


def scaled_residuals(problem: Problem, fitted: Fitted) -> np.ndarray:
    """Residuals (channels, S, K, 3) in standard deviations, NaN where nothing was compared."""
    with jax.enable_x64(True):
        solution = fitted.solution
        parts = np.asarray(_channels(problem.residual, solution.shared, solution.local, fitted.data))
    missing = np.where(np.asarray(fitted.data.present)[:, 0, :, None] > 0, 0.0, np.nan)
    return np.moveaxis(parts[:, 0], 1, 0) + missing


def correlation_time(problem: Problem, fitted: Fitted) -> float:
    """Samples that tell as much as one would if noise were white: 1 + 2 Σ ρ, summed while ρ is above 0.05."""
    left = scaled_residuals(problem, fitted)[:, fitted.weight > 0]
    total, variance = 1.0, np.nanmean(left**2)
    if not variance > 0:
        return 1.0
    for lag in range(1, left.shape[2] // 2):
        both = left[:, :, lag:] * left[:, :, :-lag]
        if not np.isfinite(both).any() or (rho := np.nanmean(both) / variance) < 0.05:
            break
        total += 2.0 * float(rho)
    return total


def not_free_ends(problem: Problem, fitted: Fitted) -> tuple[int, int]:
    """Samples at the start and at the end of flights that scatter more than those inside.

    A tracker's smoothing smears a contact over its neighbours, and a hand lets go over some samples.
    """
    left = scaled_residuals(problem, fitted)[:, fitted.weight > 0]
    lengths = [len(f) for f, use in zip(problem.flights.flights, fitted.weight > 0) if use]
    most = min(_ENDS, min(lengths) // 4)
    inside = [left[:, k, most : n - most] for k, n in enumerate(lengths)]
    usual = np.nanmean(np.concatenate([part.ravel() for part in inside]) ** 2)
    found = []
    for at in (lambda n, d: d, lambda n, d: n - 1 - d):
        trim = 0
        for depth in range(most):
            values = np.stack([left[:, k, at(n, depth)] for k, n in enumerate(lengths)], axis=1)
            square, count = np.nanmean(values**2), np.sum(np.isfinite(values))
            # The fit bends to an end, so what is left there understates it; a gap ends the search.
            if not square > usual * (1.0 + _SURE * np.sqrt(2.0 / max(count, 1))):
                break
            trim = depth + 1
        found.append(trim)
    return found[0], found[1]


def trimmed(flights: Flights, ends: tuple[int, int], minimum_samples: int) -> Flights:
    """Flights without so many samples at the start and at the end; those that become too short are left out."""
    shorter = [Flight(f.toss, f.start + ends[0], f.stop - ends[1]) for f in flights.flights]
    kept = tuple(flight for flight in shorter if len(flight) >= max(minimum_samples, 3))
    rejected = dict(flights.rejected)
    if short := len(shorter) - len(kept):
        rejected["too short"] = rejected.get("too short", 0) + short
    rejected["samples at the ends of flights"] = rejected.get("samples at the ends of flights", 0) + sum(
        ends
    ) * len(kept)
    return dataclasses.replace(flights, flights=kept, rejected=rejected)
