"""Which effects a scene does not call for."""

import dataclasses
from typing import Any

import numpy as np

from jaxrb.accuracy.cost import names, without
from jaxrb.accuracy.differences import Difference, difference
from jaxrb.accuracy.planner import duration_of, plan
from jaxrb.body.state import State
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import check_count, check_tolerance
from jaxrb.tables import table


@dataclasses.dataclass(frozen=True)
class Recommendation:
    """The scene with what it calls for, and why.

    `scene` has the effects that stay, `dropped` names the others; `difference` is how far the motion without all of
    them was from the whole scene's, at most. `alone` has the same for each effect left out by itself.
    """

    scene: Scene
    dropped: tuple[str, ...]
    kept: tuple[str, ...]
    tolerance: float
    difference: Difference
    alone: dict[str, Difference]
    dt: float
    steps: int

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "dropped": self.dropped,
            "kept": self.kept,
            "tolerance": self.tolerance,
            "difference": dataclasses.asdict(self.difference),
            "alone": {name: dataclasses.asdict(found) for name, found in self.alone.items()},
            "dt": self.dt,
            "steps": self.steps,
        }

    def summary(self) -> str:
        """The recommendation in words and a table."""
        rows = [
            {
                "effect": name,
                "attitude [rad]": f"{found.attitude:.1e}",
                "position [m]": f"{found.position:.1e}",
                "verdict": "not needed" if name in self.dropped else "needed",
            }
            for name, found in self.alone.items()
        ]
        dropped, all_off = ", ".join(self.dropped) or "nothing", self.difference
        return "\n".join(
            [
                f"Within {self.tolerance:g} rad and m the scene can do without: {dropped}. Left out together they "
                f"change the motion by {all_off.attitude:.1e} rad and {all_off.position:.1e} m at most.",
                "Each left out by itself changes it by:",
                table(rows),
            ]
        )


def recommend(
    scene: Scene,
    state: State,
    t1: float,
    tolerance: float,
    *,
    steps: int | None = None,
) -> Recommendation:
    """Which effects a run from `state` to `t1` [s] can do without, within `tolerance` [rad and m] at all times.

    The effects are left out one after the other, the least important first, as long as the motion of what is left stays
    within the tolerance of the whole scene's: every set that is recommended was run. Compared at 64 times on the way
    and at the end, with Runge–Kutta 4. An effect counts as left out whole, with its constraints (`FixedPoint`).

    Args:
        tolerance: attitude [rad] and position [m] of every body, at every place of comparison.
        steps: of the runs; by default as many as the whole scene needs for a twentieth of the tolerance.
    """
    check_fit(scene, state)
    check_tolerance("recommend: tolerance", tolerance)
    duration = duration_of("recommend", scene, state, t1)
    method = RungeKutta4()
    if steps is None:
        steps = plan(scene, state, t1, tolerance / 20.0, methods=[method]).steps
    steps = check_count("recommend: steps", steps, 1)
    dt = duration / steps

    def apart(dropped: list[int]) -> Difference:
        return difference(scene, without(scene, dropped), state, dt, steps, method)

    alone = {i: apart([i]) for i in range(len(scene.effects))}
    dropped: list[int] = []
    found = Difference(0.0, 0.0, 0.0, 0.0)
    for i in sorted(alone, key=lambda i: alone[i].largest):
        if alone[i].largest > tolerance:
            break
        together = apart([*dropped, i]) if dropped else alone[i]
        if together.largest <= tolerance:
            dropped, found = [*dropped, i], together
    every = names(scene)
    return Recommendation(
        without(scene, dropped),
        tuple(every[i] for i in sorted(dropped)),
        tuple(every[i] for i in range(len(every)) if i not in dropped),
        float(tolerance),
        found,
        {every[i]: alone[i] for i in sorted(alone, key=lambda i: -np.nan_to_num(alone[i].largest))},
        dt,
        steps,
    )
