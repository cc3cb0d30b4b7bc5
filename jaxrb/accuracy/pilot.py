"""Pilot runs: how many steps a method needs on one scene for a stated tolerance, found by running it."""

import dataclasses
import math
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.reference import Errors, end_state, errors, extrapolated, in_float64, with_own_arrays
from jaxrb.body.state import State
from jaxrb.errors import InvalidInput
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.scene.scene import Scene

# A pilot starts where the fastest body turns by so much a step [rad], and the effects are stable.
PILOT_TURN = 0.5
COARSEST_TURN = 1.5
# The answer that judges the pilots has an error of so much of the tolerance at most.
JUDGE = 0.05
MOST_STEPS = 2**26
CLOSE = 1.12  # numbers of steps within this ratio count as equal
MARGIN = 0.9  # aim for this part of the tolerance


@dataclasses.dataclass(frozen=True)
class Judge:
    """The answer a pilot run is compared with, and the scale [m] that its position error is relative to."""

    state: State
    uncertainty: float  # of the attitude [rad] or relative, whichever is larger
    position_scale: float
    steps: int
    error_constant: float  # [rad/s⁴]: Runge–Kutta 4 erred by this times dt⁴


@dataclasses.dataclass(frozen=True)
class Trial:
    """One pilot run: steps, its errors, and the largest of them (position relative) in units of the tolerance."""

    steps: int
    errors: Errors
    excess: float


class Pilot:
    """Runs of one scene from one start to one end, judged against one answer."""

    def __init__(self, scene: Scene, state: State, duration: float, tolerance: float, judge: Judge):
        self.scene, self.state, self.duration, self.tolerance, self.judge = (
            scene,
            state,
            duration,
            tolerance,
            judge,
        )
        # On the device once: what is timed is the run, not the way there.
        self._given = jax.device_put((scene, state, jnp.asarray(duration, state.dtype)))

    def run(self, method: Method, steps: int) -> State:
        """The end state after so many steps."""
        scene, state, span = self._given
        return end_state(scene, state, method, span, jnp.asarray(steps))

    def trial(self, method: Method, steps: int) -> Trial:
        """Run, and compare."""
        off = errors(self.scene, self.run(method, steps), self.judge.state)
        worst = max(off.attitude, off.position / self.judge.position_scale, off.energy)
        return Trial(steps, off, worst / self.tolerance if np.isfinite(worst) else math.inf)

    def seconds(self, method: Method, steps: int) -> float:
        """CPU time of one run, once [s]."""
        start = time.process_time()
        jax.block_until_ready(self.run(method, steps))
        return time.process_time() - start


def first_steps(scene: Scene, state: State, method: Method, duration: float, turn: float = PILOT_TURN) -> int:
    """The number of steps that turn the fastest body by at most `turn` [rad] each, and keep the effects stable."""
    spin = float(np.linalg.norm(np.asarray(state.angular_velocity, float), axis=-1).max())
    bodies = scene.stacked()
    fastest = max((float(np.max(effect.rate(bodies, state))) for effect in scene.effects), default=0.0)
    return max(1, math.ceil(duration * max(spin / turn, 1.25 * fastest / method.stability_limit)))


def judge_of(scene: Scene, state: State, duration: float, tolerance: float) -> Judge:
    """An answer good enough to judge runs at `tolerance`: Runge–Kutta 4 in float64, its steps halved until Richardson's
    estimate of its error is a small part of the tolerance, then extrapolated.

    Raises:
        InvalidInput: halving stops helping before that, because of round-off or chaos.
    """
    method, scene = RungeKutta4(), with_own_arrays(scene)
    with jax.enable_x64(True):
        start = in_float64(state)
        steps = max(8, first_steps(scene, state, method, duration))

        def run(count: int, span: float = duration) -> State:
            return end_state(scene, start, method, jnp.asarray(span), jnp.asarray(count))

        scale = _travelled(start, [run(max(2, steps * k // 8), duration * k / 8) for k in range(1, 9)])
        coarse, best, stalled = run(steps), math.inf, 0
        while steps <= MOST_STEPS // 2:
            fine = run(2 * steps)
            off = errors(scene, coarse, fine)
            estimate = max(off.attitude, off.position / scale, off.energy) / 15.0
            estimate = estimate if np.isfinite(estimate) else math.inf
            if estimate <= JUDGE * tolerance:
                constant = off.attitude / (duration / steps) ** 4
                return Judge(extrapolated(coarse, fine), estimate, scale, 2 * steps, constant)
            stalled = stalled + 1 if estimate > 0.5 * best and best < 0.1 else 0
            best = min(best, estimate)
            if stalled >= 3:
                break
            coarse, steps = fine, 2 * steps
    raise InvalidInput(
        f"plan: the tolerance {tolerance:g} cannot be verified: halving the step of Runge–Kutta 4 in float64 stops "
        f"helping at a difference of {best:.1g} ({steps} steps over {duration:g} s); ask for {40 * best:.1g} or more, "
        "or a shorter run"
    )


def _travelled(start: State, states: list[State]) -> float:
    """How far the body that moved farthest was from its start [m]; 1 where nothing moved."""
    begin = np.asarray(start.position)
    far = max(float(np.linalg.norm(np.asarray(s.position) - begin, axis=-1).max()) for s in states)
    return far if np.isfinite(far) and far > 0 else 1.0


def fewest_steps(pilot: Pilot, method: Method, most: float) -> tuple[list[Trial], Trial | None]:
    """All trials, and the one of fewest steps within the tolerance; None where there is none below `most` steps.

    Two runs give the order; then the power law through the last trials is followed until the number of steps is within
    12 % of what the tolerance allows.
    """
    steps = max(4, first_steps(pilot.scene, pilot.state, method, pilot.duration))
    # No plan takes steps of more than a quarter turn, however lucky their error at the end.
    least = first_steps(pilot.scene, pilot.state, method, pilot.duration, COARSEST_TURN)
    trials = [pilot.trial(method, steps), pilot.trial(method, 2 * steps)]
    for _ in range(10):
        good = min((t for t in trials if t.excess <= 1.0), key=lambda t: t.steps, default=None)
        bad = max((t for t in trials if t.excess > 1.0), key=lambda t: t.steps, default=None)
        if good is not None and bad is not None and bad.steps > good.steps:
            bad = max((t for t in trials if t.excess > 1.0 and t.steps < good.steps),
                      key=lambda t: t.steps, default=None)  # fmt: skip
        if good is not None and (
            good.steps <= least or (bad is not None and good.steps <= CLOSE * bad.steps)
        ):
            return trials, good
        if good is not None and good.excess > MARGIN / CLOSE**method.order and good.excess < 1.0:
            return trials, good
        following = max(least, _next_steps(method, trials, good, bad))
        if following > most or any(t.steps == following for t in trials) or _floor_reached(trials):
            return trials, good
        trials.append(pilot.trial(method, following))
    return trials, min((t for t in trials if t.excess <= 1.0), key=lambda t: t.steps, default=None)


def _next_steps(method: Method, trials: list[Trial], good: Trial | None, bad: Trial | None) -> int:
    """Where the power law through what is known meets the tolerance."""
    if good is not None and bad is not None:
        if not np.isfinite(bad.excess) or good.excess <= 0.0:
            return round(math.sqrt(good.steps * bad.steps))
        order = math.log(bad.excess / good.excess) / math.log(good.steps / bad.steps)
        wanted = bad.steps * (bad.excess / MARGIN) ** (1.0 / order)
        return min(
            max(round(wanted), math.ceil(1.03 * bad.steps)), max(bad.steps + 1, int(0.97 * good.steps))
        )
    if good is not None:
        if good.excess <= 0.0:
            return 1
        wanted = good.steps * (good.excess / MARGIN) ** (1.0 / method.order)
        return max(1, min(round(wanted), good.steps - 1), good.steps // 64)
    last = trials[-1] if bad is None else bad
    if not np.isfinite(last.excess):
        return 4 * last.steps
    order = min(max(observed_order(trials) or method.order, 0.5 * method.order), method.order + 1.0)
    return min(math.ceil(last.steps * (last.excess / MARGIN) ** (1.0 / order)), 256 * last.steps)


def _floor_reached(trials: list[Trial]) -> bool:
    """Whether three times more steps in a row did not help: round-off, or a motion that steps cannot resolve."""
    ordered = sorted(trials, key=lambda t: t.steps)
    finest = ordered[-3:]
    return (
        len(ordered) >= 4
        and all(t.excess > 1.0 and np.isfinite(t.excess) for t in ordered)
        and finest[0].errors.attitude < 0.1
        and finest[-1].steps >= 4 * finest[0].steps
        and finest[-1].excess > 0.7 * finest[0].excess
        and finest[-2].excess > 0.7 * finest[0].excess
    )


def observed_order(trials: list[Trial]) -> float | None:
    """The order that the two pilots nearest to the tolerance show; None where they show none."""
    finite = sorted(
        (t for t in trials if np.isfinite(t.excess) and t.excess > 0), key=lambda t: abs(math.log(t.excess))
    )
    if len(finite) < 2 or finite[0].steps == finite[1].steps:
        return None
    a, b = finite[:2]
    return math.log(a.excess / b.excess) / math.log(b.steps / a.steps)


def constant_of(trial: Trial, order: float, duration: float) -> float:
    """C of error = C dtᵖ, in the unit of the tolerance."""
    return trial.excess / (duration / trial.steps) ** order


def predicted(trials: list[Trial], steps: int, order: int) -> float:
    """The error at `steps`, in units of the tolerance, by the power law through the other trial nearest to it."""
    others = [t for t in trials if t.steps != steps and np.isfinite(t.excess)]
    nearest: Any = min(others, key=lambda t: abs(math.log(t.steps / steps)), default=None)
    return math.nan if nearest is None else nearest.excess * (nearest.steps / steps) ** order
