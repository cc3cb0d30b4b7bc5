"""Stretches of a recording in free flight, and what every way of finding them shares. Host side."""

from dataclasses import dataclass, field

import numpy as np

from jaxrb.io.recording import Recording

STANDARD_GRAVITY = 9.81  # [m/s²], to the two digits that hold anywhere on Earth's surface
_SIGMAS_SPIN = 8.0  # of second differences of ω, whose noise has heavy tails in camera data


@dataclass(frozen=True)
class Flight:
    """Samples `start` to `stop` (exclusive) of the stacked arrays, all of one toss and in free flight."""

    toss: int
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True)
class Flights:
    """The free flights of a recording.

    `rejected` counts the stretches left out by reason; `acceleration_scatter` [m/s²] is the noise of one
    window's acceleration. `cut_by` is "position" or "accelerometer", or "declared" where there was neither, so every
    toss is taken as one flight.
    """

    flights: tuple[Flight, ...]
    rejected: dict[str, int] = field(default_factory=dict)
    acceleration_scatter: float | None = None
    cut_by: str = "position"

    def __len__(self) -> int:
        return len(self.flights)


def smooth_spin(recording: Recording) -> np.ndarray:
    """(N,) False where the angular velocity bends far more sharply than it usually does."""
    smooth = np.ones(len(recording.time), bool)
    spin = recording.angular_velocity
    if spin is None:
        return smooth
    bend = np.zeros(len(spin))
    for a, b in zip(recording.starts[:-1], recording.starts[1:]):
        if b - a > 2:
            bend[a + 1 : b - 1] = np.linalg.norm(
                spin[a + 2 : b] - 2 * spin[a + 1 : b - 1] + spin[a : b - 2], axis=1
            )
    scale = np.median(bend)
    return bend <= _SIGMAS_SPIN * scale if scale > 0 else smooth


def runs(free: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def split(start: int, stop: int, smooth: np.ndarray) -> list[tuple[int, int]]:
    """The stretches of start…stop between sharp bends; a bend at sample k spoils k alone."""
    return [(start + a, start + b + 1) for a, b in runs(smooth[start:stop])] or [(start, start)]


def counted(rejected: dict[str, int]) -> dict[str, int]:
    return {reason: count for reason, count in rejected.items() if count}
