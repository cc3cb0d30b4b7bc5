"""The same bits: hashes of the ends of built-in scenes, in fresh processes, and kept from release to release of JAX.

    python -m jaxrb.hard.same_bits --processes 20
    python -m jaxrb.hard.same_bits --write

XLA makes of one program different instructions for different processors, so hashes are kept by the release of JAX, the
floating type and what the processor can do; where none are kept there is nothing to compare with, and it is said.
"""

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.hard.case import precision
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.scene.library import SCENES, example_of
from jaxrb.scene.rollout import rollout

STEPS = 200
KEPT = Path(__file__).with_name("state_hashes.json")
QUICKEST = ("tumbling_brick", "double_spring")
CONTACT = ("bouncing_ball", "block_on_incline")


def end_of(name: str) -> str:
    """SHA-256 of every bit of a scene's state after 200 steps of RK4, of its own length or a thousandth of its span."""
    example = example_of(name)
    state = example.state()
    method, dt, _ = example.steps(state, RungeKutta4())
    path = rollout(example.scene, state, dt=dt, steps=STEPS, save_every=STEPS, method=method)
    found = hashlib.sha256()
    for leaf in jax.tree.leaves(path.final):
        found.update(np.asarray(leaf).tobytes())
    return found.hexdigest()


def ends(names: Sequence[str]) -> dict[str, str]:
    """The hash of each scene, computed in this process."""
    return {name: end_of(name) for name in names}


def in_fresh_processes(names: Sequence[str], count: int) -> list[dict[str, str]]:
    """What so many processes say, one after the other, each compiling anew."""
    environment = os.environ | {"JAX_ENABLE_X64": "1" if precision() == "float64" else "0"}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-m", "jaxrb.hard.same_bits", "--one", *names]
    found = []
    for _ in range(count):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found.append(json.loads(done.stdout.splitlines()[-1]))
    return found


def place() -> str:
    """The key of this release, floating type and processor."""
    return f"jax {jax.__version__}, {precision()}, {platform.machine()} {_features()}"


def _features() -> str:
    """Which vectors the processor has, which is what XLA's instructions depend on."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return "unknown"
    flags = set(next((line for line in text.splitlines() if line.startswith("flags")), "").split())
    return next((name for name in ("avx512f", "avx2", "avx") if name in flags), "unknown")


def kept() -> dict[str, dict[str, str]]:
    """The hashes that are kept, by `place` and scene.

    Raises:
        InvalidInput: the file that holds them is damaged.
    """
    try:
        return json.loads(KEPT.read_text())
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{KEPT}: cannot be read ({error}); install jaxrb again") from error


def changed(found: dict[str, str]) -> list[str] | None:
    """The scenes whose bits are not those that were kept for this place; None where none were."""
    old = kept().get(place())
    if old is None:
        return None
    return sorted(name for name, digest in found.items() if name in old and old[name] != digest)


def _report(found: list[dict[str, str]]) -> dict[str, Any]:
    differing = sorted(name for name in found[0] if len({one[name] for one in found}) > 1)
    return {"place": place(), "processes": len(found), "scenes": list(found[0]), "differing": differing,
            "changed_since_kept": changed(found[0])}  # fmt: skip


def main() -> None:
    """Exit code 1 where processes differ among each other or from the hashes that are kept."""
    said = (__doc__ or "").split("\n", 1)[0]
    parser = argparse.ArgumentParser("python -m jaxrb.hard.same_bits", description=said)
    parser.add_argument("--processes", type=int, default=3)
    parser.add_argument("--scenes", nargs="+", default=[*SCENES, *CONTACT])
    parser.add_argument("--write", action="store_true", help="keep the hashes of this place")
    parser.add_argument("--one", nargs="+", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(ends(given.one)))
        return
    found = in_fresh_processes(given.scenes, given.processes)
    if given.write:
        everything = kept() | {place(): found[0]}
        KEPT.write_text(json.dumps(everything, indent=1, sort_keys=True) + "\n")
    report = _report(found)
    print(json.dumps(report))
    if report["differing"] or report["changed_since_kept"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
