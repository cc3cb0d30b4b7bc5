"""Free flights in a recording: where nothing but gravity acts on the centre of mass.

In free flight the centre of mass accelerates evenly, straight down, and the angular velocity changes
smoothly. Both are looked for; every stretch that is left out is counted with its reason. A recording without
positions is cut by its accelerometer; without both, each toss is taken as one flight, as the one who recorded it says.
"""

import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.fit.flights import STANDARD_GRAVITY, Flight, Flights, counted, runs, smooth_spin, split
from jaxrb.fit.weightless import weightless
from jaxrb.io.recording import Recording

# A window counts as falling freely when its acceleration lies in this ball about gravity (relative); wide
# enough for a wrong metre or a strong drag, narrow enough to leave out resting, rolling and sliding.
_BALL = 0.35
# Windows are widened until the scatter of their accelerations is at most this part of gravity: flights stand
# out then.
_SCATTER = 0.1
_SIGMAS = 4.0


def find_flights(
    recording: Recording, *, gravity: float = STANDARD_GRAVITY, minimum_samples: int = 7, trim: int = 1
) -> Flights:
    """Cut a recording into free flights.

    Args:
        recording: with `position` (world frame, z up), or `specific_force` and angular velocity, if it is to be cut.
        gravity: expected free-fall acceleration [m/s²]; values 35 % off are still found.
        minimum_samples: shorter flights are left out (and counted).
        trim: samples left away at either end, since the smoothing of a tracker smears each contact over them.

    Raises:
        InvalidInput: if no flight is found, with the accelerations seen.
    """
    if (
        recording.position is None
        and recording.specific_force is not None
        and recording.angular_velocity is not None
    ):
        return weightless(recording, gravity, minimum_samples)
    if recording.position is None:
        bounds = zip(recording.starts[:-1], recording.starts[1:])
        flights = tuple(Flight(toss, int(a), int(b)) for toss, (a, b) in enumerate(bounds))
        kept = tuple(flight for flight in flights if len(flight) >= 3)
        return Flights(kept, counted({"shorter than 3 samples": len(flights) - len(kept)}), cut_by="declared")
    middle, scatter, windows, half = _falling(recording, gravity)
    smooth = smooth_spin(recording)
    flights, rejected = (
        [],
        {"too short": 0, "jump of angular velocity": 0, "position is no parabola of free fall": 0},
    )
    for toss, (centres, acceleration) in enumerate(windows):
        free = np.all(np.abs(acceleration - middle) < _SIGMAS * scatter, axis=1)
        for first, last in runs(free):
            start, stop = int(centres[first]) - half + trim, int(centres[last]) + half + 1 - trim
            pieces = split(start, stop, smooth)
            rejected["jump of angular velocity"] += len(pieces) - 1
            for a, b in pieces:
                if b - a < minimum_samples:
                    rejected["too short"] += b - a >= 3  # fewer are passing values, not flights
                else:
                    flights.append(Flight(toss, a, b))
    kept = _parabolas(recording, flights)
    rejected["position is no parabola of free fall"] = len(flights) - len(kept)
    if not kept:
        raise InvalidInput(
            f"{recording.source}: field 'position' shows no free flight of {minimum_samples} samples near "
            f"{gravity} m/s². Check length_unit and that z is up, or lower minimum_samples."
        )
    return Flights(tuple(kept), counted(rejected), float(scatter))


def _falling(recording: Recording, gravity: float):
    """The usual acceleration (3,) of falling windows, its scatter, all windows, and their half-width."""
    down = np.array([0.0, 0.0, -gravity])
    middle, scatter, windows, half = down, np.inf, [], 1
    while half <= 64:
        windows = [_window_accelerations(recording, toss, half) for toss in range(recording.tosses)]
        everything = np.concatenate([acceleration for _, acceleration in windows])
        near = everything[np.linalg.norm(everything - down, axis=1) < _BALL * gravity]
        if len(near) < 2:
            half *= 2
            continue
        for _ in range(3):
            # Sideways the mean must vanish; the sideways scatter is free of what contacts do to the height.
            middle = np.array([0.0, 0.0, np.median(near[:, 2])])
            scatter = 1.4826 * np.sqrt(np.mean(np.median(np.abs(near[:, :2]), axis=0) ** 2))
            scatter = max(float(scatter), 1e-6 * gravity)
            inside = near[np.all(np.abs(near - middle) < _SIGMAS * scatter, axis=1)]
            near = inside if len(inside) else near
        if scatter < _SCATTER * gravity:
            return middle, scatter, windows, half
        half *= 2
    raise InvalidInput(
        f"{recording.source}: field 'position' shows no free fall near {gravity} m/s² (z up). Check "
        "length_unit, that z is up, and that the noise of the positions lets an acceleration be seen."
    )


def _window_accelerations(recording: Recording, toss: int, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices (W,) of window centres and the accelerations (W, 3) of parabolas through 2·half + 1 samples."""
    a, b = recording.starts[toss], recording.starts[toss + 1]
    width = 2 * half + 1
    if b - a < width:
        return np.zeros(0, int), np.zeros((0, 3))
    assert recording.position is not None
    time = np.lib.stride_tricks.sliding_window_view(recording.time[a:b], width)
    place = np.lib.stride_tricks.sliding_window_view(recording.position[a:b], width, axis=0)
    time = time - time.mean(axis=1, keepdims=True)
    scale = np.abs(time).max(axis=1)[:, None]
    unit = time / scale  # a well conditioned basis 1, t, t²
    basis = np.stack([np.ones_like(unit), unit, unit * unit], axis=-1)
    coefficients = np.linalg.pinv(basis) @ np.swapaxes(place, 1, 2)
    return np.arange(a + half, b - half), 2.0 * coefficients[:, 2] / scale**2


def _parabolas(recording: Recording, flights: list[Flight]) -> list[Flight]:
    """Flights that scatter about their own parabola as usual, and whose parabola bends as the others' do."""
    if not flights:
        return []
    fits = [parabola(recording, flight) for flight in flights]
    scatter = np.array([np.sqrt(np.mean(residual**2)) for _, residual in fits])
    bend = np.array([coefficients[2] for coefficients, _ in fits])
    # The error of a parabola's bend goes with the duration to the power −5/2: a body that tips over an edge
    # falls nearly freely for long enough to pass every window, and shows here.
    duration = np.array([np.ptp(recording.time[flight.start : flight.stop]) for flight in flights])
    deviation = np.abs(bend - np.median(bend, axis=0)) * duration[:, None] ** 2.5
    usual = 1.4826 * np.median(deviation, axis=0)
    good = (scatter <= 4.0 * np.median(scatter) + 1e-9) & np.all(deviation <= 6.0 * usual + 1e-9, axis=1)
    return [flight for flight, keep in zip(flights, good) if keep]


def parabola(recording: Recording, flight: Flight) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (3, 3) of 1, t, ½ t² (t from the flight's middle) and residuals (K, 3) [m]."""
    assert recording.position is not None
    time = recording.time[flight.start : flight.stop]
    time = time - time.mean()
    place = recording.position[flight.start : flight.stop]
    basis = np.stack([np.ones_like(time), time, 0.5 * time**2], axis=-1)
    coefficients = np.linalg.lstsq(basis, place, rcond=None)[0]
    return coefficients, place - basis @ coefficients
