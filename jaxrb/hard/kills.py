"""Killing a long run at random moments, and going on with it: nothing may be lost, and the end has the same bits.

python -m jaxrb.hard.kills --kills 200
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxrb.body.state import State
from jaxrb.hard.case import precision
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.io.checkpoint import RunFile
from jaxrb.io.run import run
from jaxrb.scene.library import double_spring
from jaxrb.scene.scene import Scene

# Compensated sums are carried from step to step; every stretch is written, whatever that costs.
SETTINGS: dict[str, Any] = {
    "dt": 1e-3,
    "save_every": 7,
    "chunk": 50,
    "overhead": 1e9,
    "method": RungeKutta4(compensated=True),
}
_ENDLESS = 10**8


def begun() -> tuple[Scene, State]:
    """Two bricks joined by a spring."""
    example = double_spring()
    return example.scene, example.state()


def child(file: Path) -> None:
    """Go on from `file`, and say after every stretch how far it is, once that is on the disk; until it is killed."""

    def told(done: int, _: int) -> None:
        print(done, flush=True)
        time.sleep(0.002)  # to be killed in

    run(*begun(), steps=_ENDLESS, checkpoint=file, resume=True, progress=told, **SETTINGS)


def kills(count: int, seed: int = 0) -> dict[str, Any]:
    """Kill a run `count` times at random moments, each time going on from its file; what came of it.

    `lost_steps`: of what a run had said to be on the disk, at most. `same_bits`: whether the run gone on with to its
    end is the one that was never killed, in every saved state.
    """
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.npz"
        lost, held, while_writing, after_a_file = 0, 0, 0, 0
        for _ in range(count):
            said = _killed(file, float(random.uniform(0.0, 0.3)))
            while_writing += len(list(Path(folder).glob(".*.partial")))
            if file.exists():
                after_a_file += 1
                held = RunFile(file, 2**32).number("done")
                lost = max(lost, max(said, default=0) - held)
        end = held + 100
        resumed = run(*begun(), steps=end, checkpoint=file, resume=True, **SETTINGS)
    whole = run(*begun(), steps=end, **SETTINGS)
    return {
        "kills": count, "after_a_file": after_a_file, "while_writing": while_writing, "steps": held,
        "lost_steps": lost, "same_bits": _bits(resumed) == _bits(whole), "precision": precision(),
    }  # fmt: skip


def _killed(file: Path, after: float) -> list[int]:
    """What a process said that was killed so many seconds after its second stretch."""
    environment = os.environ | {"JAX_ENABLE_X64": "1" if precision() == "float64" else "0"}
    command = [sys.executable, "-m", "jaxrb.hard.kills", "--go-on", str(file)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = (
            process.stdout.readline() + process.stdout.readline()
        )  # compiled: anything may be under way now
        time.sleep(after)
        process.kill()
        # The last line may be cut.
        return [int(line) for line in (first + process.stdout.read()).split("\n")[:-1]]


def _bits(path: Any) -> bytes:
    leaves = jax.tree.leaves((path.times, path.states, path.final, path.status))
    return b"".join(np.asarray(leaf).tobytes() for leaf in leaves)


def main() -> None:
    """Exit code 1 where something was lost or the bits differ."""
    said = (__doc__ or "").split("\n", 1)[0]
    parser = argparse.ArgumentParser("python -m jaxrb.hard.kills", description=said)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--go-on", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.go_on is not None:
        child(given.go_on)
        sys.exit("it is to be killed before it gets here")
    found = kills(given.kills, given.seed)
    print(json.dumps(found))
    if found["lost_steps"] or not found["same_bits"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
