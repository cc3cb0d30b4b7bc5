"""What `gradient_check` found: figures and verdicts, as a table, as plain data, as JSON."""

import dataclasses
import json
import math
from typing import Any

import numpy as np

from jaxrb.accuracy.gradient_check_verdict import (
    BIASED,
    JUMPING,
    NOT_FINITE,
    RIGHT,
    UNDETERMINED,
    ZERO,
    Finding,
)
from jaxrb.tables import table

# The worst first: the verdict on the whole gradient is that on its worst direction.
_ORDER = (NOT_FINITE, JUMPING, UNDETERMINED, ZERO, BIASED, RIGHT)
_MEANING = {
    RIGHT: "The gradient is right.",
    BIASED: "The gradient is biased: it is not the slope of the loss.",
    ZERO: "The gradient is zero where the loss changes: it tells nothing.",
    JUMPING: "The loss is not differentiable here: its value or its slope jumps.",
    NOT_FINITE: "The gradient or the loss is not finite.",
    UNDETERMINED: "No slope can be told: the loss is chaotic or too rough, or no derivative runs.",
}
_CHAOTIC = 1e3  # growth of the gradient over the second half of the horizon


@dataclasses.dataclass(frozen=True)
class DirectionCheck:
    """One direction: derivatives in `forward` and `reverse` mode (None: that mode failed) beside differences.

    All slopes are losses per unit of the number (per step of the scales along a random direction). `steps` h (k,),
    `central`, `right` and `left` differences (k,); `scale`: the unit of the steps; `noise` of one value of the loss;
    `variance` of the derivative over the samples, None without. `finding` has the verdict and what it rests on.
    """

    name: str
    scale: float
    steps: tuple[float, ...]
    central: tuple[float, ...]
    right: tuple[float, ...]
    left: tuple[float, ...]
    forward: float | None
    reverse: float | None
    noise: float
    variance: float | None
    finding: Finding

    @property
    def verdict(self) -> str:
        """right, biased, zero, jumping, not finite or undetermined."""
        return self.finding.verdict


@dataclasses.dataclass(frozen=True)
class GradientCheck:
    """A gradient and the evidence for it, by `directions`.

    `value` and `precision` of the loss; `tolerance` within which a slope is right; `failed`: what a mode of
    differentiation raised; `samples`, None for a loss without chance; `growth`: times and the gradient's length there.
    """

    directions: tuple[DirectionCheck, ...]
    value: float
    precision: str
    tolerance: float
    failed: dict[str, str]
    samples: int | None = None
    growth: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    @property
    def verdict(self) -> str:
        """That on the worst direction: right only if all are."""
        return min((d.verdict for d in self.directions), key=_ORDER.index)

    @property
    def ok(self) -> bool:
        """Whether every direction is right."""
        return self.verdict == RIGHT

    @property
    def growth_factor(self) -> float | None:
        """By how much the gradient grows over the second half of the horizon: 2 where bodies fly, e^λT/2 in chaos."""
        if self.growth is None:
            return None
        lengths = np.asarray(self.growth[1])
        middle = lengths[len(lengths) // 2]
        return float(lengths[-1] / middle) if middle > 0 else math.inf

    def as_dict(self) -> dict[str, Any]:
        """Plain data; what is not finite becomes None."""
        more = {
            "verdict": self.verdict,
            "meaning": _MEANING[self.verdict],
            "growth_factor": self.growth_factor,
        }
        found = _plain(dataclasses.asdict(self) | more)
        assert isinstance(found, dict)
        return found

    def to_json(self) -> str:
        """The same as one JSON object."""
        return json.dumps(self.as_dict())

    def summary(self) -> str:
        """The verdict in words, a row for each direction, and the reasons."""
        lines = [_MEANING[self.verdict] + self._counts(), f"Loss {self.value:.6g}, {self.precision}."]
        rows = []
        for d in self.directions:
            f = d.finding
            known = math.isfinite(f.slope)
            row: dict[str, Any] = {
                "direction": d.name,
                "forward": _number(d.forward),
                "reverse": _number(d.reverse),
                "differences": f"{f.slope:.6g} ± {f.uncertainty:.1g}" if known else "–",
                "at step": f"{f.at_step:.0e}" if known else "–",
                "verdict": f.verdict,
            }
            if d.variance is not None:
                row["variance"] = f"{d.variance:.2g}"
            rows.append(row)
        lines.append(table(rows))
        lines += [f"  {d.name}: {d.finding.why}." for d in self.directions if d.verdict != RIGHT]
        lines += [f"  {mode} mode does not run: {error}" for mode, error in self.failed.items()]
        factor = self.growth_factor
        if factor is not None:
            chaos = ": chaos; no gradient over so long a time is of use" if factor > _CHAOTIC else ""
            lines.append(f"  Over the second half of the time the gradient grows {factor:.3g} times{chaos}.")
        return "\n".join(lines)

    def _counts(self) -> str:
        count = len(self.directions)
        if count == 1:
            return ""
        return f" {sum(d.verdict == self.verdict for d in self.directions)} of {count} directions: {self.verdict}."


def _number(value: float | None) -> str:
    return "fails" if value is None else f"{value:.6g}"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
