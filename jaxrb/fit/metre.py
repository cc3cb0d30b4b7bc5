"""The metre of a recording as a nuisance: lengths read (1 + s) times too long make free fall (1 + s) times too fast.

Rotations do not see it, so it is found from the free fall alone, and that is the joint fit. Host side.
"""

from dataclasses import dataclass

import numpy as np

from jaxrb.errors import NotIdentifiable
from jaxrb.fit.flights import STANDARD_GRAVITY
from jaxrb.fit.free_fall import FreeFall
from jaxrb.fit.selection import Tried

METRIC_SCALE = "metric_scale"
# [m/s²] from the equator to the poles it goes from 9.780 to 9.832: evenly spread over that where nobody said.
_GRAVITY_SPREAD = (9.832 - 9.780) / np.sqrt(12.0)


@dataclass(frozen=True)
class Metre:
    """Relative error s of the recorded lengths with its standard error, and the test of whether it is there."""

    value: float
    error: float
    tried: Tried


def metric_scale(
    fall: FreeFall | None, gravity: float, belief: tuple[float, float] | None, source: str
) -> Metre:
    """From the free fall that was recorded and the one that is expected; a belief is weighed by its precision.

    Raises:
        NotIdentifiable: without an acceleration over at least two tosses.
    """
    if fall is None:
        raise NotIdentifiable(
            f"{source}: the metre shows in the free fall of at least two tosses with positions, and there are not so "
            "many. Leave metric_scale out of nuisances."
        )
    unsure = _GRAVITY_SPREAD if gravity == STANDARD_GRAVITY else 0.0
    seen, error = fall.magnitude / gravity - 1.0, float(np.hypot(fall.magnitude_error, unsure)) / gravity
    # Tosses are what is independent here, so the criterion counts them and not their samples.
    ratio, threshold = (seen / error) ** 2, float(np.log(fall.tosses))
    tried = Tried(METRIC_SCALE, ratio, threshold, ratio > threshold)
    if belief is None:
        return Metre(seen, error, tried)
    weights = np.array([error, belief[1]]) ** -2.0
    value = float(weights @ [seen, belief[0]] / weights.sum())
    return Metre(value, float(weights.sum() ** -0.5), tried)
