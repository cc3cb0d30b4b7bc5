"""Free flights by an accelerometer: where it shows nothing but the spin about the centre of mass. Host side.

In free flight the specific force at a lever arm r is ω̇ × r + ω × (ω × r), linear in r, whatever the throw; in a hand it
is gravity and more. The lever arm is not known beforehand: each short stretch proposes one, the one that explains most
of the turning is taken, and then fitted to the samples that fall freely, which are those that it explains, in turns.
"""

import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.fit.flights import Flight, Flights, counted, runs, smooth_spin, split
from jaxrb.io.recording import Recording

_LEFT = 0.3  # of gravity: what a free sample's specific force may be off by
_STRETCH = 0.1  # [s] of samples that propose a lever arm
_CANDIDATES = 400
_SHORTEST = 0.08  # [s]: in a hand the force passes through zero, but not for so long
_HALF = 2  # samples to either side over which ω̇ is taken
_ROUNDS = 20


def weightless(recording: Recording, gravity: float, minimum_samples: int, trim: int = 2) -> Flights:
    """Flights of a recording with angular velocity and specific force; `trim` samples are left away at either end.

    Raises:
        InvalidInput: if no stretch is in free flight.
    """
    felt, spin = recording.specific_force, recording.angular_velocity
    assert felt is not None
    assert spin is not None
    by_arm = _by_lever_arm(recording, spin)
    free = _proposed(recording, by_arm, felt, spin, gravity)
    for _ in range(_ROUNDS):
        left = np.linalg.norm(felt - by_arm @ _arm(by_arm[free], felt[free]), axis=1)
        last, free = free, left < _LEFT * gravity
        if np.array_equal(last, free) or not np.any(free):
            break
    flights, rejected = [], {"too short": 0, "jump of angular velocity": 0}
    smooth = smooth_spin(recording)
    for toss, (a, b) in enumerate(zip(recording.starts[:-1], recording.starts[1:])):
        for first, last in runs(free[a:b]):
            start, stop = a + first + trim, a + last + 1 - trim
            if stop - start < 3:
                continue
            pieces = split(int(start), int(stop), smooth)
            rejected["jump of angular velocity"] += len(pieces) - 1
            for x, y in pieces:
                if y - x < max(minimum_samples, 3) or recording.time[y - 1] - recording.time[x] < _SHORTEST:
                    rejected["too short"] += 1
                else:
                    flights.append(Flight(toss, x, y))
    if not flights:
        raise InvalidInput(
            f"{recording.source}: field 'specific_force' shows no free flight of {minimum_samples} samples and "
            f"{_SHORTEST} s; its median size is {np.median(np.linalg.norm(felt, axis=1)):.3g} m/s². Check its unit "
            "(m/s² or g), or leave it away if each toss is cut to its flight already."
        )
    return Flights(tuple(flights), counted(rejected), None, "accelerometer")


def _arm(by_arm: np.ndarray, felt: np.ndarray) -> np.ndarray:
    """Lever arm and bias (6,) by least squares."""
    # The bias counts as much as the mean residual: left free, it takes a steady hand's gravity for its own.
    bound = np.sqrt(len(felt)) * np.eye(6)[3:]
    rows = np.concatenate([by_arm.reshape(-1, 6), bound])
    return np.linalg.lstsq(rows, np.concatenate([felt.ravel(), np.zeros(3)]), rcond=1e-6)[0]


def _proposed(
    recording: Recording, by_arm: np.ndarray, felt: np.ndarray, spin: np.ndarray, gravity: float
) -> np.ndarray:
    """(N,) the samples that some stretch's lever arm explains, of the stretch that explains most of the turning.

    Beginning from samples of little force lost every flight whose accelerometer sat some centimetres off: there the
    spin alone shows more than a hand does.
    """
    step = float(np.median(np.diff(recording.time)))
    # Between tosses the clock may leap, either way.
    turn = np.linalg.norm(spin, axis=1) * np.gradient(recording.time).clip(0.0, 3.0 * step)
    width = max(4, round(_STRETCH / step))
    begins = [
        k
        for a, b in zip(recording.starts[:-1], recording.starts[1:])
        for k in range(a, max(b - width, a + 1), max(1, width // 2))
    ]
    best, most = np.zeros(len(turn), bool), -1.0
    for k in begins[:: max(1, len(begins) // _CANDIDATES)]:
        known = _arm(by_arm[k : k + width], felt[k : k + width])
        free = np.linalg.norm(felt - by_arm @ known, axis=1) < _LEFT * gravity
        if (explained := float(turn[free].sum())) > most:
            best, most = free, explained
    return best


def _by_lever_arm(recording: Recording, spin: np.ndarray) -> np.ndarray:
    """(N, 3, 6): specific force as a linear function of lever arm and bias."""
    rate = np.zeros_like(spin)
    for a, b in zip(recording.starts[:-1], recording.starts[1:]):
        half = min(_HALF, (b - a - 1) // 2)
        low = np.clip(np.arange(a, b) - half, a, b - 1)
        high = np.clip(np.arange(a, b) + half, a, b - 1)
        rate[a:b] = (spin[high] - spin[low]) / (recording.time[high] - recording.time[low])[:, None]
    hat = _star(spin)
    return np.concatenate([_star(rate) + hat @ hat, np.broadcast_to(np.eye(3), hat.shape)], axis=-1)


def _star(v: np.ndarray) -> np.ndarray:
    """(N, 3, 3) with v* b = v × b."""
    x, y, z = v.T
    o = np.zeros_like(x)
    return np.stack([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(2, 0, 1)
