"""What a run with contact to a tolerance is told, what it counts, and what goes from turn to turn."""

import equinox as eqx

from jaxrb.body.state import State
from jaxrb.integrators.method import Method
from jaxrb.math.arrays import Array, Scalar


class Settings(eqx.Module):
    """How to run: `tolerance` of a step, `longest` step [s]; `order` of a step of contact, most turns (`max_steps`)."""

    method: Method
    tolerance: Scalar
    longest: Scalar
    max_steps: Array
    order: int = eqx.field(static=True)


class StepCounts(eqx.Module):
    """What a run took: steps `accepted` (flights among them) and `rejected`, `impacts`; `smallest` [s] accepted step;
    `error` (n, 2): the sum of all steps' estimated errors, of positions [m] and of attitudes [rad]."""

    accepted: Array
    rejected: Array
    impacts: Array
    smallest: Scalar
    error: Array


class Turn(eqx.Module):
    """What goes from turn to turn. `step`, `flight` [s]: the next lengths to try; `smooth` [s]: the step before trouble
    began; `trouble` [s]: the time by which it was met, with the `excess` of the error of the step of that `length` [s].
    """

    state: State
    mark: Array
    step: Scalar
    flight: Scalar
    smooth: Scalar
    trouble: Scalar
    excess: Scalar
    length: Scalar
    counts: StepCounts
    turns: Array
    reason: Array
