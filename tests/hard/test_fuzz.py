"""Spoiled files for every reader; and the fuzzer must find what is wrong. `python -m jaxrb.hard.fuzz --count 10000`
reads as many of each as the figures in docs/hard_cases.md are of."""

import dataclasses
import importlib.util
import json
import os
import pathlib
import subprocess
import sys
import time
import warnings

import jax
import numpy as np
import pytest

from jaxrb.body.body import Body
from jaxrb.errors import InvalidInput, JaxrbWarning, LimitExceeded, UnknownName
from jaxrb.geometry.primitives import Sphere
from jaxrb.hard import fuzz as fuzzer
from jaxrb.hard import fuzz_child, fuzz_compiler
from jaxrb.hard.fuzz_formats import FORMATS, spoiled
from jaxrb.io.models import child, load_mjcf

# A model that looks whole is compiled by MuJoCo, in a process of its own.
COUNT = {"scene": 100, "checkpoint": 100, "mjcf": 40, "urdf": 40}
if importlib.util.find_spec("mujoco") is None:
    FORMATS = {name: kind for name, kind in FORMATS.items() if name not in ("mjcf", "urdf")}


@pytest.fixture(scope="module")
def seeds():
    return {name: kind.seeds() for name, kind in FORMATS.items()}


@pytest.mark.parametrize("name", FORMATS)
def test_whole_files_are_read(name, seeds, tmp_path):
    file = tmp_path / f"whole{FORMATS[name].suffix}"
    answers = []
    for data in seeds[name]:
        file.write_bytes(data)
        answers.append(fuzz_child.attempt(name, file))
    # Of the two runs' files one is of a run on its way, which is no record of a failure.
    assert answers == ["", None] if name == "checkpoint" else not any(answers)


@pytest.mark.parametrize("name", FORMATS)
def test_spoiled_files_give_nothing_but_our_errors(name, seeds, tmp_path):
    kind, faults, refused = FORMATS[name], {}, 0
    file = tmp_path / f"spoiled{kind.suffix}"
    everything = [data for own in seeds.values() for data in own]
    count = COUNT.get(name, 300)
    for number in range(count):
        random = np.random.default_rng([1, number])
        file.write_bytes(spoiled(kind, seeds[name], everything, random))
        began = time.process_time()
        fault = fuzz_child.attempt(name, file)
        refused += fault == ""
        if fault or time.process_time() - began > 2.0:
            faults[number] = fault or "slow"
    assert not faults
    assert refused > count / 2


READERS = """
import dataclasses, os, pathlib, sys
import numpy as np
from jaxrb.errors import InvalidInput
from jaxrb.hard import fuzz_child

def read(path):
    data = path.read_bytes()
    if data == b"whole":
        return None
    kind = sum(data) % 16
    if kind < 5:
        raise InvalidInput("no")
    if kind < 9:
        raise KeyError("x")
    if kind < 12:
        return "an answer that is wrong"
    if kind < 15:
        np.ones(2**28)  # twice the memory there is
    os._exit(9)

fuzz_child.FORMATS["stl"] = dataclasses.replace(fuzz_child.FORMATS["stl"], read=read)
fuzz_child.main(pathlib.Path(sys.argv[1]), "stl", *map(int, sys.argv[3:]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux alone")
def test_faults_are_found_and_told_and_a_process_that_dies_is_followed_by_another(monkeypatch, tmp_path):
    script = tmp_path / "readers.py"
    script.write_text(READERS)
    whole = dataclasses.replace(FORMATS["stl"], seeds=lambda: [b"whole"])
    monkeypatch.setattr(fuzzer, "_CHILD", (str(script),))
    monkeypatch.setattr(fuzzer, "FORMATS", {"stl": whole})
    (row,) = fuzzer.fuzz(["stl"], count=40, keep=tmp_path / "kept")
    said = list(row["faults"].values())
    assert any(text.startswith("KeyError at readers.py:") for text in said)
    assert "an answer that is wrong" in said
    assert any("MemoryError" in text for text in said)
    assert any("the process died (9)" in text for text in said)
    assert 10 < len(said) < 35
    kept = {int(file.stem.split("-")[1]): file.read_bytes() for file in (tmp_path / "kept").iterdir()}
    assert set(kept) == set(row["faults"])
    number, text = next(iter(row["faults"].items()))
    assert sum(kept[number]) % 16 >= 5, text


FORKS = """
import json, os, sys, time

from jaxrb.hard.fuzz_compiler import _forked

def main():
    do = sys.stdin.buffer.readline().strip()
    rest = sys.stdin.buffer.read()
    if do == b"sleep":
        time.sleep(60)
    if do == b"die":
        os.kill(os.getpid(), 9)
    if do == b"raise":
        raise KeyError("odd")
    print(len(rest), flush=True)

for do, timeout in ((b"print", 30), (b"die", 30), (b"raise", 30), (b"sleep", 0.3), (b"print", 30)):
    found = _forked(main, do + b"\\n" + b"x" * 300_000, timeout)  # more than a pipe holds
    print(json.dumps([part.decode() for part in found]), flush=True)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="models are compiled in forks where the system has them")
def test_a_fork_answers_as_a_process_of_its_own():
    """What it prints, how it ended, and that it is killed when it takes too long; then the next one."""
    done = subprocess.run([sys.executable, "-c", FORKS], capture_output=True, text=True, check=True)
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert [part[0] for part in told] == ["0", "-9", "1", "null", "0"]
    assert told[0][1] == told[4][1] == "300000\n"
    assert "KeyError" in told[2][2]


@pytest.mark.skipif("mjcf" not in FORMATS, reason="needs mujoco")
def test_models_compiled_in_forks_read_as_models_compiled_in_processes(monkeypatch, tmp_path):
    monkeypatch.setattr(child, "subprocess", child.subprocess)
    file = tmp_path / "model.xml"
    file.write_bytes(FORMATS["mjcf"].seeds()[1])
    here = load_mjcf(file)
    compiler = fuzz_compiler.installed()
    there = load_mjcf(file)
    with pytest.raises(LimitExceeded, match="max_memory"):
        load_mjcf(file, max_memory=2**24)
    with pytest.raises(LimitExceeded, match="timeout"):
        load_mjcf(file, timeout=1e-6)
    load_mjcf(file)
    assert compiler.forks == 4
    compiler.close()
    for one, other in zip(jax.tree.leaves(here.scene), jax.tree.leaves(there.scene), strict=True):
        np.testing.assert_array_equal(one, other)


def warned(path):
    warnings.warn("odd", RuntimeWarning if "foreign" in path.name else JaxrbWarning, stacklevel=1)


def test_warnings_are_ours_or_faults(monkeypatch, tmp_path):
    monkeypatch.setitem(FORMATS, "stl", dataclasses.replace(FORMATS["stl"], read=warned))
    assert fuzz_child.attempt("stl", tmp_path / "foreign.stl") == "RuntimeWarning: odd"
    assert fuzz_child.attempt("stl", tmp_path / "own.stl") is None


def test_command_says_what_it_found(monkeypatch, capsys):
    row = {"format": "stl", "files": 5, "refused": 4, "slowest_s": 0.5, "slowest": 3, "grown_bytes": 2**20}
    monkeypatch.setattr(fuzzer, "fuzz", lambda *_, **__: [row | {"faults": {3: "ValueError"}}])
    monkeypatch.setattr(sys, "argv", ["fuzz", "--format", "stl"])
    with pytest.raises(SystemExit):
        fuzzer.main()
    assert "FAULT stl 3: ValueError" in capsys.readouterr().out
    monkeypatch.setattr(fuzzer, "fuzz", lambda *_, **__: [row | {"faults": {}}])
    monkeypatch.setattr(sys, "argv", ["fuzz", "--json"])
    fuzzer.main()
    assert json.loads(capsys.readouterr().out)[0]["refused"] == 4


def test_a_format_that_does_not_exist_is_refused():
    with pytest.raises(UnknownName, match="there are npz, csv"):
        fuzzer.fuzz(["docx"])


def test_faults_found_once_stay_mended(tmp_path):
    """Found by the fuzzer: a text of 34 bytes whose missing count of triangles was taken for −1."""
    file = tmp_path / "short.stl"
    file.write_bytes(b"solid box\nfacet normal 0 0 1\nouter".ljust(34)[:34])
    with pytest.raises(InvalidInput, match="endsolid"):
        FORMATS["stl"].read(pathlib.Path(file))


@pytest.mark.parametrize("far", [1e200, 1e-3])
def test_a_centre_beyond_what_can_be_squared_is_told_as_outside(far):
    """Found by the fuzzer: NumPy complained of an overflow where the centre of mass was looked at."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Body(1.0, 1.0, Sphere(0.1), (far, 0.0, 0.0))
    said = [(w.category, "outside the body" in str(w.message)) for w in caught]
    assert said == ([(JaxrbWarning, True)] if far > 1 else [])
