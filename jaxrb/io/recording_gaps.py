"""Samples that an instrument lost, repeated or wrote out of order: left out and counted, not filled in. Host side."""

import numpy as np

from jaxrb.errors import InvalidInput

MISSING, REPEATED = "samples with missing values", "samples whose time repeats or runs back"
RESTARTED = "tosses that begin where time starts again"


def without_gaps(
    arrays: dict[str, np.ndarray], lengths: np.ndarray, source: str
) -> tuple[dict[str, np.ndarray], np.ndarray, dict[str, int]]:
    """Arrays (N, …) and lengths (T,) without such samples, and how many there were by reason.

    Where time falls back by more than half of what has passed since the toss began, another toss begins: some loggers
    start their clock again. Tosses of fewer than two samples that are left go too.

    Raises:
        InvalidInput: if nothing is left.
    """
    whole = np.all([np.isfinite(a).reshape(len(a), -1).all(axis=1) for a in arrays.values()], axis=0)
    keep, toss, number, found = (
        whole.copy(),
        np.full(len(whole), -1),
        0,
        dict.fromkeys((REPEATED, RESTARTED), 0),
    )
    for a, b in zip(np.cumsum(lengths) - lengths, np.cumsum(lengths)):
        first = last = -np.inf
        for k in range(a, b):
            if not whole[k]:
                continue
            now = arrays["time"][k]
            if not np.isfinite(first):
                first = now
            elif now <= last:
                if last - now <= 0.5 * (last - first):
                    keep[k] = False
                    found[REPEATED] += 1
                    continue
                number, first = number + 1, now
                found[RESTARTED] += 1
            last, toss[k] = now, number
        number += 1
    counts = np.bincount(toss[keep], minlength=number) if keep.any() else np.zeros(0, int)
    keep &= np.isin(toss, np.flatnonzero(counts >= 2))
    if not keep.any():
        raise InvalidInput(f"{source}: no two samples in a row are whole and in order of time.")
    left_out = {MISSING: int(np.sum(~whole)), **found}
    return (
        {name: array[keep] for name, array in arrays.items()},
        counts[counts >= 2],
        {reason: count for reason, count in left_out.items() if count},
    )
