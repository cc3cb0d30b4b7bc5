"""Free flights by the motion itself: the longest stretch of each toss in which some inertia needs no torque. Host side.

Where only a gyroscope was recorded, a hand before and after the flight shows as a torque. Euler's equations are linear
in the inertia, so each stretch of a quarter of a second proposes one, and the proposal by which most of the recording
turns without torque is taken (random sample consensus, Fischler and Bolles 1981, with every stretch tried).
"""

import numpy as np

from jaxrb.fit.flights import Flight, Flights, runs
from jaxrb.fit.several import by_components
from jaxrb.io.recording import Recording

_BLOCK_TURN = 0.15  # [rad] over which readings are averaged
_BLOCKS = 14  # of a stretch that proposes an inertia
_FREE = 0.04  # of tr(I) ω²: a torque below this is none
_SLOW = 0.3  # of the usual fast spin; slower than that, a hand turns a body without much torque
_CANDIDATES = 400


def torque_free(recording: Recording, minimum_samples: int) -> Flights | None:
    """Flights by the motion, or None where no inertia explains a stretch of any toss."""
    spin = recording.angular_velocity
    assert spin is not None
    size = np.linalg.norm(spin, axis=1)
    fast = np.quantile(size, 0.9)
    step = np.median(np.diff(recording.time)[np.diff(recording.time) > 0])
    width = max(2, round(_BLOCK_TURN / max(fast * step, 1e-9)))
    blocks = [
        _blocks(recording, spin, int(a), int(b), width)
        for a, b in zip(recording.starts[:-1], recording.starts[1:])
    ]
    noise = _noise(recording, spin) / np.sqrt(width) * np.sqrt(2.0) / (2.0 * width * step)
    offered = [
        (toss, k) for toss, (_, rows, _, _) in enumerate(blocks) for k in range(0, len(rows) - _BLOCKS, 3)
    ]
    offered = offered[:: max(1, len(offered) // _CANDIDATES)]
    best, most = None, 0.0
    for toss, k in offered:
        _, rows, known, _ = blocks[toss]
        six = _inertia(rows[k : k + _BLOCKS], known[k : k + _BLOCKS])
        if six is None:
            continue
        free = [_free(part, six, noise, fast) for part in blocks]
        explained = sum(
            float(np.sum(part[3][a : b + 1])) for part, mask in zip(blocks, free) for a, b in _longest(mask)
        )
        if explained > most:
            best, most = free, explained
    if best is None:
        return None
    flights = []
    for toss, (part, mask) in enumerate(zip(blocks, best)):
        for a, b in _longest(mask):
            start, stop = int(part[0][a]), int(part[0][b]) + width
            if stop - start >= max(minimum_samples, 3) and b - a >= 4:
                flights.append(Flight(toss, start, stop))
    left = recording.tosses - len(flights)
    return (
        Flights(tuple(flights), {"no stretch without torque": left} if left else {}, None, "motion")
        if flights
        else None
    )


def _blocks(recording: Recording, spin: np.ndarray, a: int, b: int, width: int):
    """First samples (J,), Euler's equations (J, 3, 6) and (J, 3) of a wheel, and |ω| (J,) of inner blocks."""
    count = (b - a) // width
    if count < 3:
        return np.zeros(0, int), np.zeros((0, 3, 6)), np.zeros((0, 3)), np.zeros(0)
    cut = slice(a, a + count * width)
    time = recording.time[cut].reshape(count, width).mean(1)
    rate = spin[cut].reshape(count, width, 3).mean(1)
    change = (rate[2:] - rate[:-2]) / (time[2:] - time[:-2])[:, None]
    middle = rate[1:-1]
    rows = by_components(change) + np.cross(middle[:, :, None], by_components(middle), axis=1)
    known = np.zeros_like(middle)
    if recording.internal_momentum is not None:
        wheel = recording.internal_momentum[cut].reshape(count, width, 3).mean(1)
        known = (wheel[2:] - wheel[:-2]) / (time[2:] - time[:-2])[:, None] + np.cross(middle, wheel[1:-1])
    return a + width * np.arange(1, count - 1), rows, known, np.linalg.norm(middle, axis=1)


def _inertia(rows: np.ndarray, known: np.ndarray) -> np.ndarray | None:
    """Inertia (6,) that a stretch proposes: xx, yy, zz, xy, xz, yz; None if no body has it."""
    matrix = rows.reshape(-1, 6)
    if np.any(known):
        six = np.linalg.lstsq(matrix, -known.ravel(), rcond=1e-8)[0]
    else:
        six = np.linalg.svd(matrix, full_matrices=False)[2][-1]
        six = six * np.sign(six[:3].sum())
    x, y, z, xy, xz, yz = six
    moments = np.linalg.eigvalsh([[x, xy, xz], [xy, y, yz], [xz, yz, z]])
    # Averages of noisy readings propose a little beside what a body can have.
    ok = moments[0] > 0 and moments[2] < 1.1 * (moments[0] + moments[1])
    return six if ok else None


def _free(part, six: np.ndarray, noise: float, fast: float) -> np.ndarray:
    _, rows, known, speed = part
    if not len(rows):
        return np.zeros(0, bool)
    torque = np.linalg.norm(rows @ six + known, axis=1) / six[:3].sum()
    return (torque < _FREE * speed**2 + 3.0 * noise) & (speed > _SLOW * fast)


def _longest(mask: np.ndarray) -> list[tuple[int, int]]:
    """First and last block of the longest run of True, bridging single exceptions; an empty list if there is none."""
    if len(mask) > 2:
        mask = mask.copy()
        mask[1:-1] |= mask[:-2] & mask[2:]
    found = runs(mask)
    return [max(found, key=lambda run: run[1] - run[0])] if found else []


def _noise(recording: Recording, spin: np.ndarray) -> float:
    inside = np.ones(len(spin) - 2, bool)
    for end in recording.starts[1:-1]:
        inside[max(end - 2, 0) : end] = False
    bend = (spin[2:] - 2 * spin[1:-1] + spin[:-2])[inside]
    return 1.4826 * float(np.median(np.abs(bend))) / np.sqrt(6.0)
