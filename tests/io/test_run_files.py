"""Long runs: the same bits however they are cut, interrupted and gone on with; and nothing lost.

Killed ones are in hard/test_safety.py.
"""

import os
import resource

import jax
import jax.numpy as jnp
import long_run_scene
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbError, RunFailed, RunInterrupted, WrongStructure
from jaxrb.io import npz
from jaxrb.io.checkpoint import RunFile, Sums, only_writer
from jaxrb.io.npz import write_arrays
from jaxrb.io.rows import Rows
from jaxrb.io.tree import checksum, digest

STEPS = 400
SETTINGS = long_run_scene.SETTINGS


@pytest.fixture(scope="module")
def flight():
    """Scene, state and the path of an uninterrupted run."""
    scene, state = long_run_scene.free()
    return scene, state, rb.run(scene, state, steps=STEPS, **SETTINGS)


def assert_same_bits(one, other):
    both = [jax.tree.leaves((p.times, p.states, p.final, p.status, p.contact)) for p in (one, other)]
    for a, b in zip(*both, strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def whole(scene, state, **changes):
    return rb.run(scene, state, **({"steps": STEPS} | SETTINGS | changes))


def interrupted(scene, state, file, at, **changes):
    """The path of a run that Ctrl-C ends once `at` steps are done."""

    def show(done, _):
        if done >= at:
            raise KeyboardInterrupt

    with pytest.raises(RunInterrupted, match="goes on from there with resume=True") as found:
        whole(scene, state, checkpoint=file, progress=show, **changes)
    return found.value.path


@pytest.mark.parametrize("chunk", [1, 13, 1000, None])
def test_bits_do_not_depend_on_the_stretches_and_are_those_of_rollout(flight, chunk):
    scene, state, path = flight
    assert_same_bits(whole(scene, state, chunk=chunk), path)
    settings = {name: SETTINGS[name] for name in ("dt", "save_every", "method")}
    assert_same_bits(rb.rollout(scene, state, steps=STEPS, **settings), path)


def test_torque_of_each_step_is_the_one_of_rollout(flight):
    scene, state, _ = flight
    torque = 1e-3 * np.random.default_rng(0).normal(size=(30, 2, 3)).astype(state.dtype)
    settings = {"dt": 1e-3, "steps": 30, "torque": torque, "method": "ExplicitEuler"}
    assert_same_bits(rb.run(scene, state, chunk=7, **settings), rb.rollout(scene, state, **settings))


@pytest.mark.parametrize("overhead", [1e9, 1e-9], ids=["each stretch written", "written at the end"])
def test_a_run_that_was_interrupted_goes_on_with_the_same_bits(flight, tmp_path, overhead):
    scene, state, path = flight
    file = tmp_path / "run.npz"
    done = interrupted(scene, state, file, 150, overhead=overhead)
    assert len(done.times) == 150 // 7 + 1
    assert np.array_equal(done.states.position, np.asarray(path.states.position)[: len(done.times)])
    assert_same_bits(whole(scene, state, checkpoint=file, resume=True), path)
    # Once more, with nothing left to do; and further than was asked at first.
    assert_same_bits(whole(scene, state, checkpoint=file, resume=True), path)
    more = whole(scene, state, steps=STEPS + 60, checkpoint=file, resume=True)
    assert_same_bits(more, whole(scene, state, steps=STEPS + 60))


def test_memory_of_contact_is_carried_over(tmp_path):
    scene, state = long_run_scene.touching()
    settings = {"method": "RungeKutta4", "steps": 150, "dt": 2e-3}
    file = tmp_path / "run.npz"
    interrupted(scene, state, file, 60, **settings)
    assert_same_bits(
        whole(scene, state, checkpoint=file, resume=True, **settings), whole(scene, state, **settings)
    )


def test_no_steps_give_back_the_initial_state(flight, tmp_path):
    scene, state, _ = flight
    path = whole(scene, state, steps=0, checkpoint=tmp_path / "run.npz")
    assert path.times.tolist() == [0.0]
    assert bool(path.status.ok)
    assert np.array_equal(path.final.angular_velocity, state.angular_velocity)


# --- what cannot be written -------------------------------------------------------------------------------------------


@pytest.fixture
def begun(flight, tmp_path):
    """Scene, state and the file of 150 steps."""
    scene, state, _ = flight
    file = tmp_path / "run.npz"
    interrupted(scene, state, file, 150)
    return scene, state, file


def refuses_to_write(scene, state, file, message, error=JaxrbError):
    before = file.read_bytes()
    with pytest.raises(error, match=message) as found:
        whole(scene, state, checkpoint=file, resume=True)
    assert str(file) in str(found.value)
    assert file.read_bytes() == before
    assert [p.name for p in file.parent.iterdir() if p.suffix == ".partial"] == []


@pytest.mark.parametrize("place", ["os.fsync", "os.replace", "tempfile.mkstemp"])
def test_full_disk_leaves_the_old_file_and_says_so(begun, monkeypatch, place):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(place, full)
    refuses_to_write(*begun, "could not be written.*No space left.*Nothing was changed there")


def test_disk_that_takes_no_more_bytes_leaves_the_old_file(begun):
    """The system itself cuts the file that is being written."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, hard))
    try:
        refuses_to_write(*begun, "could not be written.*File too large")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_two_runs_do_not_write_one_file(begun):
    with only_writer(begun[2]):
        refuses_to_write(*begun, "another run writes there.*wait for it")


def test_a_file_that_is_there_is_not_overwritten(begun):
    scene, state, file = begun
    before = file.read_bytes()
    with pytest.raises(InvalidInput, match="exists already; give resume=True"):
        whole(scene, state, checkpoint=file)
    assert file.read_bytes() == before


def test_places_that_hold_no_file_are_refused_before_anything_runs(flight, tmp_path):
    scene, state, _ = flight
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.npz").symlink_to("elsewhere.npz")
    for place, message in (
        ("folder", "is a folder"),
        ("link.npz", "is a link to elsewhere.npz.*give that name"),
        ("away/run.npz", "there is no folder .*away; make it first"),
        ("/proc/run.npz", "could not be written"),
    ):
        for name in ("checkpoint", "failure"):
            if place.startswith("/proc") and name == "failure":
                continue  # found out only when there is something to write
            with pytest.raises(JaxrbError, match=message) as found:
                whole(scene, state, **{name: tmp_path / place})
            assert str(tmp_path / place) in str(found.value)


# --- failures ---------------------------------------------------------------------------------------------------------


def unstable(force=None):
    """Drag whose decay is ten times too fast for the step: the velocity grows 300-fold a step."""
    effects = (rb.LinearDrag(1e3), *([] if force is None else [rb.CustomForce(force)]))
    scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 3.0)), effects)
    return scene, scene.state(velocity=(1.0, 0, 0), angular_velocity=(1.0, 2.0, 3.0))


def push(_body, _state, _parameters):
    return rb.Wrench(force=jnp.zeros(3))


SOON = {"dt": 1e-2, "steps": 1020, "chunk": 10, "method": "ExplicitEuler"}
pytestmark = pytest.mark.filterwarnings("ignore:dt = 0.01 s is beyond the stability")


def test_failed_run_can_be_looked_at_again(tmp_path):
    scene, state = unstable()
    file = tmp_path / "run.npz"
    with pytest.raises(
        RunFailed, match=r"first at step \d+.*last good state, step \d+, is in .*run\.failure\.npz"
    ):
        rb.run(scene, state, checkpoint=file, overhead=1e9, **SOON)
    flagged = rb.run(scene, state, failure=tmp_path / "other.npz", on_error="flag", **SOON)
    bad = int(flagged.status.first_bad_step[0])
    assert 0 < bad < 1000
    steps = (bad - 1) % 10 + 1  # the record begins where the stretch did
    for record in ("run.failure.npz", "other.npz"):
        path = rb.replay(tmp_path / record)
        assert int(path.status.first_bad_step[0]) == bad
        assert np.asarray(path.times) == pytest.approx(1e-2 * np.arange(bad - steps, bad + 1), rel=1e-6)
        expected = np.asarray(flagged.states.velocity)[bad - steps : bad + 1]
        assert np.asarray(path.states.velocity).tobytes() == expected.tobytes()
        assert not np.isfinite(np.asarray(path.states.velocity[-1])).all()
    assert len(rb.replay(tmp_path / record, last=1).times) == 2
    # What was good before it is in the checkpoint.
    assert RunFile(file, 2**30).number("done") == (bad - 1) // 10 * 10


def test_record_of_a_scene_with_functions_asks_for_the_scene(tmp_path):
    scene, state = unstable(push)
    with pytest.raises(RunFailed):
        rb.run(scene, state, failure=tmp_path / "f.npz", **SOON)
    with pytest.raises(InvalidInput, match=r"f\.npz: holds no scene .*push.*give scene=… as it was"):
        rb.replay(tmp_path / "f.npz")
    with pytest.raises(InvalidInput, match=r"scene_sha256 is .* there and .* here; give the scene as it was"):
        rb.replay(tmp_path / "f.npz", unstable()[0])
    assert not bool(rb.replay(tmp_path / "f.npz", scene).status.ok)


def test_a_checkpoint_is_no_record_of_a_failure(begun):
    with pytest.raises(InvalidInput, match=r"no record of a failure; continue it with rb\.run"):
        rb.replay(begun[2])


def test_record_in_double_precision_is_refused_without_it(tmp_path, dtype):
    if dtype == jnp.float32:
        pytest.skip("writes in double precision")
    with pytest.raises(RunFailed):
        rb.run(*unstable(), failure=tmp_path / "f.npz", **SOON)
    with jax.enable_x64(False), pytest.raises(WrongStructure, match=r"run in float64.*JAX_ENABLE_X64=1"):
        rb.replay(tmp_path / "f.npz")


def test_bar_is_drawn_where_it_is_asked_for(flight, capsys):
    scene, state, _ = flight
    whole(scene, state, progress=True)
    assert f"{STEPS}/{STEPS}" in capsys.readouterr().err


# --- what a file's checksum is of -------------------------------------------------------------------------------------


@pytest.mark.parametrize("cuts", [(5,), (1, 2, 5), (0, 5, 5)])
def test_sum_of_rows_that_grow_is_that_of_all_of_them(cuts):
    rows = np.random.default_rng(0).normal(size=(5, 2, 3))
    sums = Sums()
    for cut in cuts:
        known = sums.of({"saved_0": rows[:cut]})
    whole_sum = checksum({"saved_0": rows})
    assert checksum({"saved_0": rows}, known) == whole_sum
    other = rows.copy()
    other[4, 1, 2] = np.nextafter(other[4, 1, 2], 9)
    assert checksum({"saved_0": other}) != whole_sum


def test_a_sum_that_was_interrupted_is_taken_again():
    """Ctrl-C while a file is summed is followed by another file."""

    class Interrupting(np.ndarray):
        def __len__(self):
            raise KeyboardInterrupt

    rows, sums = np.arange(6.0).reshape(3, 2), Sums()
    sums.of({"saved_0": rows[:1]})
    with pytest.raises(KeyboardInterrupt):
        sums.of({"saved_0": rows.view(Interrupting)})
    both = {"saved_0": rows, "saved_1": rows}
    assert checksum(both, sums.of(both)) == checksum(both)


def test_files_of_the_first_schema_are_read(begun):
    """Their checksum was of all bytes at once."""
    scene, state, file = begun
    with np.load(file) as archive:
        arrays = dict(archive)
    arrays.pop("checksum")
    arrays["header"] = np.asarray(str(arrays["header"]).replace('"schema": 2', '"schema": 1'))
    np.savez(file, **arrays, checksum=np.asarray(digest(arrays)))
    assert RunFile(file, 2**30).header["schema"] == 1
    assert bool(whole(scene, state, checkpoint=file, resume=True).status.ok)


def test_a_file_is_what_numpy_would_have_written(tmp_path):
    arrays = {
        "a": np.asarray("text"), "b": np.arange(6.0).reshape(2, 3)[:, ::-1], "c": np.zeros((0, 3)), "d": np.int32(7),
        "e": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    }  # fmt: skip
    with open(tmp_path / "own.npz", "wb") as stream:
        write_arrays(stream, {name: np.asarray(array) for name, array in arrays.items()})
    with np.load(tmp_path / "own.npz") as read:
        assert set(read) == set(arrays)
        for name, array in arrays.items():
            assert read[name].dtype == np.asarray(array).dtype
            np.testing.assert_array_equal(read[name], array)


def test_long_arrays_are_written_in_parts(tmp_path, monkeypatch):
    """With parts of a few bytes, which no array's length is a multiple of."""
    monkeypatch.setattr(npz, "_PART", 48)
    monkeypatch.setattr(os, "posix_fadvise", lambda *told: parts.append(told[1:3]), raising=False)
    parts = []
    arrays = {"a": np.arange(5.0), "b": np.arange(6.0), "c": np.arange(13.0)}
    with open(tmp_path / "own.npz", "wb") as stream:
        write_arrays(stream, arrays)
    assert len(parts) == 2  # of the last one alone, of 104 bytes
    with np.load(tmp_path / "own.npz") as read:
        for name, array in arrays.items():
            np.testing.assert_array_equal(read[name], array)


def test_rows_grow_and_those_before_stay():
    rows = Rows((np.zeros((1, 2)), np.zeros(1, np.int32)))
    count, wanted = 1, [0]
    for length in (0, 1, 3, 40, 2):
        more = np.arange(length + 2.0)
        before = rows.first(count)[1].copy()
        count = rows.put(count, (np.stack([more, more], axis=-1), more.astype(np.int32)), length)
        wanted += list(range(length))
        assert np.array_equal(before, rows.first(count)[1][: len(before)])
    assert count == len(wanted)
    both, one = rows.first(count)
    np.testing.assert_array_equal(both, np.stack([wanted, wanted], axis=-1))
    np.testing.assert_array_equal(one, wanted)
    assert rows.row_bytes == 20
