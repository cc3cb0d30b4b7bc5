"""CPU and wall time of a call, side by side."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np


def both_clocks(run: Callable[[], Any], repeats: int = 3) -> tuple[float, float]:
    """Median CPU seconds of this process and median wall seconds of a call that is already compiled."""
    jax.block_until_ready(run())
    samples = []
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        jax.block_until_ready(run())
        samples.append((time.process_time() - cpu, time.perf_counter() - wall))
    cpu, wall = np.median(samples, axis=0)
    return float(cpu), float(wall)


def cpu_of_first(run: Callable[[], Any]) -> float:
    """CPU seconds of a first call: trace, compile and run."""
    start = time.process_time()
    jax.block_until_ready(run())
    return time.process_time() - start


def interleaved(runs: Sequence[Callable[[], Any]], rounds: int = 9, least: float = 2e-3) -> list[float]:
    """Median CPU seconds of each of several calls, taken in turns so that a busy moment hits all of them alike."""
    calls = []
    for run in runs:
        jax.block_until_ready(run())
        calls.append(max(1, int(least / max(cpu_of_first(run), 1e-6))))
    samples = np.empty((rounds, len(runs)))
    for i in range(rounds):
        for j, (run, count) in enumerate(zip(runs, calls)):
            start = time.process_time()
            for _ in range(count):
                done = run()
            jax.block_until_ready(done)
            samples[i, j] = (time.process_time() - start) / count
    return [float(x) for x in np.median(samples, axis=0)]
