"""F. Bad files of runs: numbers 85 to 93 of the project's list of bad inputs.

A full disk, a killed process, two writers and places that are no files [87, 91, 92, 93] are in io/test_run_files.py.
"""

import io
import json
import os
import time
import tracemalloc
import zipfile

import jax
import long_run_scene
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbError, JaxrbWarning, LimitExceeded
from jaxrb.io.checkpoint import RunFile
from jaxrb.io.tree import digest

STEPS = 60
SETTINGS = long_run_scene.SETTINGS


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Scene, state, the bytes of a run's file, and its arrays."""
    scene, state = long_run_scene.free()
    file = tmp_path_factory.mktemp("good") / "run.npz"
    rb.run(scene, state, steps=STEPS, checkpoint=file, **SETTINGS)
    with np.load(file) as arrays:
        return scene, state, file.read_bytes(), dict(arrays)


@pytest.fixture
def resumed(good, tmp_path):
    """`resumed(bytes, **changed settings)`: go on from a file that holds these bytes."""

    def resume(data, scene=None, state=None, **changes):
        file = tmp_path / "run.npz"
        file.write_bytes(data)
        settings = {"steps": STEPS} | SETTINGS | changes
        try:
            return rb.run(
                good[0] if scene is None else scene, good[1] if state is None else state, checkpoint=file,
                resume=True, **settings,
            )  # fmt: skip
        finally:
            assert file.read_bytes() == data  # whatever was refused is still there

    return resume


def packed(arrays, sealed=True, **changes):
    """The bytes of a file with other arrays; with the right checksum where it is to get past that."""
    found = {name: value for name, value in (arrays | changes).items() if value is not None}
    if sealed:
        found.pop("checksum")
        found["checksum"] = np.asarray(digest(found))
    stream = io.BytesIO()
    np.savez(stream, **found)
    return stream.getvalue()


def header(arrays, **changes):
    told = json.loads(str(arrays["header"])) | changes
    return np.asarray(json.dumps({name: value for name, value in told.items() if value is not ...}))


def raw(arrays, name, data):
    """A file in which one array's bytes are something else."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for key, value in arrays.items():
            part = io.BytesIO()
            np.save(part, value)
            archive.writestr(f"{key}.npy", data if key == name else part.getvalue())
    return stream.getvalue()


def huge():
    part = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        part, {"descr": "<f8", "fortran_order": False, "shape": (40_000_000_000,)}
    )
    return part.getvalue() + b"\0" * 64


def pickled():
    part = io.BytesIO()
    np.save(part, np.asarray([object()]), allow_pickle=True)
    return part.getvalue()


BAD = {
    "pickle inside [85]": (
        lambda a, d: raw(a, "progress_0", pickled()),
        "'progress_0' .*object, which is no array",
    ),
    "header of 298 GiB [86]": (
        lambda a, d: raw(a, "progress_0", huge()),
        r"said to hold \(40000000000,\) of float64",
    ),
    "cut in the middle [87]": (lambda a, d: d[: len(d) // 2], "not a whole NPZ file"),
    "empty [87]": (lambda a, d: b"", "not a whole NPZ file"),
    "random bytes": (lambda a, d: np.random.default_rng(0).bytes(3000), "not a whole NPZ file"),
    "no header": (lambda a, d: packed(a, header=None), "no file of a run: it has no header"),
    "no checksum": (lambda a, d: packed(a, sealed=False, checksum=None), "no header and checksum"),
    "a number changed [88]": (
        lambda a, d: packed(a, sealed=False, progress_0=a["progress_0"] + 1),
        "the checksum is .* changed since",
    ),
    "header of no JSON": (lambda a, d: packed(a, header=np.asarray("{")), "header is no JSON"),
    "header of a deep JSON": (lambda a, d: packed(a, header=np.asarray("[" * 100_000)), "header is no JSON"),
    "newer schema [89]": (
        lambda a, d: packed(a, header=header(a, schema=99)),
        "schema is 99; this jaxrb reads 1 to 2: update jaxrb",
    ),
    "schema a word [89]": (lambda a, d: packed(a, header=header(a, schema="new")), "schema is 'new'"),
    "array missing": (
        lambda a, d: packed(a, progress_1=None),
        "array progress_1 is missing, .*another scene",
    ),
    "array of another shape": (
        lambda a, d: packed(a, progress_0=a["progress_0"][:1]),
        r"progress_0 is float\d+\[1, 3\], which is no part",
    ),
    "rows missing": (
        lambda a, d: packed(a, saved_0=a["saved_0"][:-1]),
        "states were saved in 60 steps; take another copy",
    ),
    "more steps than there are": (
        lambda a, d: packed(a, header=header(a, done=10**9)),
        "states were saved in",
    ),
    "a negative count": (lambda a, d: packed(a, header=header(a, done=-1)), "done is -1 in its header"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_file_is_refused_and_kept(case, good, resumed):
    change, message = BAD[case]
    with pytest.raises(InvalidInput, match=message) as found:
        resumed(change(good[3], good[2]))
    assert "run.npz" in str(found.value)


def heavier():
    scene, _ = long_run_scene.free()
    return rb.Scene(scene.bodies, (rb.UniformGravity((0, 0, -9.80)), scene.effects[1]))


OTHERS = {
    "scene [90]": ({"scene": heavier()}, "scene_sha256 is"),
    "method [90]": ({"method": rb.RungeKutta4()}, "method_sha256 is"),
    "dt [90]": ({"dt": 2e-3}, "dt is 0.001 there and 0.002 here"),
    "save_every [90]": ({"save_every": 1}, "save_every is 7 there and 1 here"),
    "torque [90]": ({"torque": np.zeros(3)}, "torque_sha256 is"),
    "fewer steps": ({"steps": 50}, "has done 60 steps, more than steps = 50"),
}


@pytest.mark.parametrize("case", OTHERS)
def test_file_of_another_run_is_refused(case, good, resumed):
    changes, message = OTHERS[case]
    with pytest.raises(InvalidInput, match=message):
        resumed(good[2], **changes)


def test_file_of_another_floating_type_is_refused(good, resumed):
    """[90]"""
    scene, state = long_run_scene.free()
    other = np.float32 if state.dtype == np.float64 else np.float64
    with jax.enable_x64(True), pytest.raises(InvalidInput, match="state_sha256 is"):
        resumed(good[2], state=jax.tree.map(lambda x: np.asarray(x, other), state), scene=scene)


def test_file_of_another_jax_is_doubted(good, resumed):
    with pytest.warns(JaxrbWarning, match=r"written with jax 0\.0\.1, this is .* in the last bits"):
        resumed(packed(good[3], header=header(good[3], jax="0.0.1")))


def test_every_bit_of_a_file_is_watched(good, tmp_path):
    """[88] A flipped bit is refused, or it lies where nothing is said: the archive's own dates and padding."""
    file, random = tmp_path / "run.npz", np.random.default_rng(0)
    refused = 0
    for place in random.integers(0, len(good[2]), 100):
        data = bytearray(good[2])
        data[place] ^= 1 << int(random.integers(8))
        file.write_bytes(data)
        try:
            arrays = RunFile(file, 2**30)
        except InvalidInput:
            refused += 1
            continue
        assert arrays.number("done") == STEPS
        for name, value in arrays._arrays.items():
            assert value.tobytes() == good[3][name].tobytes()
    assert refused > 60


def test_file_beyond_the_limit_is_refused(good, tmp_path):
    (tmp_path / "run.npz").write_bytes(good[2])
    with pytest.raises(LimitExceeded, match="max_bytes=100"):
        rb.replay(tmp_path / "run.npz", max_bytes=100)


def test_no_file_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"away\.npz: no such file"):
        rb.replay(tmp_path / "away.npz")


def tampered(arrays, random):
    """A file with the right checksum, and something wrong in its tree, header or arrays."""
    told = json.loads(str(arrays["header"]))
    changed = dict(arrays)
    for _ in range(random.integers(1, 4)):
        kind = random.integers(4)
        if kind == 0:  # a word of the header
            text = json.dumps(told)
            a = random.integers(len(text))
            text = (
                text[:a]
                + str(random.choice(["0", "null", "[]", "{}", "}", '"', "1e999", "x"]))
                + text[a + 3 :]
            )
            changed["header"] = np.asarray(text)
        elif kind == 1:  # an entry of it
            key = str(random.choice(list(told)))
            told[key] = [None, -1, 1e300, "x", {}, [[]]][random.integers(6)]
            changed["header"] = np.asarray(json.dumps(told))
        else:
            name = str(random.choice(list(changed)))
            value = np.asarray(changed[name])
            changed[name] = [value.ravel()[:1], np.asarray("x"), value[None], np.zeros((0,))][
                random.integers(4)
            ]
    changed.pop("checksum", None)
    return packed(changed, sealed=False, checksum=np.asarray(digest(changed)))


@pytest.mark.filterwarnings("ignore::jaxrb.errors.JaxrbWarning")
def test_damaged_files_raise_nothing_but_our_errors(good, tmp_path):
    """JAXRB_FUZZ=10000 reads that many and prints what the worst of them cost."""
    count = int(os.environ.get("JAXRB_FUZZ", "60"))
    random, file = np.random.default_rng(1), tmp_path / "run.npz"
    slowest, largest, refusals = 0.0, 0, 0
    failure = header(good[3], kind="failure", first_bad_step=STEPS)
    arrays = good[3] | {"header": failure}
    for i in range(count):
        if i % 3:
            data = tampered(arrays, random)
        else:
            injured = bytearray(packed(arrays))
            for place in random.integers(0, len(injured), random.integers(1, 30)):
                injured[place] = random.integers(256)
            data = bytes(injured if i % 2 else injured[: random.integers(1, len(injured))])
        file.write_bytes(data)
        if count > 100:
            tracemalloc.start()
        start = time.process_time()
        try:
            found = RunFile(file, 2**30)
            for name in ("scene", "state", "method", "torque"):
                found.origin(name)
        except JaxrbError:
            refusals += 1
        slowest = max(slowest, time.process_time() - start)
        if count > 100:
            largest = max(largest, tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    print(f"{count} files, {refusals} refused; slowest {slowest:.3f} s, largest {largest / 2**20:.1f} MiB")
    assert refusals > count / 3
