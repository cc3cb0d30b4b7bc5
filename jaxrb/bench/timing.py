"""CPU and wall time of a call, side by side."""

import time
from collections.abc import Callable
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
