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

The stacked layout of some public data sets has `length` and `rate_hz` (samples a second) in place of `time`.
"""

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxrb.errors import InvalidInput, LimitExceeded
from jaxrb.io.columns import WIDTHS
from jaxrb.io.npz import read_arrays, write_whole
from jaxrb.io.recording import Recording
from jaxrb.io.recording_csv import csv_text, read_csv

SCHEMA = 1
_EXTRA = {"toss_id", "length", "metadata", "jaxrb_recording", "rate_hz"}


def read_recording(
    file: str | Path,
    *,
    angular_velocity_unit: Literal["rad/s", "deg/s"] | None = None,
    angular_velocity_frame: Literal["body", "world"] | None = None,
    length_unit: Literal["m", "cm", "mm"] | None = None,
    max_bytes: int = 2**31,
) -> Recording:
    """Read a recording from an NPZ or CSV file (layouts: this module and `jaxrb.io.recording_csv`).

    Args:
        file: its name ends in .npz or .csv.
        angular_velocity_unit, angular_velocity_frame, length_unit: what a file that does not say so itself
            holds. Our own NPZ layout and the units in a CSV header leave nothing to declare.
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
    declared = {
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
    known = {"time", *WIDTHS, *_EXTRA}
    unknown = sorted(set(arrays) - known)
    if unknown:
        raise InvalidInput(
            f"{path}: field {unknown[0]!r} is not known ({len(unknown)} such). Known are "
            f"{', '.join(sorted(known))}; rename it, or leave it away."
        )
    metadata: dict[str, Any] = {}
    if "jaxrb_recording" in arrays:
        version = arrays["jaxrb_recording"]
        if version.ndim or version.dtype.kind not in "iu" or not 1 <= version <= SCHEMA:
            raise InvalidInput(
                f"{path}: field 'jaxrb_recording' (schema version) is {version}; this jaxrb reads 1 to "
                f"{SCHEMA}. Update jaxrb."
            )
        if declared:
            raise InvalidInput(f"{path}: our own layout is in SI units; leave {', '.join(declared)} away.")
        try:
            metadata = json.loads(str(arrays["metadata"])) if "metadata" in arrays else {}
        except json.JSONDecodeError as error:
            raise InvalidInput(f"{path}: field 'metadata' is not JSON ({error}).") from None
    elif "toss_id" in arrays:
        metadata = {"toss_id": np.asarray(arrays["toss_id"]).tolist()}
    if "time" not in arrays:
        arrays = {**arrays, "time": _time_at_rate(path, arrays)}
    fields = {name: arrays[name] for name in ("time", *WIDTHS, "length") if name in arrays}
    return Recording(**fields, **declared, metadata=metadata, source=str(path))


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
