"""From flights to padded arrays: each flight whole, or as a chain of short windows. Host side, float64."""

import numpy as np

from jaxrb.fit.residuals import FlightData
from jaxrb.fit.segments import Flight, Flights
from jaxrb.io.recording import Recording


def pack(
    recording: Recording,
    flights: tuple[Flight, ...],
    spin: np.ndarray,
    scales: np.ndarray,
    count: int | None = None,
    *,
    longest: int | None = None,
    unit: float = 1.0,
    force: bool = False,
    masked: np.ndarray | None = None,
) -> tuple[FlightData, np.ndarray]:
    """Padded arrays (S, W, K, …) of the flights, and (S, W) 1 where a window goes on into the next.

    Args:
        recording: of the flights. spin: (N, 3) [rad/s] measured or differentiated. scales: (3,) of the channels.
        count: intervals in a window; None leaves each flight in one.
        longest: intervals to pad to; by default those of the longest flight.
        unit: [kg m²] the first guess of tr(I), in which a wheel's momentum is counted.
        force: whether the specific force is compared.
        masked: (N,) True for samples that are simulated and not compared.
    """
    longest = max(longest or 0, max(len(flight) for flight in flights) - 1)
    count = longest if count is None else min(count, longest)
    windows = -(-longest // count)
    sample = np.arange(windows)[:, None] * count + np.arange(count + 1)  # (W, K) within a flight
    start = np.array([flight.start for flight in flights])[:, None, None]
    last = np.array([flight.stop - flight.start - 1 for flight in flights])[:, None, None]
    index = start + np.minimum(sample, last)
    # A window's first sample is the last of the one before and was compared there.
    present = (sample <= last) & ((sample % count > 0) | (sample == 0) | (np.arange(count + 1) == count))
    if masked is not None:
        present &= ~masked[index]
    joined = (sample[:, -1] < last[..., 0]).astype(float)
    interval = np.diff(recording.time[index], axis=-1, prepend=recording.time[index[..., :1]])
    attitude, wheel = recording.orientation, recording.internal_momentum
    if attitude is None:
        attitude = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (len(recording.time), 1))
    data = FlightData(
        interval=interval,
        angular_velocity=spin[index],
        orientation=attitude[index],
        specific_force=recording.specific_force[index]
        if force and recording.specific_force is not None
        else None,
        internal_momentum=None if wheel is None else wheel[index] / unit,
        present=present.astype(float),
        scales=np.broadcast_to(np.asarray(scales, float), (*index.shape[:2], 3)).copy(),
    )
    return data, joined


def rounded(number: int) -> int:
    """The next of 2, 3, 4, 6, 8, 12, 16, …

    Flights are padded to such lengths: each new length is a new program of some seconds, and a recording of a hundred
    single throws would have nearly as many. Padding costs a fifth of the work, which takes milliseconds.
    """
    power = 2
    while True:
        for size in (power, power * 3 // 2):
            if number <= size:
                return size
        power *= 2


def turn_per_sample(recording: Recording, flights: Flights, quantile: float = 0.5) -> float:
    """Rotation [rad] from one sample to the next, at that quantile over all flights."""
    return float(np.quantile(_turns(recording, flights), quantile))


def _turns(recording: Recording, flights: Flights) -> np.ndarray:
    parts = []
    for flight in flights.flights:
        span = np.diff(recording.time[flight.start : flight.stop])
        if recording.angular_velocity is not None:
            spin = np.linalg.norm(recording.angular_velocity[flight.start : flight.stop], axis=1)
            parts.append(span * 0.5 * (spin[1:] + spin[:-1]))
        else:
            assert recording.orientation is not None
            q = recording.orientation[flight.start : flight.stop]
            # |q₁ − q₀| = 2 sin(θ/4) for the turn θ between two unit quaternions.
            half = np.minimum(0.5 * np.linalg.norm(q[1:] - q[:-1], axis=1), 1.0)
            parts.append(4.0 * np.arcsin(half))
    return np.concatenate(parts)


def spin_noise(recording: Recording, flights: Flights) -> float:
    """First guess of the noise [rad/s] of the angular velocity, from second differences; 1 if there is none.

    A fast tumble adds its own bend, so this guess is at most too large; the fit corrects it.
    """
    spin = recording.angular_velocity
    if spin is None:
        return 1.0
    bends = [
        spin[f.start + 2 : f.stop] - 2 * spin[f.start + 1 : f.stop - 1] + spin[f.start : f.stop - 2]
        for f in flights.flights
    ]
    size = np.sqrt(np.mean(np.concatenate([spin[f.start : f.stop] for f in flights.flights]) ** 2))
    # The second difference of white noise has √6 times its standard deviation.
    return max(
        1.4826 * float(np.median(np.abs(np.concatenate(bends)))) / np.sqrt(6.0), 1e-6 * float(size), 1e-12
    )
