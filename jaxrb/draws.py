"""Random numbers of scenes and measurements: the same in every run, others for another seed."""

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

import numpy as np

_SEED: ContextVar[int] = ContextVar("seed", default=0)


def drawn(stream: int = 0) -> np.random.Generator:
    """The generator of that number, a stream of its own for each seed within `seeded`."""
    seed = _SEED.get()
    return np.random.default_rng([seed, stream] if seed else stream)


@contextlib.contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Within it `drawn` follows this seed (`--seed` of the command line); 0 is that of every published figure."""
    token = _SEED.set(seed)
    try:
        yield
    finally:
        _SEED.reset(token)
