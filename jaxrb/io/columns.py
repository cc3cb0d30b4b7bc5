"""The checks that every recorded column passes before anything is computed from it. Host side, float64."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxrb.errors import InvalidInput, JaxrbWarning

WIDTHS = {
    "angular_velocity": 3,
    "orientation": 4,
    "position": 3,
    "velocity": 3,
    "specific_force": 3,
    "internal_momentum": 3,
}
ANGLE_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0, "dps": np.pi / 180.0, "rpm": np.pi / 30.0}
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
FORCE_UNITS = {
    "m/s²": 1.0,
    "m/s^2": 1.0,
    "m/s2": 1.0,
    "g": 9.80665,
}  # standard gravity, as instruments count it
MOMENTUM_UNITS = {"kg m²/s": 1.0, "kg m^2/s": 1.0, "N m s": 1.0, "Nms": 1.0, "g m²/s": 1e-3}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}

# Quaternions of a text file with six decimals are off by 1e-6; beyond that the repair is announced,
# and beyond 1e-3 the four numbers are more likely something else.
_NORM_SILENT, _NORM_REFUSED = 1e-5, 1e-3

Columns = Sequence[Any] | np.ndarray


def factor(table: Mapping[str, float], unit: str, name: str, source: str) -> float:
    """SI units in one `unit`."""
    if unit not in table:
        raise InvalidInput(
            f"{source}: {name} is {unit!r}, which is not known; give one of {', '.join(table)}."
        )
    return table[unit]


def stacked(
    given: Mapping[str, Any], length: Columns | None, source: str, gaps: bool = False
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Checked float64 arrays over all samples, and the number of samples of each toss; with `gaps` they may be NaN."""
    if isinstance(given["time"], (list, tuple)) and len(given["time"]) and np.ndim(given["time"][0]) > 0:
        if length is not None:
            raise InvalidInput(f"{source}: time is a list with one array a toss, so leave 'length' away.")
        counts = {name: [len(toss) for toss in tosses] for name, tosses in given.items()}
        for name, count in counts.items():
            if count != counts["time"]:
                raise InvalidInput(
                    f"{source}: field '{name}' has tosses of {count} samples, 'time' of {counts['time']}."
                )
        parts = {
            name: [_numbers(toss, name, source, gaps) for toss in tosses if len(toss)]
            for name, tosses in given.items()
        }
        arrays = {name: np.concatenate(p) if p else np.zeros(0) for name, p in parts.items()}
        lengths = np.asarray(counts["time"])
    else:
        arrays = {name: _numbers(value, name, source, gaps) for name, value in given.items()}
        lengths = _lengths(length, arrays["time"].size, source)
    for name, array in arrays.items():
        expected = (int(lengths.sum()), *((WIDTHS[name],) if name in WIDTHS else ()))
        if array.shape != expected:
            raise InvalidInput(f"{source}: field '{name}' has shape {array.shape}, expected {expected}.")
    if lengths.size == 0 or np.any(lengths < 2):
        short = np.flatnonzero(lengths < 2)
        which = f"toss {short[0]} has {lengths[short[0]]} sample(s)" if short.size else "there is no toss"
        raise InvalidInput(f"{source}: {which}; every toss needs at least 2. Leave shorter ones away.")
    return arrays, lengths


def _lengths(length: Columns | None, samples: int, source: str) -> np.ndarray:
    lengths = np.asarray([samples] if length is None else length)
    if lengths.ndim != 1 or not np.issubdtype(lengths.dtype, np.integer):
        raise InvalidInput(f"{source}: field 'length' must be a list of whole numbers, one for each toss.")
    if lengths.sum() != samples:
        raise InvalidInput(
            f"{source}: field 'length' adds up to {lengths.sum()} samples, but 'time' has {samples}. "
            "Is the file cut?"
        )
    return lengths.astype(np.int64)


def _numbers(value: Any, name: str, source: str, gaps: bool) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{source}: field '{name}' is not an array of numbers ({error}).") from None
    bad = np.argwhere(~np.isfinite(array))
    if bad.size and not gaps:
        place = tuple(int(i) for i in bad[0])
        raise InvalidInput(
            f"{source}: field '{name}' is {array[place]} at index {place} ({len(bad)} such values). "
            "Cut the recording there, leave that toss away, or give gaps='leave out'."
        )
    return array


def check_time(time: np.ndarray, lengths: np.ndarray, source: str) -> None:
    """Refuse time that stands still or runs backwards within a toss."""
    step = np.diff(time)
    inside = np.ones(step.size, bool)
    inside[np.cumsum(lengths)[:-1] - 1] = False
    bad = np.flatnonzero(inside & (step <= 0))
    if bad.size:
        k = int(bad[0])
        toss = int(np.searchsorted(np.cumsum(lengths), k, side="right"))
        raise InvalidInput(
            f"{source}: field 'time' goes from {time[k]} to {time[k + 1]} at sample {k + 1} (toss {toss}), "
            "but must increase. Leave repeated samples out (gaps='leave out'), or give 'length' if a toss begins there."
        )


def unit_and_continuous(wxyz: np.ndarray, lengths: np.ndarray, source: str) -> np.ndarray:
    """Unit quaternions whose sign does not jump within a toss (q and −q are the same rotation)."""
    with np.errstate(over="ignore"):  # an infinite length is refused like any other that is not one
        size = np.linalg.norm(wxyz, axis=1)
    off = np.abs(size - 1.0)
    worst = int(np.argmax(off))
    if off[worst] > _NORM_REFUSED:
        raise InvalidInput(
            f"{source}: field 'orientation' is {wxyz[worst].tolist()} at sample {worst}, of length "
            f"{size[worst]:.6g} instead of 1. Is it wxyz, scalar first?"
        )
    if off[worst] > _NORM_SILENT:
        warnings.warn(
            f"{source}: {int(np.sum(off > _NORM_SILENT))} quaternions are not of length one (off by up to "
            f"{off[worst]:.1e}); normalised.",
            JaxrbWarning,
            stacklevel=4,
        )
    wxyz = wxyz / size[:, None]
    flip = np.where(np.sum(wxyz[1:] * wxyz[:-1], axis=1) < 0, -1.0, 1.0)
    flip[np.cumsum(lengths)[:-1] - 1] = 1.0
    return wxyz * np.concatenate([[1.0], np.cumprod(flip)])[:, None]
