"""Differences of a loss over their step, beside what automatic differentiation says."""

from typing import Any

import numpy as np

from jaxrb.accuracy.gradient_check_report import DirectionCheck, GradientCheck
from jaxrb.accuracy.gradient_check_verdict import RIGHT
from jaxrb.view.figures import new_figure

_ACROSS, _MOST = 3, 12


def gradient_figure(check: GradientCheck, title: str = "") -> Any:
    """A panel for each direction, the first twelve: slopes over the step h; with growth, one of that over time.

    What lies far off the slopes that are of interest (differences grow like 1/h at a jump) leaves the panel.
    """
    shown = check.directions[:_MOST]
    count = len(shown) + (check.growth is not None)
    rows = -(-count // _ACROSS)
    across = min(count, _ACROSS)
    figure = new_figure((4.2 * across + 0.4, 3.0 * rows + 0.6))
    panels = np.atleast_1d(figure.subplots(rows, across)).ravel()
    for axes, direction in zip(panels, shown):
        _draw(axes, direction)
    if check.growth is not None:
        times, lengths = check.growth
        panels[count - 1].semilogy(times, np.maximum(lengths, np.finfo(float).tiny), "k-")
        panels[count - 1].set(xlabel="time [s]", title="length of the gradient over the horizon")
        panels[count - 1].grid(alpha=0.3)
    for axes in panels[count:]:
        axes.set_axis_off()
    panels[0].legend(fontsize=7)
    left_out = len(check.directions) - len(shown)
    more = f", {left_out} more directions not drawn" if left_out else ""
    figure.suptitle(f"{title}{': ' if title else ''}{check.verdict}{more}", fontsize=11)
    return figure


def _draw(axes: Any, direction: DirectionCheck) -> None:
    found = direction.finding
    for values, style, label in (
        (direction.right, "C0>:", "ahead"),
        (direction.left, "C1<:", "behind"),
        (direction.central, "ko-", "central"),
    ):
        axes.semilogx(direction.steps, values, style, markersize=4, linewidth=0.9, label=label)
    for slope, style, label in (
        (direction.forward, "C2--", "forward mode"),
        (direction.reverse, "C3:", "reverse mode"),
    ):
        if slope is not None and np.isfinite(slope):
            axes.axhline(slope, color=style[:2], linestyle=style[2:], label=label)
    if np.isfinite(found.slope):
        axes.axhspan(
            found.slope - found.uncertainty,
            found.slope + found.uncertainty,
            color="0.8",
            zorder=0,
            label="plateau",
        )
    wanted = [direction.forward, direction.reverse, found.slope, found.right, found.left, found.coarse, 0.0]
    wanted = [v for v in wanted if v is not None and np.isfinite(v)]
    low, high = min(wanted), max(wanted)
    room = 0.5 * (high - low) or 1.0
    axes.set(ylim=(low - room, high + room), xlabel="step h", ylabel="slope")
    axes.set_title(
        f"{direction.name}: {found.verdict}", fontsize=9, color="C2" if found.verdict == RIGHT else "C3"
    )
    axes.grid(alpha=0.3)
