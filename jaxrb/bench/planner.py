"""How good the planner's picks are: their time against the best that a fine search finds, scene by tolerance."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.pilot import COARSEST_TURN, first_steps
from jaxrb.accuracy.plan import Plan
from jaxrb.accuracy.planner import plan
from jaxrb.accuracy.reference import Reference, end_state, errors, reference
from jaxrb.accuracy.timing import interleaved
from jaxrb.accuracy.work_precision import applicable
from jaxrb.body.state import State
from jaxrb.errors import JaxrbError
from jaxrb.integrators.method import Method
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.library import SCENES, Example

TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9)
GOAL_RATIO, GOAL_SHARE = 1.5, 0.9
_FINER = 2.0**0.25  # one number of steps of the fine search to the next
_TOO_DEAR = 2.5  # the fine search of a method ends where a run takes so many times the pick's


def rows(
    names: Sequence[str] = tuple(SCENES), tolerances: Sequence[float] = TOLERANCES
) -> Iterator[dict[str, Any]]:
    """Each scene and tolerance: the pick, its error against an independent reference, and its time over the best found.

    Tolerances that the reference cannot judge (less than ten times its uncertainty) are left out, and said so.
    """
    for name in names:
        example = SCENES[name]()
        exact = reference(example.scene, example.state(), example.duration)
        for tolerance in tolerances:
            if tolerance < 10.0 * exact.uncertainty.attitude:
                yield _unjudged(name, tolerance, f"the reference knows {exact.uncertainty.attitude:.1e} rad")
                continue
            yield _row(example, exact, tolerance)


def share_within(found: Sequence[dict[str, Any]], ratio: float = GOAL_RATIO) -> float:
    """The share of the judged picks whose time is within `ratio` of the best, and which meet the tolerance."""
    judged = [row for row in found if row["ratio"] != ""]
    return (
        float(np.mean([row["ratio"] <= ratio and row["met"] for row in judged])) if judged else float("nan")
    )


def _unjudged(name: str, tolerance: float, why: str) -> dict[str, Any]:
    blank = {"pick": why, "steps": "", "met": "", "pick_us": "", "best": "", "best_us": "", "ratio": ""}
    return {"scene": name, "tolerance": tolerance} | blank | {"planning_s": ""}


def _row(example: Example, exact: Reference, tolerance: float) -> dict[str, Any]:
    state = example.state()
    try:
        picked = plan(example.scene, state, float(state.time) + example.duration, tolerance)
    except JaxrbError as error:
        return _unjudged(example.name, tolerance, str(error))
    runs = {"pick": (picked.method, picked.steps)}
    for method in applicable(Quaternion):
        steps = fewest_by_search(example, state, exact, method, tolerance, picked)
        if steps is not None:
            runs[f"{type(method).__name__}, {steps}"] = (method, steps)
    times = _times(example, state, list(runs.values()))
    (pick_time, *others), names = times, list(runs)[1:]
    best = int(np.argmin(others)) if others else None
    best_time = pick_time if best is None else min(others[best], pick_time)
    return {
        "scene": example.name,
        "tolerance": tolerance,
        "pick": type(picked.method).__name__,
        "steps": picked.steps,
        # The planner's own judge may differ from this reference by a twentieth of the tolerance.
        "met": _attitude(example, state, exact, picked.method, picked.steps) <= 1.1 * tolerance,
        "pick_us": 1e6 * pick_time,
        "best": "" if best is None else names[best],
        "best_us": 1e6 * best_time,
        "ratio": pick_time / best_time,
        "planning_s": picked.planning_seconds,
    }


def fewest_by_search(
    example: Example, state: State, exact: Reference, method: Method, tolerance: float, picked: Plan
) -> int | None:
    """The fewest steps that meet the tolerance in attitude, trying every number of a fine ladder from below."""
    steps = float(first_steps(example.scene, state, method, example.duration, COARSEST_TURN))
    (cost,) = _times(example, state, [(method, 2000)], 1)
    limit = _TOO_DEAR * picked.seconds / (cost / 2000)
    while steps <= max(limit, 16):
        if _attitude(example, state, exact, method, round(steps)) <= tolerance:
            return round(steps)
        steps = max(steps * _FINER, steps + 1)
    return None


def _run(example: Example, state: State, method: Method, steps: int) -> State:
    return end_state(
        example.scene, state, method, jnp.asarray(example.duration, state.dtype), jnp.asarray(steps)
    )


def _attitude(example: Example, state: State, exact: Reference, method: Method, steps: int) -> float:
    off = errors(example.scene, _run(example, state, method, steps), exact.state)
    return off.attitude if np.isfinite(off.attitude) else float("inf")


def _times(
    example: Example, state: State, runs: Sequence[tuple[Method, int]], rounds: int = 9
) -> list[float]:
    given = jax.device_put((example.scene, state, jnp.asarray(example.duration, state.dtype)))

    def run_of(method: Method, steps: int) -> Any:
        count = jax.device_put(jnp.asarray(steps))
        return lambda: end_state(given[0], given[1], method, given[2], count)

    return interleaved([run_of(method, steps) for method, steps in runs], rounds)
