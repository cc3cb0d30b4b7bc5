"""CPU time of calls, or time by the clock on an accelerator. Machines are shared: medians, and calls that are compared
take turns."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

LEAST_SAMPLE = 2e-3  # [s]: shorter runs are repeated within one reading of the clock


def clock() -> float:
    """[s] CPU time of this process; time by the clock where a device does the work and the CPU only waits."""
    return time.process_time() if jax.default_backend() == "cpu" else time.perf_counter()


def cpu_seconds(run: Callable[[], Any], repeats: int = 5) -> float:
    """Median CPU time of this process [s] for one call that is already compiled."""
    start = clock()
    jax.block_until_ready(run())
    once = max(clock() - start, 1e-6)
    calls = max(1, int(LEAST_SAMPLE / once))
    samples = []
    for _ in range(repeats):
        start = clock()
        for _ in range(calls):
            done = run()
        jax.block_until_ready(done)
        samples.append((clock() - start) / calls)
    return float(np.median(samples))


def compiled(function: Any, *arguments: Any) -> tuple[Any, float, int]:
    """A jitted function compiled for its arguments, the CPU time of that [s], and the program's scratch memory [B]."""
    start = clock()
    program = function.lower(*arguments).compile()
    seconds = clock() - start
    memory = program.memory_analysis()
    return program, seconds, int(getattr(memory, "temp_size_in_bytes", 0) or 0)


def cpu_of_first(run: Callable[[], Any]) -> float:
    """CPU seconds of a first call: trace, compile and run."""
    start = clock()
    jax.block_until_ready(run())
    return clock() - start


def interleaved(runs: Sequence[Callable[[], Any]], rounds: int = 9, least: float = 2e-3) -> list[float]:
    """Median CPU seconds of each of several calls, taken in turns so that a busy moment hits all of them alike."""
    return [float(x) for x in np.median(in_turns(runs, rounds, least), axis=0)]


def in_turns(runs: Sequence[Callable[[], Any]], rounds: int = 5, least: float = 2e-3) -> np.ndarray:
    """CPU seconds (rounds, runs) of each call in each round."""
    calls = []
    for run in runs:
        jax.block_until_ready(run())
        calls.append(max(1, int(least / max(cpu_of_first(run), 1e-6))))
    samples = np.empty((rounds, len(runs)))
    for i in range(rounds):
        for j, (run, count) in enumerate(zip(runs, calls)):
            start = clock()
            for _ in range(count):
                done = run()
            jax.block_until_ready(done)
            samples[i, j] = (clock() - start) / count
    return samples
