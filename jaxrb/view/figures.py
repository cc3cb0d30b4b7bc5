"""Pictures with matplotlib (extra `[view]`), written without a display."""

import io
import pathlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrb.accuracy.cost import CostReport
from jaxrb.accuracy.drift import DriftRun
from jaxrb.accuracy.work_precision import Point
from jaxrb.errors import JaxrbError

_FACES = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
_FACE_COLOURS = ["#4c78a8", "#4c78a8", "#f58518", "#f58518", "#54a24b", "#54a24b"]


def new_figure(size: tuple[float, float]) -> Any:
    """An empty figure of so many inches, outside of any window system; a notebook shows it where it ends a cell.

    Raises:
        JaxrbError: matplotlib is not installed; says how to get it.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise JaxrbError('pictures need matplotlib: pip install "jaxrb[view]"') from error

    class Picture(Figure):
        """A figure that a notebook shows although pyplot does not know it."""

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png", dpi=72)
            return buffer.getvalue()

    return Picture(figsize=size, layout="constrained")


def save(figure: Any, file: pathlib.Path) -> pathlib.Path:
    """Write a figure."""
    figure.savefig(file, dpi=110)
    return file


def draw_boxes(axes: Any, half_extents: np.ndarray, positions: np.ndarray, matrices: np.ndarray) -> None:
    """Boxes (n, 3) at (n, 3) seen through *whatever* matrices (n, 3, 3) a run produced, rotations or not."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    for half, position, matrix in zip(half_extents, positions, matrices, strict=True):
        world = position + (corners * half) @ matrix.T
        faces = Poly3DCollection(
            [world[list(face)] for face in _FACES], facecolors=_FACE_COLOURS, edgecolor="k"
        )
        faces.set_alpha(0.85)
        faces.set_linewidth(0.5)
        axes.add_collection3d(faces)
    centre, reach = positions.mean(axis=0), np.ptp(positions, axis=0).max() / 2 + half_extents.max() * 1.5
    for set_limit, middle in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), centre, strict=True):
        set_limit(middle - reach, middle + reach)
    axes.set_box_aspect((1, 1, 1), zoom=1.7)
    axes.set_axis_off()
    axes.view_init(elev=55, azim=-75)


def boxes_figure(half_extents: np.ndarray, runs: Sequence[DriftRun], saves: Sequence[int]) -> Any:
    """The set of boxes of each run (row) at chosen saves (column), drawn with the matrices as they are."""
    figure = new_figure((3.2 * len(saves), 2.9 * len(runs) + 0.5))
    for i, run in enumerate(runs):
        matrices = np.asarray(run.path.states.orientation.as_matrix())
        positions = np.asarray(run.path.states.position)
        for j, at in enumerate(saves):
            axes = figure.add_subplot(len(runs), len(saves), i * len(saves) + j + 1, projection="3d")
            draw_boxes(axes, half_extents, positions[at], matrices[at])
            how = "renormalised" if run.renormalised else "as computed"
            axes.set_title(f"{run.representation}, {how}\n{run.iterations[at]} iterations", fontsize=10)
    return figure


def drift_figure(runs: Sequence[DriftRun]) -> Any:
    """Scale error, skew and attitude error against iterations, the worst box of each run."""
    figure = new_figure((12.5, 4.2))
    axes = figure.subplots(1, 3)
    for run in runs:
        how = "renormalised" if run.renormalised else "as computed"
        label = f"{run.representation}, {how}"
        style = {"label": label, "linestyle": "--" if run.renormalised else "-"}
        for panel, values in zip(axes, (np.abs(run.scale), run.skew, run.attitude_error), strict=True):
            panel.plot(run.iterations[1:], np.maximum(values.max(axis=1)[1:], 1e-17), **style)
    for panel, title in zip(
        axes,
        ("error of scale (breathing, growth)", "skew: largest |cosine| of two axes", "attitude error [rad]"),
        strict=True,
    ):
        panel.set(title=title, xlabel="iterations", yscale="log", xscale="log")
        panel.grid(alpha=0.3)
    axes[2].legend(fontsize=8)
    return figure


def work_precision_figure(points: Sequence[Point], bodies: int, known: float = 0.0, title: str = "") -> Any:
    """Attitude error against CPU time for each method, representation and precision.

    `known` [rad] is the uncertainty of the reference: errors below it are drawn at it, hollow. Rings mark the points
    that nothing cheaper matches.
    """
    figure = new_figure((10.0, 5.6))
    axes = figure.subplots()
    names = dict.fromkeys((p.method, p.representation, p.precision) for p in points)
    markers = {"quaternion": "o", "rotation matrix": "s"}
    colours = {m: f"C{i}" for i, m in enumerate(dict.fromkeys(p.method for p in points))}
    mixed = len({p.precision for p in points}) > 1
    for method, representation, precision in names:
        chosen = [
            p
            for p in points
            if (p.method, p.representation, p.precision) == (method, representation, precision)
        ]
        axes.loglog(
            [1e6 * p.run_seconds / bodies for p in chosen],
            [max(p.attitude_error_rad, known) for p in chosen],
            marker=markers.get(representation, "^"),
            markersize=4,
            fillstyle="none" if any(p.beyond_reference for p in chosen) else "full",
            color=colours[method],
            linestyle="-" if representation == "quaternion" else ":",
            alpha=1.0 if precision == "float64" or not mixed else 0.45,
            label=f"{method}, {representation}" + (f", {precision}" if mixed else ""),
        )
    front = sorted((p for p in points if p.on_front), key=lambda p: p.run_seconds)
    if front:
        x = [1e6 * p.run_seconds / bodies for p in front]
        y = [max(p.attitude_error_rad, known) for p in front]
        axes.loglog(
            x, y, "o", markersize=11, fillstyle="none", color="k", label="nothing cheaper is as accurate"
        )
    if known > 0.0:
        axes.axhline(known, color="0.5", linewidth=0.8)
        axes.annotate("uncertainty of the reference", (1.0, known), xycoords=("axes fraction", "data"), ha="right",
                      va="bottom", fontsize=8, color="0.4")  # fmt: skip
    axes.set(
        xlabel="CPU time a body for the whole run [µs]", ylabel="attitude error at the end [rad]", title=title
    )
    axes.grid(alpha=0.3, which="major")
    if len(names) > 12:
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    else:
        axes.legend(fontsize=8)
    return figure


def cost_figure(report: CostReport, title: str = "") -> Any:
    """What each effect takes of a step, and how far the motion is off without it."""
    figure = new_figure((10.0, 0.6 * len(report.effects) + 2.2))
    left, right = figure.subplots(1, 2, sharey=True)
    names = [effect.name for effect in report.effects] + ["the motion itself"]
    shares = [100.0 * effect.share for effect in report.effects] + [100.0 * report.share_of_motion]
    left.barh(names, shares, color=["C0"] * len(report.effects) + ["0.7"])
    left.invert_yaxis()
    left.set(xlabel="share of a step's CPU time [%]", title=title)
    apart = [(effect.name, effect.difference) for effect in report.effects if effect.difference is not None]
    for field, unit, marker in (("attitude", "rad", "o"), ("position", "m", "s")):
        values = [max(getattr(found, field), 1e-16) for _, found in apart]
        right.semilogx(values, [name for name, _ in apart], marker, label=f"{field} [{unit}]")
    right.set(xlabel="difference without the effect, at most")
    right.legend(fontsize=8)
    right.grid(alpha=0.3)
    return figure


def spin_figure(time: np.ndarray, measured: np.ndarray, fitted: np.ndarray | None, title: str) -> Any:
    """Angular velocity of a recording (k, 3) and of the fitted motion over time."""
    figure = new_figure((8.0, 4.2))
    axes = figure.subplots()
    for i, name in enumerate("xyz"):
        axes.plot(time, measured[:, i], ".", color=f"C{i}", markersize=3, label=f"measured ω{name}")
        if fitted is not None:
            axes.plot(time, fitted[:, i], "-", color=f"C{i}", linewidth=1, label=f"fitted ω{name}")
    axes.set(xlabel="time [s]", ylabel="angular velocity in the body frame [rad/s]", title=title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=2)
    return figure
