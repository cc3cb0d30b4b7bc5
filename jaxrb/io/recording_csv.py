"""Recordings as CSV: one row a sample, units in the header, the frame of the angular velocity in a comment.

    # frame: body
    toss, time [s], wx [rad/s], wy [rad/s], wz [rad/s], qw, qx, qy, qz, px [m], …, vx [m/s], …,
    fx [m/s²], …, hx [kg m²/s], …

`toss` may be left away when there is one, and so may any whole group of columns. Lines that start with
`#` are comments; `# frame: body` or `# frame: world` says where wx, wy, wz are measured, and
`# metadata: {…}` holds JSON. Other names are understood too (`jaxrb.io.recording_names`), with units in brackets,
at the end of the name or declared; other columns are left aside with a warning. Semicolons and tabs separate as well.
fx, fy, fz are an accelerometer's specific force and hx, hy, hz a wheel's momentum relative to the body, both in the
body frame.
Units: s, ms, us, ns; rad/s, deg/s, rpm; m, cm, mm and the same a second; m/s² (or m/s^2), g; kg m²/s (or kg m^2/s),
N m s.
"""

import csv
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from jaxrb.errors import InvalidInput, JaxrbWarning
from jaxrb.io.columns import ANGLE_UNITS, FORCE_UNITS, LENGTH_UNITS, MOMENTUM_UNITS, TIME_UNITS
from jaxrb.io.recording import Recording
from jaxrb.io.recording_names import named

GROUPS = {
    "time": ("time",),
    "angular_velocity": ("wx", "wy", "wz"),
    "orientation": ("qw", "qx", "qy", "qz"),
    "position": ("px", "py", "pz"),
    "velocity": ("vx", "vy", "vz"),
    "specific_force": ("fx", "fy", "fz"),
    "internal_momentum": ("hx", "hy", "hz"),
}
UNITS = {
    "time": TIME_UNITS,
    "angular_velocity": ANGLE_UNITS,
    "orientation": {"1": 1.0, "": 1.0},
    "position": LENGTH_UNITS,
    "velocity": {f"{unit}/s": metres for unit, metres in LENGTH_UNITS.items()},
    "specific_force": FORCE_UNITS,
    "internal_momentum": MOMENTUM_UNITS,
}
_MISSING = frozenset(("", "na", "n/a", "none", "null", "-"))


def read_csv(path: Path, declared: dict[str, Any]) -> Recording:
    """The recording in a CSV file; `declared` overrides what its header says about units and frame."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (UnicodeDecodeError, OSError) as error:
        raise InvalidInput(f"{path}: not a text file ({error}).") from error
    lines = text.splitlines()
    comments = [line[1:].strip() for line in lines if line.startswith("#")]
    rows = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not rows:
        raise InvalidInput(f"{path}: no header row. It should read like: time [s], wx [rad/s], wy [rad/s], …")
    if not text.endswith("\n"):
        warnings.warn(f"{path}: the last line has no end; is the file cut?", JaxrbWarning, stacklevel=3)
    separator = max(",;\t", key=rows[0][1].count)
    head = next(csv.reader([rows[0][1]], delimiter=separator, skipinitialspace=True))
    if all(_is_number(cell) for cell in head):  # numpy.savetxt writes the header as a comment
        titles = [c for c in comments if c.count(separator) == len(head) - 1]
        if not titles:
            raise InvalidInput(
                f"{path}: no header row. It should read like: time [s], wx [rad/s], wy [rad/s], …"
            )
        head, rows = (
            next(csv.reader([titles[-1]], delimiter=separator, skipinitialspace=True)),
            [rows[0], *rows],
        )
    names, units, gyroscope = _header(path, head, declared)
    gaps = declared.get("gaps") == "leave out"
    table = _numbers(path, names, rows[1:], separator, gaps)
    fields = _fields(path, names, units, table)
    if "internal_momentum" in declared:
        fields["internal_momentum"] = declared["internal_momentum"]
        fields["internal_momentum_unit"] = declared.get("internal_momentum_unit", "kg m²/s")
    frame = (
        declared.get("angular_velocity_frame")
        or _comment(comments, "frame")
        or ("body" if gyroscope else None)
    )
    if "angular_velocity" in fields and frame is None:
        raise InvalidInput(
            f"{path}: in which frame is wx measured? Add a line '# frame: body' or '# frame: world'."
        )
    metadata = _comment(comments, "metadata")
    try:
        metadata = json.loads(metadata) if metadata else {}
    except json.JSONDecodeError as error:
        raise InvalidInput(f"{path}: comment 'metadata' is not JSON ({error}).") from None
    lengths = lengths_of(str(path), table[:, names.index("toss")]) if "toss" in names else None
    return Recording(
        **fields,
        length=lengths,
        gaps=declared.get("gaps", "refuse"),
        angular_velocity_frame=frame or "body",
        metadata=metadata,
        source=str(path),
    )


def csv_text(recording: Recording, metadata: str) -> str:
    """The text of a CSV file that `read_csv` reads back without loss."""
    columns = recording.columns()
    defaults = {"time": "s", "angular_velocity": "rad/s", "position": "m", "velocity": "m/s"}
    defaults |= {"specific_force": "m/s²", "internal_momentum": "kg m²/s"}
    header = ["toss"]
    for name in columns:
        unit = f" [{defaults[name]}]" if name in defaults else ""
        header += [f"{column}{unit}" for column in GROUPS[name]]
    toss = np.repeat(np.arange(recording.tosses), recording.length)
    table = np.column_stack(list(columns.values()))
    rows = [", ".join([str(t), *map(repr, row)]) for t, row in zip(toss.tolist(), table.tolist())]
    return "\n".join(["# frame: body", f"# metadata: {metadata}", ", ".join(header), *rows, ""])


def _comment(comments: list[str], name: str) -> str | None:
    for comment in comments:
        key, found, value = comment.partition(":")
        if found and key.strip() == name:
            return value.strip()
    return None


def _header(
    path: Path, cells: list[str], declared: dict[str, Any]
) -> tuple[list[str | None], dict[str, float], bool]:
    """Our names of the columns (None: left aside), SI units in one of each one's unit, and whether of a gyroscope."""
    said = {
        "time": declared.get("time_unit"),
        "angular_velocity": declared.get("angular_velocity_unit"),
        "position": declared.get("length_unit"),
        "velocity": f"{declared['length_unit']}/s" if "length_unit" in declared else None,
        "specific_force": declared.get("specific_force_unit"),
        "internal_momentum": declared.get("internal_momentum_unit"),
        "orientation": "",
    }
    names, units, gyroscope, aside = [], {}, False, []
    for cell in cells:
        found = named(cell)
        names.append(found.column if found else None)
        if found is None:
            aside.append(cell.strip())
            continue
        if found.column in names[:-1]:
            raise InvalidInput(f"{path}: column '{found.column}' stands there twice ({cell.strip()!r}).")
        gyroscope |= found.gyroscope
        if found.quantity == "toss":
            continue
        unit = said[found.quantity] if found.unit is None else found.unit.strip()
        allowed = UNITS[found.quantity]
        if unit not in allowed:
            raise InvalidInput(
                f"{path}: column '{cell.strip()}' has unit {unit!r}; write it as "
                f"'{found.column} [{next(iter(allowed))}]', "
                f"with one of {', '.join(u for u in allowed if u)}, or declare it."
            )
        units[found.column] = allowed[unit]
    if aside:
        some = ", ".join(map(repr, aside[:6])) + (f" and {len(aside) - 6} more" if len(aside) > 6 else "")
        warnings.warn(f"{path}: columns {some} are not known and are left aside.", JaxrbWarning, stacklevel=4)
    return names, units, gyroscope


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _numbers(
    path: Path, names: list[str | None], rows: list[tuple[int, str]], separator: str, gaps: bool
) -> np.ndarray:
    table = np.empty((len(rows), len(names)))
    for i, (number, line) in enumerate(rows):
        cells = next(csv.reader([line], delimiter=separator))
        if len(cells) != len(names):
            raise InvalidInput(
                f"{path}: line {number} has {len(cells)} columns, the header {len(names)}. "
                "Is the file cut there?"
            )
        for j, cell in enumerate(cells):
            if names[j] is None:
                continue
            try:
                table[i, j] = float(cell)
            except ValueError:
                if gaps and cell.strip().lower() in _MISSING:
                    table[i, j] = np.nan
                    continue
                raise InvalidInput(
                    f"{path}: line {number}, column '{names[j]}' is {cell.strip()!r}, not a number."
                ) from None
    return table


def _fields(
    path: Path, names: list[str | None], units: dict[str, float], table: np.ndarray
) -> dict[str, Any]:
    fields = {}
    for name, columns in GROUPS.items():
        missing = [column for column in columns if column not in names]
        if len(missing) == len(columns) and name != "time":
            continue
        if missing:
            raise InvalidInput(
                f"{path}: column '{missing[0]}' is missing; {name} needs {', '.join(columns)}."
            )
        values = np.stack([table[:, names.index(column)] * units[column] for column in columns], axis=-1)
        fields[name] = values[:, 0] if name == "time" else values
    return fields


def lengths_of(source: str, toss: np.ndarray) -> np.ndarray:
    """Samples of each toss, from a column that numbers them."""
    starts = (
        np.flatnonzero(np.concatenate([[True], toss[1:] != toss[:-1]])) if toss.size else np.zeros(0, int)
    )
    if np.unique(toss[starts]).size != starts.size:
        raise InvalidInput(
            f"{source}: column 'toss' comes back to an earlier number; keep each toss's rows together."
        )
    return np.diff(np.concatenate([starts, [toss.size]]))
