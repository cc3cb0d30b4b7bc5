"""What differences of a loss over many steps say about the derivative it was given, along one direction.

A smooth loss is known by how its differences scale with the step h: f(x + h) + f(x − h) − 2 f(x) falls with h² where f
is smooth, with h at a kink, not at all at a jump. Plateaus are found by Richardson's extrapolation, with the spread of
three neighbours as their uncertainty (Ridders 1982, "Accurate computation of F'(x) and F'(x)F''(x)").
"""

import dataclasses
from typing import Any

import numpy as np

from jaxrb.accuracy.gradient_check_differences import (
    PLATEAU,
    RESOLVED,
    Differences,
    flat_until,
    plateau,
    power_of,
    trend_of,
)

RIGHT, BIASED, ZERO, JUMPING, NOT_FINITE, UNDETERMINED = (
    "right", "biased", "zero", "jumping", "not finite", "undetermined"
)  # fmt: skip
_SMOOTH = 1.25  # the power of h with which a smooth loss bends is 2, that of a kink 1


@dataclasses.dataclass(frozen=True)
class Finding:
    """A verdict and its reasons: `slope` ± `uncertainty` from plateaus of the differences, `at_step` h.

    `right`, `left`: the slopes on both sides. `coarse`: the slope over steps of `coarse_step` and more where that is
    another one, else None.
    """

    verdict: str
    why: str
    slope: float = np.nan
    uncertainty: float = np.nan
    at_step: float = np.nan
    right: float = np.nan
    left: float = np.nan
    coarse: float | None = None
    coarse_step: float | None = None


def judged(
    d: Differences, forward: float | None, reverse: float | None, tolerance: float, floor: float
) -> Finding:
    """The verdict on derivatives in `forward` and `reverse` mode (None: that mode failed).

    `tolerance`: relative error that counts as right; `floor`: slopes below it count as this large.
    """
    given = {k: v for k, v in (("forward", forward), ("reverse", reverse)) if v is not None}
    bad = [f"{mode} mode gives {slope}" for mode, slope in given.items() if not np.isfinite(slope)]
    if not np.isfinite(d.value):
        bad.insert(0, f"the loss is {d.value} here")
    if len(d.steps) < 4:
        return Finding(UNDETERMINED, f"only {len(d.steps)} of the steps are long enough to change the number")
    finite = np.isfinite(d.ahead) & np.isfinite(d.behind)
    count = len(finite) if finite.all() else int(np.argmin(finite))
    if count < 4:
        bad.append(f"the loss is not finite a step of {d.steps[count]:.0e} away")
    if bad:
        return Finding(NOT_FINITE, "; ".join(bad))
    d = d.up_to(count)
    noise = d.noise
    sigma = noise / d.steps + (0.0 if d.scatter is None else d.scatter)
    slope, off, at = plateau(d.steps, d.central, sigma, 2)
    sides = {
        "right": plateau(d.steps, d.right, 2 * sigma, 1)[0],
        "left": plateau(d.steps, d.left, 2 * sigma, 1)[0],
    }
    known: dict[str, Any] = {"slope": slope, "uncertainty": off, "at_step": at, **sides}
    jump = _jump(d, noise, sides)
    if jump:
        return Finding(JUMPING, jump, **known)
    if not given:
        return Finding(UNDETERMINED, "no mode of differentiation runs", **known)
    floor = max(floor, 100.0 * d.round_off / d.steps[-1])
    slopes = [*given.values(), floor]
    if np.ptp(slopes[:-1]) > tolerance * np.abs(slopes).max():
        return Finding(BIASED, "forward and reverse mode differ", **known)
    guess = slopes[0]
    trend, step = trend_of(d, slope)
    if trend is not None and abs(trend - slope) > max(0.3 * max(abs(trend), abs(slope)), floor):
        known |= {"coarse": trend, "coarse_step": step}
    zero = _zero(d, guess, noise, tolerance, floor, known)
    if zero:
        return Finding(ZERO, zero, **known)
    # A slope of nothing, as well known as round-off lets it be, is a slope too.
    if off > max(PLATEAU * max(abs(slope), floor), 20.0 * d.round_off / at):
        return _without_plateau(d, guess, trend, step, noise, known)
    return _compared(guess, slope, off, tolerance, floor, known)


def _zero(d: Differences, guess: float, noise: float, tolerance: float, floor: float, known: dict) -> str:
    """In words, if the derivative is zero and the loss changes all the same; else empty."""
    slope, off, coarse = known["slope"], known["uncertainty"], known.get("coarse")
    if abs(guess) > 100.0 * d.eps * max(np.abs(d.central).max(), floor):
        return ""
    if coarse is not None:
        step = known["coarse_step"]
        return (
            f"the derivative is zero, but over steps of {step:.0e} and more the loss changes by {coarse:.4g}"
        )
    if abs(slope) > max(3.0 * off, tolerance * floor):
        return f"the derivative is zero, but the loss changes by {slope:.4g}"
    changes = flat_until(d, noise)
    return "" if changes is None else f"the loss is flat here and changes from steps of {changes:.0e} on"


def _compared(guess: float, slope: float, off: float, tolerance: float, floor: float, known: dict) -> Finding:
    """The verdict where differences have a plateau."""
    coarse, step = known.get("coarse"), known.get("coarse_step")
    right = abs(guess - slope) <= max(tolerance * max(abs(guess), abs(slope), floor), 4.0 * off)
    if coarse is None:
        why = (
            "it agrees with the differences"
            if right
            else f"it gives {guess:.6g}, the differences {slope:.6g}"
        )
        return Finding(RIGHT if right else BIASED, why, **known)
    if abs(guess - coarse) <= PLATEAU * max(abs(coarse), floor):
        return Finding(
            RIGHT, f"it is the slope over steps of {step:.0e} and more; finer ones see another", **known
        )
    whose = "the slope between jumps" if right else "another slope"
    return Finding(
        BIASED,
        f"{guess:.4g} is {whose}; over steps of {step:.0e} and more the loss changes by {coarse:.4g}",
        **known,
    )


def _without_plateau(
    d: Differences, guess: float, trend: float | None, step: float | None, noise: float, known: dict
) -> Finding:
    """The verdict where the differences of no three neighbouring steps agree."""
    if trend is not None:
        known = known | {"coarse": trend, "coarse_step": step}
        right = abs(guess - trend) <= PLATEAU * abs(trend)
        why = f"only steps of {step:.0e} and more see a slope, {trend:.3g}, known to {100 * PLATEAU:.0f} %"
        return Finding(RIGHT if right else BIASED, why, **known)
    values = np.concatenate([d.ahead, d.behind])
    if noise > 0.02 * np.ptp(values):
        return Finding(UNDETERMINED, "chaotic: the loss scatters over all steps, as if drawn by lot", **known)
    return Finding(UNDETERMINED, "the differences settle at no step", **known)


def _jump(d: Differences, noise: float, sides: dict[str, float]) -> str:
    """In words, if the value or the slope jumps at the point itself; else empty."""
    ahead, behind = d.ahead - d.value, d.value - d.behind
    for name, change in (("ahead of", ahead), ("behind", behind), ("across", ahead + behind)):
        power = power_of(d.steps, change, noise)
        if power is not None and power < 0.75:
            if power < 0.25:
                return f"the value jumps by {change[0]:.4g} {name} this point: not differentiable here"
            return f"the differences grow without end {name} this point: not differentiable here"
    bend = ahead - behind
    power = power_of(d.steps, bend, 2.0 * noise)
    if power is None or power > _SMOOTH:
        return ""
    least = 1e-3 * np.maximum(np.abs(ahead), np.abs(behind))
    first = int(np.argmax(np.abs(bend) > RESOLVED * 2.0 * noise))
    if abs(bend[first]) < least[first]:
        return ""
    return f"the slope jumps from {sides['left']:.4g} to {sides['right']:.4g}: not differentiable here"
