"""The body of `jaxrb fit FILE`: a recording in, a table or JSON out."""

import json as json_text
import sys
import time
from pathlib import Path
from typing import Literal

from jaxrb.fit.inertia import fit_inertia
from jaxrb.fit.report import InertiaFit
from jaxrb.fit.toss_command import tosses_fitted
from jaxrb.io.recording_files import read_recording


def fit(
    file: Path,
    *,
    json: bool = False,
    drag: bool = False,
    nuisances: tuple[str, ...] = ("auto",),
    centre_of_mass: bool = False,
    required: tuple[str, ...] = (),
    html: Path | None = None,
    trace: float | None = None,
    minimum_samples: int = 7,
    time_unit: Literal["s", "ms", "us", "ns"] | None = None,
    angular_velocity_unit: Literal["rad/s", "deg/s", "rpm"] | None = None,
    angular_velocity_frame: Literal["body", "world"] | None = None,
    length_unit: Literal["m", "cm", "mm"] | None = None,
    specific_force_unit: Literal["m/s²", "m/s2", "g"] | None = None,
    internal_momentum: tuple[float, float, float] | None = None,
    internal_momentum_unit: Literal["kg m²/s", "N m s"] | None = None,
    gaps: Literal["refuse", "leave out"] = "leave out",
    tosses: tuple[str, ...] = (),
    half_extents: tuple[float, float, float] | None = None,
    radius: float | None = None,
    mass: float = 1.0,
    rounds: int = 10,
) -> None:
    """Inertia of a tumbling body from a recording (NPZ or CSV), with error bars; with --tosses, numbers of its contact.

    Example: jaxrb fit tosses.npz --json
    Example: jaxrb fit throw.csv --angular-velocity-unit deg/s --html throw.html
    Example: jaxrb fit wheel.csv --internal-momentum 0 0 0.012

    Example: jaxrb fit cube.npz --tosses friction restitution metric_scale --half-extents 0.05 0.05 0.05 --mass 0.37

    Args:
        file: recording; its layouts are described in jaxrb.io.recording_files and jaxrb.io.recording_csv.
        json: print one JSON object instead of a table.
        drag: also fit a torque that slows the spin.
        nuisances: "auto" for all, each with a belief about its size, or names: linear_drag, quadratic_drag, gyro_bias,
            gyro_scale, tilt, delay, metric_scale; "none" for none.
        centre_of_mass: also find the centre of mass from the accelerometer.
        required: any of scale, mass, "centre of mass"; an error where the recording cannot give it.
        html: write a page with residuals, bounds and advice into this file.
        trace: sum of the three moments [kg m²], if known; the recording gives ratios only.
        minimum_samples: free flights shorter than this are left out.
        time_unit: of a file that does not say.
        angular_velocity_unit: of a file that does not say.
        angular_velocity_frame: of a file that does not say.
        length_unit: of a file that does not say.
        specific_force_unit: of a file that does not say.
        internal_momentum: of a wheel at constant speed [kg m²/s, or its unit], relative to the body, body frame.
        internal_momentum_unit: of a file that does not say.
        gaps: what becomes of samples with missing values, repeated or out of order; those left out are counted.
        tosses: instead, find these from tosses onto a table at z = 0: friction, restitution (or log10_stiffness),
            metric_scale, size, inertia; the first recorded states are run on and compared with the rest.
        half_extents: of a box that is tossed [m].
        radius: of a ball that is tossed [m].
        mass: of what is tossed [kg]; only a compliant contact knows it.
        rounds: of the search over tosses, of 12 sets of numbers each.

    Raises:
        JaxrbError: for a file that cannot be read or a motion that does not determine the ratios.
    """
    from tqdm import tqdm

    began = time.perf_counter()
    # disable=None: no bar where nobody watches.
    with tqdm(total=None, bar_format="{desc} [{elapsed}]", leave=False, disable=None, file=sys.stderr) as bar:
        bar.set_description_str(f"reading {file}")
        recording = read_recording(
            file, time_unit=time_unit, angular_velocity_unit=angular_velocity_unit,
            angular_velocity_frame=angular_velocity_frame, length_unit=length_unit,
            specific_force_unit=specific_force_unit, internal_momentum=internal_momentum,
            internal_momentum_unit=internal_momentum_unit, gaps=gaps,
        )  # fmt: skip
        say = bar.set_description_str
        if tosses:
            found = tosses_fitted(recording, tosses, half_extents, radius, mass, rounds, html, say)
        else:
            found = fit_inertia(
                recording, trace=trace, angular_drag=drag, nuisances=_nuisances(nuisances),
                centre_of_mass=centre_of_mass, required=required, minimum_samples=minimum_samples, progress=say,
            )  # fmt: skip
        if html is not None and isinstance(found, InertiaFit):
            say(f"drawing {html}")
            found.save_html(html)
    seconds = time.perf_counter() - began
    if json:
        print(json_text.dumps({**found.as_dict(), "seconds": seconds}))
    else:
        print(f"{found.summary()}\nTime: {seconds:.1f} s.")


def _nuisances(names: tuple[str, ...]) -> tuple[str, ...] | Literal["auto"]:
    return "auto" if names == ("auto",) else () if names == ("none",) else names
