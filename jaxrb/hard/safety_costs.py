"""What safety costs: the watch over every step, and the files of a long run. Shares of the CPU time of a run.

python -m jaxrb.hard.safety_costs
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import numpy as np
from jax import lax

from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.compilation import compiler_options
from jaxrb.draws import drawn
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.integrators.semi_implicit import SemiImplicitEuler
from jaxrb.io import run_work
from jaxrb.io.run import run
from jaxrb.scene.contact_library import CONTACT_SCENES
from jaxrb.scene.library import double_spring
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.tables import table

GUARD, FILES = 0.10, 0.01  # shares that they may take
Start = tuple[Scene, State, Method, int]


def free_bodies(count: int, method: Method, steps: int) -> Start:
    """Free bodies with principal inertia, each with a spin of its own."""
    spin = drawn(0).normal(size=(count, 3))
    scene = Scene(replicate(Body(1.0, (1.0, 2.0, 2.5)), count))
    return scene, scene.state(angular_velocity=spin.tolist()), method, steps


def scenes() -> Iterator[tuple[str, Callable[[], Start]]]:
    """By name: the cheapest steps there are, where a watch weighs most, and dearer ones.

    Of some hundredths of a second each: what a call costs on the host, 0.2 to 0.4 ms, is no part of a watch over steps.
    """
    yield "one free body, semi-implicit Euler", lambda: free_bodies(1, SemiImplicitEuler(), 1_000_000)
    yield "1000 free bodies, semi-implicit Euler", lambda: free_bodies(1000, SemiImplicitEuler(), 10_000)
    yield "1000 free bodies, RK4", lambda: free_bodies(1000, RungeKutta4(), 10_000)

    def sprung() -> Start:
        example = double_spring()
        return example.scene, example.state(), RungeKutta4(), 20_000

    yield "two bricks on a spring, RK4", sprung

    def blocks() -> Start:
        example = CONTACT_SCENES["block_on_incline"]()
        return example.scene, example.state(), RungeKutta4(), 2000

    yield "block on an incline, contact", blocks


def watched(scene: Scene, state: State, method: Method, steps: int) -> Callable[[], Any]:
    """The run as `rollout` makes it, which counts each body's finite steps and judges in the end."""
    return lambda: (
        rollout(scene, state, dt=1e-3, steps=steps, save_every=steps, method=method, on_error="flag").final
    )


def unwatched(scene: Scene, state: State, method: Method, steps: int) -> Callable[[], Any]:
    """The same steps in a loop that looks at nothing and counts nothing, not even the time."""

    def stepped(scene: Scene, state: State, dt: Any) -> State:
        dynamics = scene.prepared(state.dtype)

        def one(carry: tuple, _: None) -> tuple[tuple, None]:
            return method.carried_step(dynamics, carry[0], carry[1], dt, None), None

        start = (state, method.first_carry(dynamics, state))
        return lax.scan(one, start, None, length=steps)[0][0]

    program = jax.jit(stepped, compiler_options=compiler_options())
    dt = np.asarray(1e-3, state.dtype)
    return lambda: program(scene, state, dt)


def guard(rounds: int = 15) -> Iterator[dict[str, Any]]:
    """For each scene the share of a run's CPU time that the watch takes: median and quartiles of `rounds` pairs."""
    for name, start in scenes():
        both = [make(*start()) for make in (unwatched, watched)]
        for make in both:
            jax.block_until_ready(make())
        shares = []
        for _ in range(rounds):
            bare, whole = (_cpu(make) for make in both)
            shares.append(1 - bare / whole)
        yield _row(f"watch: {name}", shares, GUARD)


def files(rounds: int = 5, seconds: float = 20.0) -> Iterator[dict[str, Any]]:
    """The share of a run's time that its files take, of the processor and of the clock: counted inside `rounds` runs of
    about so many seconds each."""
    # Half a megabyte of states a second, and five; what comes faster is an output, of which files are the purpose.
    cases = (
        ("100 bodies, every 10 000th step saved", free_bodies(100, RungeKutta4(), 0), 10_000),
        ("1000 bodies, every 1000th step saved", free_bodies(1000, RungeKutta4(), 0), 1000),
    )
    for name, (scene, state, method, _), every in cases:
        steps = every * 10
        began = time.perf_counter()
        while time.perf_counter() - began < 1.0:  # the pace, compilation left out
            steps, began = 2 * steps, time.perf_counter()
            run(scene, state, dt=1e-3, steps=steps, save_every=every, method=method)
        steps = round(steps * seconds / (time.perf_counter() - began) / every) * every
        found = [_of_files(scene, state, method, steps, every) for _ in range(rounds)]
        yield _row(f"files: {name}, CPU", [cpu for cpu, _, _ in found], FILES)
        writes = int(np.median([count for _, _, count in found]))
        yield _row(f"files: {name}, clock ({writes} files a run)", [wall for _, wall, _ in found], FILES)


def _of_files(scene: Scene, state: State, method: Method, steps: int, every: int) -> tuple[float, float, int]:
    """Share of CPU and of wall time spent in writing, and how many files there were."""
    spent = np.zeros(2)
    count = 0
    real = run_work.Work._write

    def timed(*arguments: Any) -> None:
        nonlocal count
        start = np.asarray([time.process_time(), time.perf_counter()])
        real(*arguments)
        spent[:] += np.asarray([time.process_time(), time.perf_counter()]) - start
        count += 1

    with tempfile.TemporaryDirectory() as folder, mock.patch.object(run_work.Work, "_write", timed):
        start = np.asarray([time.process_time(), time.perf_counter()])
        run(
            scene, state, dt=1e-3, steps=steps, save_every=every, method=method,
            checkpoint=Path(folder) / "run.npz",
        )  # fmt: skip
        whole = np.asarray([time.process_time(), time.perf_counter()]) - start
    return float(spent[0] / whole[0]), float(spent[1] / whole[1]), count


def _cpu(make: Callable[[], Any], least: float = 0.05) -> float:
    """CPU seconds of a call, of several where one is short."""
    start, calls = time.process_time(), 0
    while (spent := time.process_time() - start) < least:
        jax.block_until_ready(make())
        calls += 1
    return spent / calls


def _row(name: str, shares: list[float], limit: float) -> dict[str, Any]:
    low, middle, high = np.percentile(shares, (25, 50, 75))
    return {"what": name, "share": float(middle), "low": float(low), "high": float(high), "limit": limit}


def main() -> None:
    """Print the shares; exit code 1 where a median is beyond its limit."""
    said = (__doc__ or "").split("\n", 1)[0]
    parser = argparse.ArgumentParser("python -m jaxrb.hard.safety_costs", description=said)
    parser.add_argument("--seconds", type=float, default=20.0, help="of a run with files")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows = [*guard(), *files(seconds=given.seconds)]
    if given.json:
        print(json.dumps(rows))
    else:
        lines = [
            {
                "what": row["what"], "share": f"{100 * row['share']:.2f} %",
                "quartiles": f"{100 * row['low']:.2f} to {100 * row['high']:.2f}",
                "limit": f"{100 * row['limit']:g} %",
            }
            for row in rows
        ]  # fmt: skip
        print(table(lines))
    if any(row["share"] > row["limit"] for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
