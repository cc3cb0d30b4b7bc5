"""The body of `jaxrb fit FILE`: a recording in, a table or JSON out."""

import json as json_text
import sys
import time
from pathlib import Path
from typing import Literal

from jaxrb.fit.inertia import fit_inertia
from jaxrb.io.recording_files import read_recording


def fit(
    file: Path,
    *,
    json: bool = False,
    drag: bool = False,
    nuisances: tuple[str, ...] = (),
    centre_of_mass: bool = False,
    required: tuple[str, ...] = (),
    html: Path | None = None,
    trace: float | None = None,
    minimum_samples: int = 7,
    angular_velocity_unit: Literal["rad/s", "deg/s"] | None = None,
    angular_velocity_frame: Literal["body", "world"] | None = None,
    length_unit: Literal["m", "cm", "mm"] | None = None,
) -> None:
    """Inertia of a tumbling body from a recording (NPZ or CSV), with error bars.

    Example: jaxrb fit tosses.npz --json
    Example: jaxrb fit throw.csv --nuisances auto --html throw.html

    Args:
        file: recording; its layouts are described in jaxrb.io.recording_files and jaxrb.io.recording_csv.
        json: print one JSON object instead of a table.
        drag: also fit a torque that slows the spin.
        nuisances: "auto" for those that the recording calls for, or names: linear_drag, quadratic_drag, gyro_bias,
            gyro_scale, tilt, delay.
        centre_of_mass: also find the centre of mass from the accelerometer.
        required: any of scale, mass, "centre of mass"; an error where the recording cannot give it.
        html: write a page with residuals, bounds and advice into this file.
        trace: sum of the three moments [kg m²], if known; the recording gives ratios only.
        minimum_samples: free flights shorter than this are left out.
        angular_velocity_unit: of a file that does not say.
        angular_velocity_frame: of a file that does not say.
        length_unit: of a file that does not say.

    Raises:
        JaxrbError: for a file that cannot be read or a motion that does not determine the ratios.
    """
    from tqdm import tqdm

    began = time.perf_counter()
    # disable=None: no bar where nobody watches. JSON on standard output stays clean either way.
    with tqdm(total=None, bar_format="{desc} [{elapsed}]", leave=False, disable=None, file=sys.stderr) as bar:
        bar.set_description_str(f"reading {file}")
        recording = read_recording(
            file,
            angular_velocity_unit=angular_velocity_unit,
            angular_velocity_frame=angular_velocity_frame,
            length_unit=length_unit,
        )
        found = fit_inertia(
            recording,
            trace=trace,
            angular_drag=drag,
            nuisances="auto" if nuisances == ("auto",) else nuisances,
            centre_of_mass=centre_of_mass,
            required=required,
            minimum_samples=minimum_samples,
            progress=bar.set_description_str,
        )
        if html is not None:
            bar.set_description_str(f"drawing {html}")
            found.save_html(html)
    seconds = time.perf_counter() - began
    if json:
        print(json_text.dumps({**found.as_dict(), "seconds": seconds}))
    else:
        print(f"{found.summary()}\nTime: {seconds:.1f} s.")
