"""From flights to padded arrays: whole flights, or short windows of them. Host side, float64."""

import numpy as np

from jaxrb.fit.residuals import FlightData
from jaxrb.fit.segments import Flight, Flights
from jaxrb.io.recording import Recording

Pieces = tuple[Flight, ...]


def whole(flights: Flights) -> Pieces:
    """Each flight in one piece."""
    return flights.flights


def windows(flights: Flights, count: int) -> Pieces:
    """Cut flights into pieces of `count` intervals; the last takes what is left, up to one and a half pieces.

    A piece ends with the sample that the next begins with, so no interval between two samples is lost.
    """
    pieces = []
    for flight in flights.flights:
        start = flight.start
        while flight.stop - start > 1.5 * count + 1:
            pieces.append(Flight(flight.toss, start, start + count + 1))
            start += count
        pieces.append(Flight(flight.toss, start, flight.stop))
    return tuple(pieces)


def pack(recording: Recording, pieces: Pieces, spin: np.ndarray, scales: tuple[float, float]) -> FlightData:
    """Padded arrays (S, K, …) of the pieces. `spin` (N, 3) [rad/s] is the measured or differentiated one."""
    index = padded_index(pieces)
    present = np.arange(index.shape[1])[None] < np.array([len(piece) for piece in pieces])[:, None]
    interval = np.diff(recording.time[index], axis=1, prepend=recording.time[index[:, :1]])
    attitude = recording.orientation
    if attitude is None:
        attitude = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (len(recording.time), 1))
    count = len(pieces)
    return FlightData(
        interval=interval,
        angular_velocity=spin[index],
        orientation=attitude[index],
        present=present.astype(float),
        spin_scale=np.full(count, scales[0]),
        attitude_scale=np.full(count, scales[1]),
    )


def padded_index(pieces: Pieces) -> np.ndarray:
    """(S, K) sample numbers; a shorter piece repeats its last one."""
    longest = max(len(piece) for piece in pieces)
    return np.stack([np.minimum(piece.start + np.arange(longest), piece.stop - 1) for piece in pieces])


def turn_per_sample(recording: Recording, flights: Flights, quantile: float = 0.5) -> float:
    """Rotation [rad] from one sample to the next, at that quantile over all flights."""
    return float(np.quantile(_turns(recording, flights), quantile))


def longest_turn(recording: Recording, flights: Flights) -> float:
    """Rotation [rad] over the flight that turns furthest."""
    lengths = np.array([len(flight) - 1 for flight in flights.flights])
    return float(np.max(np.add.reduceat(_turns(recording, flights), np.cumsum(lengths) - lengths)))


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
