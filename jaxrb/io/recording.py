"""A recording of a tumbling body: what a gyroscope or a tracking camera wrote down. Host side, float64.

Units are SI and frames are jaxrb's once a `Recording` exists: time [s], angular velocity [rad/s] in the
body frame, orientation wxyz body to world, position [m] and velocity [m/s] in the world frame (z up).
Other units and frames are declared when it is made, and converted there. Nothing is repaired in silence:
what cannot be right is refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import jax
import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.io.columns import (
    ANGLE_UNITS,
    FORCE_UNITS,
    LENGTH_UNITS,
    MOMENTUM_UNITS,
    TIME_UNITS,
    WIDTHS,
    Columns,
    check_time,
    factor,
    stacked,
    unit_and_continuous,
)
from jaxrb.io.recording_gaps import without_gaps
from jaxrb.math import Quaternion


@dataclass(frozen=True, eq=False, init=False)
class Recording:
    """One or more tosses of one body.

    Give each quantity as one array over all samples, with `length` samples in each toss (default: one
    toss), or as a list with one array for each toss. At least one quantity beside `time` is needed.

    Args:
        time: (N,) [s, or `time_unit`], strictly increasing within each toss; spacing need not be even.
        angular_velocity: (N, 3) [rad/s, or `angular_velocity_unit`] in the body frame, or in the world
            frame if `angular_velocity_frame="world"`; the latter needs `orientation`.
        orientation: (N, 4) wxyz, scalar first, body to world. Stored normalised and without jumps of sign.
        position: (N, 3) [m, or `length_unit`] of the centre of mass, world frame, z up.
        velocity: (N, 3) [m/s, or `length_unit` per second], world frame.
        specific_force: (N, 3) [m/s², or `specific_force_unit`] of an accelerometer, body frame: zero at the centre of
            mass in free flight, +9.8 upwards at rest.
        internal_momentum: (N, 3) [kg m²/s, or `internal_momentum_unit`] angular momentum of a wheel inside, relative
            to the body, body frame; also (3,) where it is the same throughout, or (T, 3) with one for each toss. The
            whole has I ω + this, with I the inertia of everything.
        length: (T,) number of samples in each toss.
        time_unit: "s", "ms", "us" or "ns". angular_velocity_unit: "rad/s", "deg/s", "rpm". length_unit: "m", "cm",
            "mm". specific_force_unit: "m/s²" or "g" (9.80665 m/s²). internal_momentum_unit: "kg m²/s", "N m s".
        gaps: "refuse" or "leave out" samples that are not finite or whose time does not increase; `left_out` then
            counts them. Where the clock starts again, so does a toss.
        metadata: anything that JSON can hold: body, instrument, truth.
        source: what error messages call this recording, such as the file's name.

    Raises:
        InvalidInput: naming source, field, place and value, for numbers that are not finite, time that
            does not increase, shapes or lengths that disagree, quaternions that are not of length one, or
            an unknown unit.
    """

    time: np.ndarray
    angular_velocity: np.ndarray | None
    orientation: np.ndarray | None
    position: np.ndarray | None
    velocity: np.ndarray | None
    specific_force: np.ndarray | None
    internal_momentum: np.ndarray | None
    length: np.ndarray
    metadata: dict[str, Any] = field(default_factory=dict)
    source: str = "Recording"
    left_out: dict[str, int] = field(default_factory=dict)

    def __init__(
        self,
        time: Columns,
        angular_velocity: Columns | None = None,
        orientation: Columns | None = None,
        position: Columns | None = None,
        velocity: Columns | None = None,
        specific_force: Columns | None = None,
        internal_momentum: Columns | None = None,
        length: Columns | None = None,
        *,
        time_unit: str = "s",
        angular_velocity_unit: str = "rad/s",
        angular_velocity_frame: str = "body",
        length_unit: str = "m",
        specific_force_unit: str = "m/s²",
        internal_momentum_unit: str = "kg m²/s",
        gaps: Literal["refuse", "leave out"] = "refuse",
        metadata: Mapping[str, Any] | None = None,
        source: str = "Recording",
    ):
        given = {
            "angular_velocity": angular_velocity,
            "orientation": orientation,
            "position": position,
            "velocity": velocity,
            "specific_force": specific_force,
            "internal_momentum": internal_momentum,
        }
        given = {name: value for name, value in given.items() if value is not None}
        if not given:
            raise InvalidInput(
                f"{source}: only 'time' is given. Add angular_velocity, orientation or position."
            )
        if gaps not in ("refuse", "leave out"):
            raise InvalidInput(f"{source}: gaps is {gaps!r}; give 'refuse' or 'leave out'.")
        left_out: dict[str, int] = {}
        wheel = _constant(given, time, length, source)
        arrays, lengths = stacked({"time": time, **given}, length, source, gaps == "leave out")
        if wheel is not None:
            arrays["internal_momentum"] = np.repeat(
                np.broadcast_to(wheel, (len(lengths), 3)), lengths, axis=0
            )
        if gaps == "leave out":
            arrays, lengths, left_out = without_gaps(arrays, lengths, source)
        check_time(arrays["time"], lengths, source)
        metre = factor(LENGTH_UNITS, length_unit, "length_unit", source)
        scales = {
            "time": factor(TIME_UNITS, time_unit, "time_unit", source),
            "angular_velocity": factor(ANGLE_UNITS, angular_velocity_unit, "angular_velocity_unit", source),
            "orientation": 1.0,
            "position": metre,
            "velocity": metre,
            "specific_force": factor(FORCE_UNITS, specific_force_unit, "specific_force_unit", source),
            "internal_momentum": factor(
                MOMENTUM_UNITS, internal_momentum_unit, "internal_momentum_unit", source
            ),
        }
        with np.errstate(over="ignore"):
            arrays = {name: array * scales[name] for name, array in arrays.items()}
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise InvalidInput(
                    f"{source}: field '{name}' leaves the floating range in SI units; is its unit right?"
                )
        if "orientation" in arrays:
            arrays["orientation"] = unit_and_continuous(arrays["orientation"], lengths, source)
        if angular_velocity_frame not in ("body", "world"):
            raise InvalidInput(
                f"{source}: angular_velocity_frame is {angular_velocity_frame!r}; give 'body' or 'world'."
            )
        if angular_velocity_frame == "world" and "angular_velocity" in arrays:
            arrays["angular_velocity"] = _into_body(arrays, source)
        for name in ("time", *WIDTHS):
            object.__setattr__(self, name, arrays.get(name))
        object.__setattr__(self, "length", lengths)
        object.__setattr__(self, "metadata", dict(metadata or {}))
        object.__setattr__(self, "source", source)
        object.__setattr__(self, "left_out", left_out)

    @property
    def tosses(self) -> int:
        """Number of tosses."""
        return len(self.length)

    @property
    def starts(self) -> np.ndarray:
        """(T + 1,) index of each toss's first sample, and the number of samples at the end."""
        return np.concatenate([[0], np.cumsum(self.length)])

    def columns(self) -> dict[str, np.ndarray]:
        """Every quantity that was recorded, `time` first."""
        named = {name: getattr(self, name) for name in ("time", *WIDTHS)}
        return {name: array for name, array in named.items() if array is not None}


def _constant(given: dict[str, Any], time: Any, length: Any, source: str) -> np.ndarray | None:
    """Take a wheel's momentum that does not change, (3,) or (T, 3), out of `given`."""
    wheel = given.get("internal_momentum")
    if wheel is None or (isinstance(wheel, (list, tuple)) and len(wheel) and np.ndim(wheel[0]) > 1):
        return None
    listed = isinstance(time, (list, tuple)) and len(time) > 0 and np.ndim(time[0]) > 0
    tosses = len(time) if listed else 1 if length is None else len(length)
    shape = np.shape(wheel)
    if shape != (3,) and (shape != (tosses, 3) or (not listed and tosses == len(time))):
        return None
    del given["internal_momentum"]
    value = np.asarray(wheel, float)
    if not np.isfinite(value).all():
        raise InvalidInput(f"{source}: field 'internal_momentum' is {value.tolist()}; give finite numbers.")
    return value


def _into_body(arrays: Mapping[str, np.ndarray], source: str) -> np.ndarray:
    if "orientation" not in arrays:
        raise InvalidInput(
            f"{source}: angular velocity in the world frame needs 'orientation' to turn it into the body's."
        )
    with jax.enable_x64(True):  # host data stays in float64 whatever the user's setting
        return np.asarray(Quaternion(arrays["orientation"]).unrotate(arrays["angular_velocity"]))
