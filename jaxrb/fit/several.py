"""What is done to recordings before a fit: several become one, spins differentiated, a scale guessed. Host side."""

from collections.abc import Sequence

import jax
import numpy as np

from jaxrb.errors import InvalidInput, NotIdentifiable
from jaxrb.fit.segments import Flights
from jaxrb.io.columns import WIDTHS
from jaxrb.io.recording import Recording
from jaxrb.math import Quaternion

_TURN = 2.0  # [rad] over which a gyroscope is integrated for the first guess


def as_one(recordings: Recording | Sequence[Recording]) -> Recording:
    """Recordings of one body with the tosses of all; each may have its own sample rate and its own wheel speed.

    Raises:
        InvalidInput: if there are none, or one lacks a quantity that another has.
    """
    if isinstance(recordings, Recording):
        return recordings
    parts = list(recordings)
    if not parts:
        raise InvalidInput("fit_inertia: the sequence of recordings is empty; give at least one.")
    first = parts[0]
    for part in parts[1:]:
        here, there = set(first.columns()), set(part.columns())
        if here != there:
            name = sorted(here ^ there)[0]
            has, lacks = (first, part) if name in here else (part, first)
            raise InvalidInput(
                f"{lacks.source}: field '{name}' is missing, which {has.source} has. Recordings fitted together "
                "need the same quantities (a wheel at rest has internal_momentum 0)."
            )
    if len(parts) == 1:
        return first
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in WIDTHS
        if name in first.columns()
    }
    one = Recording(
        np.concatenate([part.time for part in parts]),
        **columns,  # pyright: ignore[reportArgumentType]
        length=np.concatenate([part.length for part in parts]),
        source=f"{len(parts)} recordings, {first.source} first",
    )
    for part in parts:
        for reason, count in part.left_out.items():
            one.left_out[reason] = one.left_out.get(reason, 0) + count
    return one


def differentiated(recording: Recording) -> np.ndarray:
    """Mean angular velocity (N, 3) [rad/s] of the interval after each sample, from the attitudes."""
    attitude = np.asarray(recording.orientation)
    turn = np.asarray((Quaternion(attitude[:-1]).inverse() @ Quaternion(attitude[1:])).log())
    spin = turn / np.diff(recording.time)[:, None]
    spin = np.concatenate([spin, spin[-1:]])
    ends = recording.starts[1:] - 1
    spin[ends] = spin[ends - 1]
    return spin


def guessed_trace(recording: Recording, flights: Flights, spin: np.ndarray) -> float:
    """First guess of tr(I) [kg m²] of a body with a wheel inside: I ω + h stays what it is in the world.

    That is linear in I where the gyroscope is integrated over short stretches. Noise in ω draws the guess down; the
    fit on trajectories has no such bias.

    Raises:
        NotIdentifiable: if the wheel does not turn, or nothing shows its torque.
    """
    wheel = recording.internal_momentum
    assert wheel is not None
    if not np.any(wheel):
        raise NotIdentifiable(
            f"{recording.source}: internal_momentum is zero throughout, and a wheel at rest gives no scale; leave it "
            "away, or record tosses with the wheel turning."
        )
    rows, right = [], []
    for flight in flights.flights:
        time, rate = recording.time[flight.start : flight.stop], spin[flight.start : flight.stop]
        momentum = wheel[flight.start : flight.stop]
        turned = np.concatenate([[0.0], np.cumsum(np.linalg.norm(rate[1:], axis=1) * np.diff(time))])
        for piece in range(int(turned[-1] / _TURN) + 1):
            at = np.flatnonzero((turned >= piece * _TURN) & (turned < (piece + 1) * _TURN))
            if len(at) < 4:
                continue
            attitude = _integrated(time[at], rate[at])
            by_inertia = attitude @ by_components(rate[at])
            known = np.einsum("kij,kj->ki", attitude, momentum[at])
            rows.append((by_inertia - by_inertia.mean(0)).reshape(-1, 6))
            right.append(-(known - known.mean(0)).ravel())
    six = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0] if rows else np.zeros(6)
    trace = float(six[:3].sum())
    largest = float(np.max(np.linalg.norm(wheel, axis=1)) / np.sqrt(np.mean(spin**2)))
    # The wheel's torque is lost below a thousandth of the body's own, and then this is only an order of magnitude.
    return trace if np.isfinite(trace) and trace > 1e-3 * largest else largest


def _integrated(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Attitudes (K, 3, 3) relative to the first sample."""
    half = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)[:, None]
    with jax.enable_x64(True):
        turns = np.asarray(Quaternion.exp(half).as_matrix())
    attitude = [np.eye(3)]
    for turn in turns:
        attitude.append(attitude[-1] @ turn)
    return np.stack(attitude)


def by_components(rate: np.ndarray) -> np.ndarray:
    """(K, 3, 6): I ω as a linear function of xx, yy, zz, xy, xz, yz."""
    x, y, z = rate.T
    o = np.zeros_like(x)
    return np.stack([[x, o, o, y, z, o], [o, y, o, x, o, z], [o, o, z, o, x, y]]).transpose(2, 0, 1)
