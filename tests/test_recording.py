"""Recordings: what is read is what was written, and what cannot be right is refused by name."""

import json
import zipfile
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxrb.errors import InvalidInput, JaxrbError, JaxrbWarning, LimitExceeded
from jaxrb.io import Recording, read_recording, write_recording
from jaxrb.math import Quaternion

CUBES = Path(__file__).parents[1] / ".." / "shared" / "data" / "cube_tosses" / "cube_tosses_150.npz"


def columns(samples: int = 8, seed: int = 0) -> dict[str, np.ndarray]:
    """A made-up toss with every quantity."""
    random = np.random.default_rng(seed)
    orientation = random.normal(size=(samples, 4))
    return {
        "time": np.linspace(0.0, 0.1, samples),
        "angular_velocity": random.normal(size=(samples, 3)),
        "orientation": orientation / np.linalg.norm(orientation, axis=1, keepdims=True),
        "position": random.normal(size=(samples, 3)),
        "velocity": random.normal(size=(samples, 3)),
    }


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_what_is_written_is_read_back(tmp_path: Path, suffix: str):
    first, second = columns(8), columns(5, seed=1)
    made = Recording(**{k: [first[k], second[k]] for k in first}, metadata={"body": "brick", "mass": 1.5})
    read = read_recording(write_recording(made, tmp_path / f"tosses{suffix}"))
    assert read.metadata == made.metadata
    assert read.length.tolist() == [8, 5]
    for name, column in made.columns().items():
        # Normalising a normalised quaternion again may change its last digit.
        np.testing.assert_allclose(read.columns()[name], column, rtol=0, atol=1e-15)


def test_units_and_frames_are_converted(tmp_path: Path):
    c = columns()
    given = Recording(
        time=1e3 * c["time"],
        angular_velocity=np.degrees(c["angular_velocity"]),
        position=1e3 * c["position"],
        velocity=1e3 * c["velocity"],
        time_unit="ms",
        angular_velocity_unit="deg/s",
        length_unit="mm",
    )
    for name in ("time", "angular_velocity", "position", "velocity"):
        np.testing.assert_allclose(getattr(given, name), c[name], rtol=1e-14)
    file = tmp_path / "toss.csv"
    table = np.column_stack(
        [1e3 * c["time"], np.degrees(c["angular_velocity"][:, 0]), c["angular_velocity"][:, 1:]]
    )
    rows = [", ".join(map(repr, row)) for row in table.tolist()]
    file.write_text("# frame: body\ntime [ms], wx [deg/s], wy [rad/s], wz [rad/s]\n" + "\n".join(rows) + "\n")
    np.testing.assert_allclose(read_recording(file).angular_velocity, c["angular_velocity"], rtol=1e-14)


def test_angular_velocity_of_the_world_is_turned_into_the_body_frame():
    c = columns()
    with jax.enable_x64(True):
        world = np.asarray(Quaternion(c["orientation"]).rotate(c["angular_velocity"]))
    given = Recording(c["time"], world, c["orientation"], angular_velocity_frame="world")
    # float64 whatever JAX's default: the promise of the class
    assert given.angular_velocity is not None
    assert given.angular_velocity.dtype == np.float64
    np.testing.assert_allclose(given.angular_velocity, c["angular_velocity"], atol=1e-14)


def test_signs_of_quaternions_do_not_jump():
    c = columns(50)
    angle = np.linspace(0.0, 20.0, 50)
    smooth = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle], axis=-1)
    signs = np.where(np.arange(50) % 3 == 0, -1.0, 1.0)
    read = Recording(c["time"], orientation=smooth * signs[:, None]).orientation
    assert read is not None
    np.testing.assert_allclose(read, -smooth, atol=1e-15)


def broken(name: str, index: int, value: float) -> dict[str, np.ndarray]:
    c = columns()
    c[name] = c[name].copy()
    c[name][index] = value
    return c


BAD = {
    "not a number": (lambda: broken("angular_velocity", 3, np.nan), "angular_velocity.*index \\(3, 0\\)"),
    "infinite": (lambda: broken("position", 2, np.inf), "position.*inf"),
    "NaN time": (lambda: broken("time", 2, np.nan), "'time' is nan"),
    "time stands still": (lambda: {**columns(), "time": np.zeros(8)}, "must increase"),
    "time runs back": (lambda: {**columns(), "time": columns()["time"][::-1]}, "must increase"),
    "zero quaternion": (lambda: broken("orientation", 4, 0.0), "orientation.*sample 4.*instead of 1"),
    "wrong width": (lambda: {**columns(), "position": np.zeros((8, 2))}, "position.*\\(8, 2\\).*\\(8, 3\\)"),
    "one sample short": (lambda: {**columns(), "velocity": np.zeros((7, 3))}, "velocity.*\\(7, 3\\)"),
    "lengths disagree": (lambda: {**columns(), "length": [4, 3]}, "adds up to 7"),
    "lengths are no whole numbers": (lambda: {**columns(), "length": [4.0, 4.0]}, "whole numbers"),
    "a toss of one sample": (lambda: {**columns(), "length": [7, 1]}, "toss 1 has 1"),
    "words": (lambda: {**columns(), "position": np.full((8, 3), "x")}, "position.*not an array"),
    "nothing but time": (lambda: {"time": columns()["time"]}, "only 'time'"),
    "empty": (lambda: {k: v[:0] for k, v in columns().items()}, "at least 2"),
    "unknown unit": (lambda: {**columns(), "angular_velocity_unit": "turns"}, "'turns'.*deg/s"),
    "unknown frame": (lambda: {**columns(), "angular_velocity_frame": "camera"}, "'camera'"),
    "world frame without attitude": (
        lambda: {
            "time": columns()["time"],
            "angular_velocity": columns()["angular_velocity"],
            "angular_velocity_frame": "world",
        },
        "needs 'orientation'",
    ),
    "lists that disagree": (
        lambda: {"time": [np.arange(4.0), np.arange(4.0)], "position": [np.zeros((4, 3)), np.zeros((5, 3))]},
        "position.*\\[4, 5\\]",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_data_that_cannot_be_right_are_refused(case: str):
    make, message = BAD[case]
    with pytest.raises(InvalidInput, match=message):
        Recording(**make())


def test_quaternions_a_little_off_are_normalised_with_a_warning():
    c = columns()
    with pytest.warns(JaxrbWarning, match="not of length one"):
        read = Recording(c["time"], orientation=c["orientation"] * 1.0005)
    np.testing.assert_allclose(np.linalg.norm(read.orientation, axis=1), 1.0, atol=1e-15)
    with pytest.raises(InvalidInput, match="scalar first"):
        Recording(c["time"], orientation=c["orientation"] * 1.01)


def whole_file(folder: Path) -> Path:
    c = columns()
    return write_recording(Recording(c["time"], c["angular_velocity"], metadata={"a": 1}), folder / "r.npz")


def with_arrays(folder: Path, **arrays) -> Path:
    np.savez(folder / "r.npz", **arrays)
    return folder / "r.npz"


def cut(folder: Path) -> Path:
    file = whole_file(folder)
    file.write_bytes(file.read_bytes()[:-60])
    return file


def garbage(folder: Path) -> Path:
    (folder / "r.npz").write_bytes(bytes(range(256)) * 20)
    return folder / "r.npz"


def lying_header(folder: Path) -> Path:
    """A header that promises 298 GiB."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (40000000000,), }"
    header += b" " * (63 - (10 + len(header)) % 64) + b"\n"
    with zipfile.ZipFile(folder / "r.npz", "w") as archive:
        archive.writestr("time.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    return folder / "r.npz"


def csv(text: str):
    def make(folder: Path) -> Path:
        (folder / "r.csv").write_text(text)
        return folder / "r.csv"

    return make


HEADER = "# frame: body\ntime [s], wx [rad/s], wy [rad/s], wz [rad/s]\n"
BAD_FILES = {
    "missing": (lambda folder: folder / "none.npz", "no such file"),
    "a folder": (lambda folder: folder, "no such file"),
    "unknown ending": (lambda folder: csv("")(folder).rename(folder / "r.txt"), "npz or .csv"),
    "cut": (cut, "not a whole NPZ"),
    "garbage": (garbage, "not a whole NPZ"),
    "header lies about its size": (lying_header, "'time'.*fits"),
    "Python objects": (lambda f: with_arrays(f, time=np.array([{}, {}], dtype=object)), "'time'.*no array"),
    "newer schema": (
        lambda f: with_arrays(f, jaxrb_recording=np.array(2), time=np.arange(3.0)),
        "reads 1 to 1",
    ),
    "unknown field": (lambda f: with_arrays(f, time=np.arange(3.0), hue=np.zeros((3, 3))), "'hue'"),
    "no time and no rate": (lambda f: with_arrays(f, position=np.zeros((3, 3))), "'rate_hz'"),
    "rate zero": (
        lambda f: with_arrays(f, position=np.zeros((3, 3)), length=np.array([3]), rate_hz=np.array(0.0)),
        "'rate_hz' is 0",
    ),
    "cut in the middle of a stacked layout": (
        lambda f: with_arrays(f, position=np.zeros((3, 3)), length=np.array([5]), rate_hz=np.array(9.0)),
        "adds up to 5",
    ),
    "CSV without rows": (csv(""), "no header"),
    "CSV without units": (csv("# frame: body\ntime, wx, wy, wz\n0,1,2,3\n"), "time \\[s\\]"),
    "CSV without frame": (csv(HEADER.split("\n", 1)[1] + "0,1,2,3\n1,1,2,3\n"), "frame: body"),
    "CSV with a short row": (csv(HEADER + "0,1,2,3\n1,1,2\n"), "line 4 has 3 columns"),
    "CSV with a word": (csv(HEADER + "0,1,2,3\n1,1,x,3\n"), "line 4, column 'wy'"),
    "CSV with NaN": (csv(HEADER + "0,1,2,3\n1,1,nan,3\n"), "angular_velocity.*nan"),
    "CSV without wz": (csv("# frame: body\ntime [s], wx [rad/s], wy [rad/s]\n0,1,2\n"), "'wz' is missing"),
    "CSV with part of a gyroscope": (csv("time [s], gx [rad/s]\n0,1\n"), "'wy' is missing"),
    "CSV with a column twice": (csv("time [s], time [s]\n0,1\n"), "twice"),
    "CSV whose toss comes back": (
        csv(HEADER.replace("time", "toss, time") + "0,0,1,2,3\n1,0,1,2,3\n0,0,1,2,3\n"),
        "comes back",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_by_name(tmp_path: Path, case: str):
    make, message = BAD_FILES[case]
    with pytest.raises(JaxrbError, match=message):
        read_recording(make(tmp_path))


def test_a_flipped_byte_is_refused_or_changes_nothing(tmp_path: Path):
    file = whole_file(tmp_path)
    data, whole = file.read_bytes(), read_recording(file)
    refused = 0
    for place in range(0, len(data), 3):
        file.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        try:
            read = read_recording(file)
        except JaxrbError:
            refused += 1
            continue
        # Some bytes of a ZIP file carry nothing, such as the time of writing.
        assert read.metadata == whole.metadata
        for name, column in whole.columns().items():
            np.testing.assert_array_equal(read.columns()[name], column)
    assert refused > len(data) / 6


def test_a_csv_that_is_no_text_is_refused(tmp_path: Path):
    (tmp_path / "r.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InvalidInput, match="not a text file"):
        read_recording(tmp_path / "r.csv")


def test_a_csv_that_ends_in_the_middle_of_a_line_is_doubted(tmp_path: Path):
    with pytest.warns(JaxrbWarning, match="is the file cut"):
        read_recording(csv(HEADER + "0,1,2,3\n1,1,2,3")(tmp_path))


def test_files_beyond_the_limit_are_refused(tmp_path: Path):
    with pytest.raises(LimitExceeded, match="max_bytes=100"):
        read_recording(whole_file(tmp_path), max_bytes=100)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path):
    file = whole_file(tmp_path)
    before = file.read_bytes()
    c = columns()
    with pytest.raises(InvalidInput, match="not JSON"):
        write_recording(Recording(c["time"], c["position"], metadata={"a": object()}), file)
    with pytest.raises(JaxrbError, match="could not be written"):
        write_recording(Recording(c["time"], c["position"]), tmp_path / "no folder" / "r.npz")
    assert file.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["r.npz"]


def test_metadata_of_a_stacked_file_is_kept():
    if not CUBES.is_file():
        pytest.skip("the cube recording (DAIRLab, ContactNets) is not in ../shared/data")
    cubes = read_recording(CUBES)
    assert cubes.tosses == 150
    assert len(cubes.time) == cubes.length.sum() == 15862
    assert np.diff(cubes.time[: cubes.length[0]]) == pytest.approx(1 / 148.0)
    assert json.dumps(cubes.metadata)[:12] == '{"toss_id": '
