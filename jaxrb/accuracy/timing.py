"""CPU time of calls. Machines are shared: medians, and calls that are compared take turns."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

LEAST_SAMPLE = 2e-3  # [s]: shorter runs are repeated within one reading of the clock


def cpu_seconds(run: Callable[[], Any], repeats: int = 5) -> float:
    """Median CPU time of this process [s] for one call that is already compiled."""
    start = time.process_time()
    jax.block_until_ready(run())
    once = max(time.process_time() - start, 1e-6)
    calls = max(1, int(LEAST_SAMPLE / once))
    samples = []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(calls):
            done = run()
        jax.block_until_ready(done)
        samples.append((time.process_time() - start) / calls)
    return float(np.median(samples))


def compiled(function: Any, *arguments: Any) -> tuple[Any, float, int]:
    """A jitted function compiled for its arguments, the CPU time of that [s], and the program's scratch memory [B]."""
    start = time.process_time()
    program = function.lower(*arguments).compile()
    seconds = time.process_time() - start
    memory = program.memory_analysis()
    return program, seconds, int(getattr(memory, "temp_size_in_bytes", 0) or 0)


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
