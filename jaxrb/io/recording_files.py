"""Reading and writing recordings: NPZ (our own layout and a stacked one without time) and CSV.

Our NPZ layout, schema 1, SI units and jaxrb's frames throughout:

    jaxrb_recording     (), whole number: the schema's version, 1
    time                (N,) [s]
    angular_velocity    (N, 3) [rad/s], body frame        } any of these four,
    orientation         (N, 4) wxyz, body to world        } at least one
    position, velocity  (N, 3) [m], [m/s], world frame    }
    specific_force      (N, 3) [m/s²], body frame, of an accelerometer
    internal_momentum   (N, 3) [kg m²/s], body frame, of a wheel, relative to the body
    length              (T,) whole numbers: samples of each toss
    metadata            (), text: a JSON object

The stacked layout of some public data sets has `length` and `rate_hz` (samples a second) in place of `time`. Other
layouts may call their arrays `t`, `gyro`, `gyro_dps`, `acc_g`, … (`jaxrb.io.recording_names`); `toss` (N,) may number
each sample's toss in place of `length`; internal_momentum may be (3,) or (T, 3) where it does not change.
"""

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxrb.errors import InvalidInput, JaxrbWarning, LimitExceeded
from jaxrb.io.columns import WIDTHS
from jaxrb.io.npz import read_arrays, write_whole
from jaxrb.io.recording import Recording
from jaxrb.io.recording_csv import csv_text, lengths_of, read_csv
from jaxrb.io.recording_names import field

SCHEMA = 1
_EXTRA = {"toss_id", "length", "metadata", "jaxrb_recording", "rate_hz"}


def read_recording(
    file: str | Path,
    *,
    time_unit: str | None = None,
    angular_velocity_unit: str | None = None,
    angular_velocity_frame: Literal["body", "world"] | None = None,
    length_unit: str | None = None,
    specific_force_unit: str | None = None,
    internal_momentum: Sequence[float] | None = None,
    internal_momentum_unit: str | None = None,
    gaps: Literal["refuse", "leave out"] = "refuse",
    max_bytes: int = 2**31,
) -> Recording:
    """Read a recording from an NPZ or CSV file (layouts: this module and `jaxrb.io.recording_csv`).

    Args:
        file: its name ends in .npz or .csv.
        time_unit, angular_velocity_unit, angular_velocity_frame, length_unit, specific_force_unit,
            internal_momentum_unit: what a file that does not say so itself holds, as of `Recording`. Our own NPZ layout
            and the units in a CSV header leave nothing to declare.
        internal_momentum: (3,) [kg m²/s, or its unit] of a wheel at constant speed, which the file does not hold.
        gaps: "leave out" samples with missing values, repeated or out of order, and count them.
        max_bytes: refuse files that would unpack to more.

    Raises:
        InvalidInput: naming the file and the field, if it is missing, cut, not what its name says, or holds
            values that `Recording` refuses. LimitExceeded: if it is larger than `max_bytes`.
    """
    path = Path(file)
    if not path.is_file():
        raise InvalidInput(
            f"{path}: no such file (or not a file). Give the path of an .npz or .csv recording."
        )
    declared: dict[str, Any] = {
        "time_unit": time_unit,
        "specific_force_unit": specific_force_unit,
        "internal_momentum": internal_momentum,
        "internal_momentum_unit": internal_momentum_unit,
        "gaps": None if gaps == "refuse" else gaps,
        "angular_velocity_unit": angular_velocity_unit,
        "angular_velocity_frame": angular_velocity_frame,
        "length_unit": length_unit,
    }
    declared = {name: value for name, value in declared.items() if value is not None}
    suffix = path.suffix.lower()
    if suffix == ".csv":
        if path.stat().st_size > max_bytes:
            raise LimitExceeded(f"{path}: {path.stat().st_size} bytes are more than max_bytes={max_bytes}.")
        return read_csv(path, declared)
    if suffix == ".npz":
        return _from_arrays(path, read_arrays(path, max_bytes), declared)
    raise InvalidInput(f"{path}: recordings are read from .npz or .csv, not {suffix!r}.")


def write_recording(recording: Recording, file: str | Path) -> Path:
    """Write to `file` (.npz in our own layout, or .csv), whole or not at all.

    An older file of that name survives a failure.

    Raises:
        InvalidInput: for another ending, or metadata that JSON cannot hold. JaxrbError: where the operating
            system refuses, with its reason.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix not in (".npz", ".csv"):
        raise InvalidInput(f"{path}: recordings are written to .npz or .csv, not {suffix!r}.")
    try:
        metadata = json.dumps(recording.metadata, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{recording.source}: field 'metadata' is not JSON ({error}).") from None

    def write(stream: Any) -> None:
        if suffix == ".csv":
            stream.write(csv_text(recording, metadata).encode())
            return
        arrays: dict[str, Any] = {"jaxrb_recording": SCHEMA, "length": recording.length, "metadata": metadata}
        np.savez_compressed(stream, **(arrays | recording.columns()))  # pyright: ignore[reportArgumentType]

    write_whole(path, write)
    return path


def _from_arrays(path: Path, arrays: dict[str, np.ndarray], declared: dict[str, Any]) -> Recording:
    ours = "jaxrb_recording" in arrays
    if not ours:
        arrays, units = _known(path, arrays)
        declared = {**units, **declared}
    metadata: dict[str, Any] = {}
    if "jaxrb_recording" in arrays:
        version = arrays["jaxrb_recording"]
        if version.ndim or version.dtype.kind not in "iu" or not 1 <= version <= SCHEMA:
            raise InvalidInput(
                f"{path}: field 'jaxrb_recording' (schema version) is {version}; this jaxrb reads 1 to "
                f"{SCHEMA}. Update jaxrb."
            )
        units = [name for name in declared if name.endswith(("_unit", "_frame"))]
        if units:
            raise InvalidInput(f"{path}: our own layout is in SI units; leave {', '.join(units)} away.")
        if unknown := sorted(set(arrays) - {"time", *WIDTHS, *_EXTRA}):
            raise InvalidInput(
                f"{path}: field {unknown[0]!r} is not known ({len(unknown)} such); leave it away."
            )
        try:
            metadata = json.loads(str(arrays["metadata"])) if "metadata" in arrays else {}
        except json.JSONDecodeError as error:
            raise InvalidInput(f"{path}: field 'metadata' is not JSON ({error}).") from None
    elif "toss_id" in arrays:
        metadata = {"toss_id": np.asarray(arrays["toss_id"]).tolist()}
    if "time" not in arrays:
        arrays = {**arrays, "time": _time_at_rate(path, arrays)}
    fields = {name: arrays[name] for name in ("time", *WIDTHS, "length") if name in arrays}
    if "toss" in arrays and "length" not in arrays:
        fields["length"] = lengths_of(str(path), np.asarray(arrays["toss"]).ravel())
    return Recording(**{**fields, **declared}, metadata=metadata, source=str(path))


_UNIT_OF = {
    "time": "time_unit", "angular_velocity": "angular_velocity_unit", "position": "length_unit",
    "velocity": "length_unit", "specific_force": "specific_force_unit", "internal_momentum": "internal_momentum_unit",
}  # fmt: skip


def _known(path: Path, arrays: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Arrays by our names, and the units that their names hold; others are left aside with a warning."""
    known, units, aside = {}, {}, []
    for key, array in arrays.items():
        name, unit = (key, None) if key in {"time", *WIDTHS, *_EXTRA} else field(key) or (None, None)
        if name is None:
            aside.append(key)
            continue
        if name in known:
            raise InvalidInput(f"{path}: two fields hold {name}, one of them {key!r}; leave one away.")
        known[name] = array
        if unit is not None and name in _UNIT_OF:
            units[_UNIT_OF[name]] = unit
    if aside and len(aside) == len(arrays) - ("time" in known):
        raise InvalidInput(
            f"{path}: field {aside[0]!r} is not known ({len(aside)} such). Known are "
            f"{', '.join(sorted({'time', *WIDTHS, *_EXTRA}))}; rename it, or leave it away."
        )
    if aside:
        warnings.warn(
            f"{path}: fields {', '.join(map(repr, aside[:6]))} are not known and are left aside.",
            JaxrbWarning,
            stacklevel=4,
        )
    return known, units


def _time_at_rate(path: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    missing = [name for name in ("rate_hz", "length") if name not in arrays]
    if missing:
        raise InvalidInput(
            f"{path}: neither field 'time' nor 'rate_hz' with 'length' is there "
            f"(missing: {', '.join(missing)})."
        )
    rate, lengths = arrays["rate_hz"], arrays["length"]
    if rate.ndim or rate.dtype.kind not in "iuf" or not (np.isfinite(rate) and rate > 0):
        raise InvalidInput(f"{path}: field 'rate_hz' is {rate}; it must be one positive number [1/s].")
    if lengths.ndim != 1 or lengths.dtype.kind not in "iu" or np.any(lengths < 2):
        raise InvalidInput(
            f"{path}: field 'length' must hold whole numbers of at least 2, one for each toss."
        )
    samples = max((len(arrays[name]) for name in WIDTHS if name in arrays and arrays[name].ndim), default=0)
    if lengths.sum() != samples:
        raise InvalidInput(
            f"{path}: field 'length' adds up to {lengths.sum()} samples, but the arrays have {samples}. "
            "Is it cut?"
        )
    with np.errstate(over="ignore"):  # times without end are refused as what they are
        return np.concatenate([np.arange(int(n)) / float(rate) for n in lengths])
