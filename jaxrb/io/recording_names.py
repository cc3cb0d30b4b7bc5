"""What instruments call their columns: names, axes and units in the header of a log. Host side.

`wx [rad/s]`, `gyro_x (deg/s)`, `gyroADC[0]`, `acc_z_g`, `"Time_ms"`: a name is a stem, an axis and perhaps a unit, in
capitals or not. A column that calls itself a gyroscope's is in the body frame, since an instrument turns with the body.
"""

import re
from typing import NamedTuple

# By quantity, its own name first.
STEMS = {
    "time": ("time", "t", "timestamp", "time_stamp", "seconds", "elapsed_time"),
    "angular_velocity": (
        "w", "omega", "angular_velocity", "angvel", "ang_vel", "angular_rate", "rate", "rotation_rate", "rotationrate",
        "g", "gyr", "gyro", "gyroscope", "gyroadc", "gyro_adc", "gyrofilt", "imu_gyro",
    ),
    "orientation": ("q", "quat", "quaternion", "orientation", "attitude"),
    "position": ("p", "pos", "position"),
    "velocity": ("v", "vel", "velocity"),
    "specific_force": (
        "f", "a", "acc", "accel", "accelerometer", "acceleration", "specific_force", "accsmooth", "accadc", "imu_acc",
        "imu_accel",
    ),
    "internal_momentum": (
        "h", "internal_momentum", "momentum", "wheel_momentum", "flywheel_momentum", "rotor_momentum", "h_wheel",
    ),
    "toss": ("toss", "toss_id", "throw", "throw_id", "trial", "run", "segment"),
}  # fmt: skip
_OF_STEM = {stem: quantity for quantity, stems in STEMS.items() for stem in stems}
_GYROSCOPE = frozenset(("g", "gyr", "gyro", "gyroscope", "gyroadc", "gyro_adc", "gyrofilt", "imu_gyro"))
_LETTERS = {"orientation": "wxyz"}  # the axes of the others are xyz
PREFIXES = {
    "time": "", "angular_velocity": "w", "orientation": "q", "position": "p", "velocity": "v", "specific_force": "f",
    "internal_momentum": "h", "toss": "",
}  # fmt: skip
_UNIT_TAILS = {
    "s": "s", "sec": "s", "ms": "ms", "us": "us", "ns": "ns", "rad_s": "rad/s", "rads": "rad/s", "radps": "rad/s",
    "rad_per_s": "rad/s", "dps": "deg/s", "deg_s": "deg/s", "degs": "deg/s", "deg_per_s": "deg/s", "rpm": "rpm",
    "mps2": "m/s²", "m_s2": "m/s²", "ms2": "m/s²", "m_per_s2": "m/s²", "m": "m", "cm": "cm", "mm": "mm", "nms": "N m s",
    "kgm2_s": "kg m²/s", "kg_m2_s": "kg m²/s", "g": "g",
}  # fmt: skip
_CELL = re.compile(r"\s*(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))?\s*")


class Named(NamedTuple):
    """A column of a known quantity: jaxrb's own name for it, its unit where it says one, whether a gyroscope's."""

    quantity: str
    column: str
    unit: str | None
    gyroscope: bool


def named(cell: str) -> Named | None:
    """What a header's cell stands for; None if it is not known."""
    cell = cell.strip().strip("\"'")
    match = _CELL.fullmatch(cell)
    assert match is not None  # anything matches
    name, unit = match[1], match[2] if match[2] is not None else match[3]
    if unit is not None and re.fullmatch(r"[0-3]", unit.strip()):
        name, unit = f"{name}_{unit.strip()}", None  # gyroADC[0]: an index
    if found := re.fullmatch(r"(.*)\[([0-3])\]", name):
        name = f"{found[1]}_{found[2]}"  # gyroADC[0] (deg/s)
    plain = re.sub(r"[\s.\-]+", "_", name.strip().lower())
    return _split(plain, unit) or _with_tail(plain, unit)


def field(key: str) -> tuple[str, str | None] | None:
    """Quantity and unit that the key of an array stands for, such as `gyro_dps`; None if it is not known."""
    plain = key.strip().lower()
    for tail, unit in (("", None), *_UNIT_TAILS.items()):
        stem = plain.removesuffix(f"_{tail}") if tail else plain
        if (not tail or stem != plain) and len(stem) > 1 and stem in _OF_STEM:
            return _OF_STEM[stem], unit
    return ("time", None) if plain == "t" else None


def _with_tail(plain: str, unit: str | None) -> Named | None:
    """Names that end in their unit: `gyro_x_dps`, `time_us`."""
    if unit is not None:
        return None
    for tail, meant in _UNIT_TAILS.items():
        if plain.endswith(f"_{tail}") and (found := _split(plain.removesuffix(f"_{tail}"), meant)):
            return found
    return None


def _split(plain: str, unit: str | None) -> Named | None:
    if _OF_STEM.get(plain) in ("time", "toss"):
        quantity = _OF_STEM[plain]
        return Named(quantity, quantity, unit, False)
    if not (found := re.fullmatch(r"(.*?)_?([wxyz0-3])", plain)):
        return None
    stem, axis = found.groups()
    quantity = _OF_STEM.get(stem)
    if quantity is None or quantity in ("time", "toss"):
        return None
    letters = _LETTERS.get(quantity, "xyz")
    if axis.isdigit():
        # Four numbers of a quaternion may stand in either order, so they are not guessed; and a lone letter with a
        # number is as likely something else.
        if quantity == "orientation" or len(stem) < 2 or int(axis) >= len(letters):
            return None
        axis = letters[int(axis)]
    if axis not in letters:
        return None
    return Named(quantity, PREFIXES[quantity] + axis, unit, stem in _GYROSCOPE)
