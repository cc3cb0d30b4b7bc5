"""The cheapest method and step that meet a tolerance, with the evidence."""

import dataclasses
import math
import os
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxrb.accuracy import plan_cache
from jaxrb.accuracy.pilot import (
    MOST_STEPS,
    Pilot,
    constant_of,
    fewest_steps,
    judge_of,
    observed_order,
    predicted,
)
from jaxrb.accuracy.plan import Evidence, Plan
from jaxrb.accuracy.timing import cpu_seconds
from jaxrb.accuracy.work_precision import applicable
from jaxrb.body.inertia import SphericalInertia
from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import InvalidInput, JaxrbError, WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import check_tolerance

# A method is not even compiled where it could not win if it cost this part of a Runge–Kutta step (the other at order 1)
# and its error constant were this part of what the motion suggests. Measured costs: 0.8 and more; 0.1.
_CHEAPEST_STEP, _CHEAPEST_EULER_STEP, _SMALLEST_CONSTANT = 0.3, 0.1, 0.03
# Every method compiled costs one to three seconds. These won somewhere when `jaxrb bench --planner` ran with all as
# candidates, on one machine; no other was faster there than the pick by more than the clock's noise.
PROMISING = (
    "RungeKutta4",
    "ThreeAxisSplitting4",
    "ThreeAxisSplitting",
    "VelocityVerlet",
    "SemiImplicitEuler",
)
_HOPELESS = 2.0  # a pilot is given up where it needs so many times the best time


def plan(
    scene: Scene,
    state: State,
    t1: float,
    tolerance: float,
    *,
    methods: Sequence[Method | str] | str | None = None,
    cache: str | os.PathLike | None = None,
) -> Plan:
    """The cheapest method and step with which a run from `state` to `t1` [s] errs by at most `tolerance` at its end.

    The tolerance holds for the attitude [rad] and the position (relative to the distance travelled) of the worst body,
    and for the energy (relative). Each method is run at two step sizes or a few more; its error is measured against
    Runge–Kutta 4 in float64, steps halved until its own estimated error is a twentieth of the tolerance. What is
    returned was run, compared and timed, in the precision and representation of `state`. Methods that cannot win are
    given up early, and `evidence` says so. Nothing is random; times are CPU times of this process.

    Args:
        t1: later than `state.time`.
        tolerance: between 0 and 1.
        methods: candidates; by default those of `PROMISING` that apply, with "all" every one (more to compile).
        cache: a folder of your own that keeps plans between programs (created for you alone to read; off by default).
            Within a program plans are always kept, by machine, scene and start.

    Raises:
        InvalidInput: no method meets the tolerance in this precision, or round-off or chaos hide whether one does.
        WrongStructure: called while being traced; no candidate applies.
    """
    check_fit(scene, state)
    _refuse_contact(scene)
    check_tolerance("plan: tolerance", tolerance)
    duration = duration_of("plan", scene, state, t1)
    candidates = _candidates(state, methods)
    if scene.jointed:  # what is left out refuses joints itself, and says why
        candidates = [method for method in candidates if method.takes_joints] or candidates
    question = plan_cache.question(scene, state, duration, tolerance, candidates)
    known = plan_cache.recall(question, candidates, cache)
    if known is None:
        known = _planned(scene, state, duration, float(tolerance), candidates)
        plan_cache.keep(question, candidates, known, cache)
    return known


def _refuse_contact(scene: Scene) -> None:
    if any(isinstance(effect, RigidContact) for effect in scene.effects):
        raise WrongStructure(
            "plan: with RigidContact each impact, stick and slip falls elsewhere into a step, and no power law tells "
            "how many steps a tolerance needs; use rb.solve_contact(scene, state, t1=…, tolerance=…), which finds its "
            "steps as it goes"
        )


def duration_of(who: str, scene: Scene, state: State, t1: Any) -> float:
    """The time [s] from a state to `t1`, of numbers that are known and in order."""
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, state, t1))):
        raise WrongStructure(
            f"{who}: cannot run inside jit, grad or vmap; plan outside, and use its method and steps"
        )
    duration = float(t1) - float(state.time)
    if not (np.isfinite(duration) and duration > 0):
        raise InvalidInput(
            f"{who}: t1 is {t1!r} s, but must be finite and later than the state's {float(state.time)} s"
        )
    return duration


def _candidates(state: State, methods: Sequence[Method | str] | str | None) -> list[Method]:
    fitting = applicable(type(state.orientation))
    if methods is None or methods == "all":
        if methods is None:
            fitting = [method for method in fitting if type(method).__name__ in PROMISING]
        # Runge–Kutta first: the others are measured against it.
        return sorted(fitting, key=lambda m: (not isinstance(m, RungeKutta4), -m.order))
    wanted = [method_of(method) for method in ([methods] if isinstance(methods, str) else methods)]
    names = {type(method) for method in fitting}
    chosen = [method for method in wanted if type(method) in names]
    if not chosen:
        raise WrongStructure(
            f"plan: none of {methods!r} works on {state.orientation.name}; leave `methods` out"
        )
    return chosen


def _planned(scene: Scene, state: State, duration: float, tolerance: float, candidates: list[Method]) -> Plan:
    start = time.process_time()
    judge = judge_of(scene, state, duration, tolerance)
    pilot = Pilot(scene, state, duration, tolerance, judge)
    exact_kinds = not scene.effects or all(
        isinstance(body.inertia, SphericalInertia) for body in scene.bodies
    )
    evidence: list[tuple[Evidence, Any]] = []
    best, step_cost = math.inf, math.nan
    for method in candidates:
        hopeless = not exact_kinds or method.order < 2
        if hopeless and _optimistic(pilot, method, step_cost) > best:
            evidence.append((_skipped(method, "not run: too low an order for this tolerance"), None))
            continue
        found, trial = _assessed(pilot, method, best)
        evidence.append((found, trial))
        best = min(best, found.seconds or math.inf)
        if isinstance(method, RungeKutta4) and found.seconds_per_step:
            step_cost = found.seconds_per_step
    winners = [
        (found, trial, m) for (found, trial), m in zip(evidence, candidates) if found.seconds is not None
    ]
    if not winners:
        reached = min((e for found, _ in evidence for _, e in found.pilots), default=math.inf) * tolerance
        kind = np.dtype(state.dtype).name
        more = "; use float64" if kind == "float32" else ""
        raise InvalidInput(
            f"plan: no method meets the tolerance {tolerance:g} in {kind}; the best error was {reached:.2g}{more}"
        )
    found, trial, method = min(winners, key=lambda winner: winner[0].seconds or math.inf)
    return Plan(
        method, trial.steps, duration / trial.steps, tolerance, (found.predicted_error or math.nan) * tolerance,
        trial.excess * tolerance, trial.errors.attitude, trial.errors.position, trial.errors.energy,
        found.seconds or math.nan, time.process_time() - start,
        f"Runge–Kutta 4 of {judge.steps} steps in float64, extrapolated, good to {judge.uncertainty:.1g}",
        tuple(e for e, _ in evidence),
    )  # fmt: skip


def _optimistic(pilot: Pilot, method: Method, step_cost: float) -> float:
    """Less time than the method can possibly need [s], from the motion's own scale of time; 0 where that is unknown."""
    constant = pilot.judge.error_constant
    if not (np.isfinite(step_cost) and constant > 0) or method.order >= 4:
        return 0.0
    scale = constant**-0.25  # [s]: Runge–Kutta errs by (dt/scale)⁴
    steps = pilot.duration / scale * (_SMALLEST_CONSTANT / pilot.tolerance) ** (1.0 / method.order)
    return steps * step_cost * (_CHEAPEST_STEP if method.order > 1 else _CHEAPEST_EULER_STEP)


def _assessed(pilot: Pilot, method: Method, best: float) -> tuple[Evidence, Any]:
    try:
        first = pilot.run(method, 1)
    except JaxrbError as error:  # a method may refuse a scene, and says why
        return _skipped(method, f"not run: {error}"), None
    jax.block_until_ready(first)
    most = float(MOST_STEPS)
    if np.isfinite(best):
        count = max(1000, int(1e-3 / max(pilot.seconds(method, 1000) / 1000, 1e-9)))
        most = min(most, max(_HOPELESS * best / (pilot.seconds(method, count) / count), 8.0))
    trials, good = fewest_steps(pilot, method, most)
    order = observed_order(trials)
    if good is None:
        last = max(trials, key=lambda t: t.steps)
        why = "too dear" if most < MOST_STEPS else "not met"
        note = f"{why}: at {last.steps} steps the error is {last.errors.attitude:.1e} rad"
        return dataclasses.replace(_skipped(method, note), observed_order=order, pilots=_pilots(trials)), None
    seconds = cpu_seconds(lambda: pilot.run(method, good.steps))
    found = Evidence(
        type(method).__name__, method.order, order, constant_of(good, method.order, pilot.duration) * pilot.tolerance,
        _pilots(trials), good.steps, predicted(trials, good.steps, method.order), good.excess, seconds,
    )  # fmt: skip
    return found, good


def _pilots(trials: Sequence[Any]) -> tuple[tuple[int, float], ...]:
    return tuple((t.steps, t.excess) for t in trials if np.isfinite(t.excess))


def _skipped(method: Method, note: str) -> Evidence:
    return Evidence(type(method).__name__, method.order, None, None, (), None, None, None, None, note)
