"""What a planner hands back: a method, a step, and why."""

import dataclasses
import math
from typing import Any

from jaxrb.integrators.method import Method
from jaxrb.tables import table


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What pilots showed of one method. Errors are in units of the tolerance; `error_constant` C: error = C dtᵖ.

    `verified_error` was measured at `steps`, against the judge; `predicted_error` is what the other pilots foretold.
    `seconds` is the measured CPU time of such a run. Where the method was given up, `note` says why.
    """

    method: str
    order: int
    observed_order: float | None
    error_constant: float | None
    pilots: tuple[tuple[int, float], ...]  # steps, error
    steps: int | None
    predicted_error: float | None
    verified_error: float | None
    seconds: float | None
    note: str = ""

    @property
    def seconds_per_step(self) -> float | None:
        """Measured CPU time of a step [s]."""
        return None if self.seconds is None or self.steps is None else self.seconds / self.steps


@dataclasses.dataclass(frozen=True)
class Plan:
    """How to run a scene: `rb.rollout(scene, state, dt=plan.dt, steps=plan.steps, method=plan.method)`.

    `predicted_error` and `verified_error` are the largest of the attitude error [rad] and the relative errors of
    position and energy at the end; `attitude_error` [rad], `position_error` [m], `energy_error` (relative) were
    measured. `seconds` is the CPU time of a compiled run, `planning_seconds` what finding out cost.
    """

    method: Method
    steps: int
    dt: float
    tolerance: float
    predicted_error: float
    verified_error: float
    attitude_error: float
    position_error: float
    energy_error: float
    seconds: float
    planning_seconds: float
    judged_by: str
    evidence: tuple[Evidence, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        plain = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return plain | {
            "method": type(self.method).__name__,
            "evidence": [
                dataclasses.asdict(e) | {"seconds_per_step": e.seconds_per_step} for e in self.evidence
            ],
        }

    def summary(self) -> str:
        """The plan and its evidence in words and a table."""
        rows = [
            {
                "method": e.method,
                "order": e.order,
                "seen": "" if e.observed_order is None else f"{e.observed_order:.2f}",
                "steps": "" if e.steps is None else e.steps,
                "predicted": _shown(e.predicted_error, self.tolerance),
                "verified": _shown(e.verified_error, self.tolerance),
                "run [CPU µs]": "" if e.seconds is None else f"{1e6 * e.seconds:.3g}",
                "a step [ns]": "" if e.seconds_per_step is None else f"{1e9 * e.seconds_per_step:.3g}",
                "note": e.note,
            }
            for e in self.evidence
        ]
        return "\n".join(
            [
                f"{type(self.method).__name__}, {self.steps} steps of {self.dt:.4g} s: error {self.verified_error:.2g} "
                f"for a tolerance of {self.tolerance:g}, {1e6 * self.seconds:.3g} CPU µs a run.",
                f"At the end: attitude {self.attitude_error:.2g} rad, position {self.position_error:.2g} m, energy "
                f"{self.energy_error:.2g} (relative). Judged by {self.judged_by}.",
                table(rows),
                f"Planning took {self.planning_seconds:.2g} CPU s.",
            ]
        )


def _shown(error: float | None, tolerance: float) -> str:
    return "" if error is None or not math.isfinite(error) else f"{error * tolerance:.1e}"
