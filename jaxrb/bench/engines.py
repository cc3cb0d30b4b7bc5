"""jaxrb beside its peers in one run: the same worlds of one body in each, each in a process of its own, taking turns.

MuJoCo's C (its own `rollout`), MJX, Brax (its positional dynamics), diffrax and heyoka (Taylor series) on the equations
of a free body. Those that this Python has not are looked for in the one that JAXRB_PEERS_PYTHON names. Ratios are
jaxrb's time over the peer's, round by round, so that a busy moment hits both: median, least and most over the rounds.
coal has no dynamics; `--what collision` has it.

    JAXRB_PEERS_PYTHON=/path/to/python jaxrb bench --what engines
"""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxrb.bench import engine_child
from jaxrb.body.body import Body
from jaxrb.draws import drawn
from jaxrb.scene.flight import free_flight
from jaxrb.scene.scene import Scene

PYTHON = "JAXRB_PEERS_PYTHON"
ROUNDS = 5
ENGINES = ("jaxrb", "mujoco", "diffrax", "heyoka", "mjx", "brax")
_MODULES = {"mjx": "mujoco.mjx"}
_FREE_ONLY = ("diffrax", "heyoka")
_HALF = (0.1, 0.15, 0.2)


def rows(
    rounds: int = ROUNDS,
    engines: Sequence[str] = ENGINES,
    worlds: int = 256,
    kinds: Sequence[str] = ("free", "box"),
) -> Iterator[dict[str, Any]]:
    """One row for each workload and engine."""
    for kind in kinds:
        yield from _raced({"free": _free, "box": _box}[kind](worlds), rounds, engines)


def _raced(work: dict[str, Any], rounds: int, engines: Sequence[str]) -> Iterator[dict[str, Any]]:
    running: dict[str, _Engine] = {}
    why: dict[str, str] = {}
    for name in engines:
        if work["kind"] != "free" and name in _FREE_ONLY:
            continue
        try:
            running[name] = _Engine(name, work)
        except (OSError, RuntimeError) as error:  # said in its row
            why[name] = str(error)
    seconds = {name: np.empty(rounds) for name in running}
    try:
        for i in range(rounds):
            for name, engine in running.items():
                seconds[name][i] = engine.ask("run")["cpu_s"]
        exact = _exact(work)
        for name in (*running, *why):
            yield _row(work, name, running.get(name), seconds, exact, why.get(name, ""))
    finally:
        for engine in running.values():
            engine.close()


def _row(
    work: dict[str, Any],
    name: str,
    engine: "_Engine | None",
    seconds: dict[str, np.ndarray],
    exact: Any,
    why: str,
) -> dict[str, Any]:
    row: dict[str, Any] = {"workload": work["name"], "engine": name}
    if engine is None:
        return row | dict.fromkeys(COLUMNS, "") | {"note": why}
    spent, ended = seconds[name], engine.ask("end")
    ratio = seconds["jaxrb"] / spent if "jaxrb" in seconds else np.full(len(spent), np.nan)
    slope = engine.ask("gradient")["cpu_s"]
    median = float(np.median(spent))
    return row | {
        "body-steps/CPU s": len(work["q"]) * work["steps"] / median,
        "error": _error(work, np.asarray(ended["end"]), exact),
        "unit": "rad" if work["kind"] == "free" else "mm of overlap",
        "jaxrb/peer": float(np.median(ratio)),
        "least": float(ratio.min()),
        "most": float(ratio.max()),
        "gradient/run": "" if slope is None else slope / median,
        "compile [CPU s]": engine.ready["compile_cpu_s"],
        "start to first [CPU s]": engine.ready["from_start_cpu_s"],
        "peak [MB]": ended["peak_mb"],
        "note": "" if slope is not None else "no derivative",
    }


COLUMNS = (
    "body-steps/CPU s", "error", "unit", "jaxrb/peer", "least", "most", "gradient/run", "compile [CPU s]",
    "start to first [CPU s]", "peak [MB]", "note",
)  # fmt: skip


class _Engine:
    """The program `engine_child` in a Python that has the engine.

    Raises:
        RuntimeError: neither this Python nor that of JAXRB_PEERS_PYTHON has it, or it fails; in words.
    """

    def __init__(self, name: str, work: dict[str, Any]):
        python = _python_with(name)
        wide = str(int(jax.config.read("jax_enable_x64")))
        self.process = subprocess.Popen(
            [python, "-W", "ignore", str(Path(engine_child.__file__)), name], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "JAX_ENABLE_X64": wide, "JAX_PLATFORMS": jax.default_backend()},
        )  # fmt: skip
        self.ready = self.ask(json.dumps(work))

    def ask(self, line: str) -> dict[str, Any]:
        """The answer to a line."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        with contextlib.suppress(BrokenPipeError):  # what it said before it ended is told below
            print(line, file=self.process.stdin, flush=True)
        while answer := self.process.stdout.readline():
            if answer.startswith("{"):  # some print a greeting first
                return json.loads(answer)
        told = self.process.stderr.read().strip().splitlines()
        raise RuntimeError(told[-1] if told else f"ended with {self.process.wait()}")

    def close(self) -> None:
        """End it."""
        self.process.communicate()


def _python_with(name: str) -> str:
    module = _MODULES.get(name, name)
    for python in dict.fromkeys((sys.executable, os.environ.get(PYTHON, sys.executable))):
        done = subprocess.run(
            [python, "-W", "ignore", "-c", f"import {module}"], capture_output=True, check=False
        )
        if done.returncode == 0:
            return python
    raise RuntimeError(f"not installed; {PYTHON} may name a Python that has it")


def _starts(worlds: int, height: float) -> dict[str, Any]:
    random = drawn(0)
    turn = random.normal(size=(worlds, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    place = np.tile([0.0, 0.0, height], (worlds, 1))
    return {
        "q": np.concatenate([place, turn], axis=1).tolist(),
        "v": random.normal(size=(worlds, 6)).tolist(),
    }


def _work(name: str, kind: str, dt: float, steps: int, gravity: float) -> dict[str, Any]:
    x, y, z = (h * h for h in _HALF)
    mass = 500.0 * 8 * float(np.prod(_HALF))
    moments = [mass / 3 * s for s in (y + z, x + z, x + y)]
    return {
        "name": name, "kind": kind, "mass": mass, "moments": moments, "half": list(_HALF), "dt": dt, "steps": steps,
        "friction": 0.5, "gravity": gravity,
    }  # fmt: skip


def _free(worlds: int) -> dict[str, Any]:
    return _work(f"free flight, {worlds} worlds, 2 s", "free", 0.01, 200, 0.0) | _starts(worlds, 1.0)


def _box(worlds: int) -> dict[str, Any]:
    return _work(f"a box on a floor, {worlds} worlds, 1 s", "box", 2e-3, 500, -9.81) | _starts(worlds, 0.35)


def _exact(work: dict[str, Any]) -> np.ndarray | None:
    """Turns (w, 4) at the end of free flight, from its closed form in float64."""
    if work["kind"] != "free":
        return None
    with jax.enable_x64(True):
        body = Body(work["mass"], tuple(work["moments"]))
        q, v = np.asarray(work["q"]), np.asarray(work["v"])
        scene = Scene(tuple(body for _ in q))
        state = scene.state(q[:, :3], orientation=q[:, 3:], angular_velocity=v[:, 3:])
        end = free_flight(scene, state, work["dt"] * work["steps"])
        return np.asarray(end.orientation.as_quaternion_array())


def _error(work: dict[str, Any], end: np.ndarray, exact: np.ndarray | None) -> float:
    """The worst attitude error [rad], or how far [mm] the lowest corner of any box is below the floor."""
    turn = end[:, 3:] / np.linalg.norm(end[:, 3:], axis=1, keepdims=True)
    if exact is not None:
        apart = np.minimum(np.linalg.norm(turn - exact, axis=1), np.linalg.norm(turn + exact, axis=1))
        return float(2 * apart.max())
    w, x, y, z = turn.T
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    lowest = end[:, 2] - np.abs(up) @ np.asarray(work["half"])
    return 1e3 * float(np.maximum(-lowest, 0.0).max())
