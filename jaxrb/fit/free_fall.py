"""The free-fall acceleration that a recording shows, with an error bar over its tosses.

Beside the known value it is a check of the recording itself: it fails when the metre, the clock or the
tracking does.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.fit.segments import STANDARD_GRAVITY, Flights
from jaxrb.io.recording import Recording

_HUBER = 2.5  # standard deviations beyond which a toss's pull on the mean stops growing


@dataclass(frozen=True)
class FreeFall:
    """Acceleration (3,) [m/s²] in the world frame with its standard error (3,), clustered over the tosses."""

    acceleration: np.ndarray
    standard_error: np.ndarray
    flights: int
    tosses: int

    @property
    def magnitude(self) -> float:
        """Size of the acceleration [m/s²]."""
        return float(np.linalg.norm(self.acceleration))

    @property
    def magnitude_error(self) -> float:
        """Standard error of `magnitude` [m/s²]."""
        return float(np.linalg.norm(self.standard_error * self.acceleration) / self.magnitude)

    def sentence(self, expected: float = STANDARD_GRAVITY) -> str:
        """What was found beside what is expected, and what a difference means."""
        found, error = self.magnitude, self.magnitude_error
        text = f"free fall {found:.3f} ± {error:.3f} m/s² (expected {expected:g})"
        if abs(found - expected) <= 3.0 * error:
            return f"{text}: agrees"
        ratio = found / expected
        return (
            f"{text}: {100 * (ratio - 1):+.1f} %. A metre read as {ratio:.3f} m would do that (and leave "
            f"the inertia ratios as they are), or a clock that shows {100 * (ratio**-0.5 - 1):+.1f} %, "
            "or air drag"
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for JSON."""
        return {
            "acceleration_m_s2": self.acceleration.tolist(),
            "standard_error_m_s2": self.standard_error.tolist(),
            "magnitude_m_s2": self.magnitude,
            "magnitude_error_m_s2": self.magnitude_error,
            "expected_m_s2": STANDARD_GRAVITY,
            "flights": self.flights,
            "tosses": self.tosses,
        }


def fit_free_fall(recording: Recording, flights: Flights) -> FreeFall:
    """Least squares for one acceleration shared by all flights; Huber over the tosses.

    The error is the sandwich over tosses, so it holds whatever the noise within a toss looks like.

    Raises:
        InvalidInput: without positions, or with fewer than two tosses in flight.
    """
    if recording.position is None:
        raise InvalidInput(
            f"{recording.source}: field 'position' is missing; free fall cannot be measured without."
        )
    push, weight = _by_toss(recording, flights)
    tosses = len(weight)
    if tosses < 2:
        raise InvalidInput(
            f"{recording.source}: {tosses} toss(es) in free flight; an error bar needs at least two."
        )
    trust = np.ones_like(push)
    for _ in range(30):
        mean = np.sum(trust * push, axis=0) / np.sum(trust * weight[:, None], axis=0)
        # A toss's own mean scatters with 1/√weight.
        deviation = (push - weight[:, None] * mean) / np.sqrt(weight)[:, None]
        scale = 1.4826 * np.median(np.abs(deviation), axis=0)
        size = np.abs(deviation) / np.where(scale > 0, scale, 1.0)
        trust = np.where(size > _HUBER, _HUBER / np.where(size > 0, size, 1.0), 1.0)
    score = trust * (push - weight[:, None] * mean)
    bread = np.sum(trust * weight[:, None], axis=0)
    error = np.sqrt(np.sum(score**2, axis=0) * tosses / (tosses - 1)) / bread
    return FreeFall(mean, error, len(flights), tosses)


def _by_toss(recording: Recording, flights: Flights) -> tuple[np.ndarray, np.ndarray]:
    """Sums over each toss of q·position (T, 3) and q·q (T,); q is ½ t² made orthogonal to 1 and t."""
    assert recording.position is not None
    sums: dict[int, list] = {}
    for flight in flights.flights:
        time = recording.time[flight.start : flight.stop]
        time = time - time.mean()
        line, _ = np.linalg.qr(np.stack([np.ones_like(time), time], axis=-1))
        curve = 0.5 * time**2
        curve = curve - line @ (line.T @ curve)
        total = sums.setdefault(flight.toss, [np.zeros(3), 0.0])
        total[0] = total[0] + curve @ recording.position[flight.start : flight.stop]
        total[1] = total[1] + curve @ curve
    return np.array([push for push, _ in sums.values()]), np.array([weight for _, weight in sums.values()])
