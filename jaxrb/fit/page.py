"""A fit as one HTML page: the table, the residuals, and what would determine more. One self-contained file."""

import html
import io
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxrb.fit.advice import next_throw
from jaxrb.fit.quality import scaled_residuals
from jaxrb.fit.report import InertiaFit
from jaxrb.fit.uncertainty import NAMES, directions, fitted_information, in_words
from jaxrb.io.npz import write_whole

_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em}pre{background:#f4f4f4;\
padding:1em;overflow-x:auto}svg{max-width:100%;height:auto}td,th{padding:.2em .8em;text-align:right}"
)
_FLIGHTS_DRAWN = 6
_UNITS = ("angular velocity [rad/s]", "attitude [rad]", "specific force [m/s²]")


def write_page(found: InertiaFit, file: str | Path) -> Path:
    """Write the page to `file`, whole or not at all; it loads nothing from anywhere.

    Raises:
        JaxrbError: where the operating system refuses.
    """
    with jax.enable_x64(True):
        text = page(found)
    path = Path(file)
    write_whole(path, lambda stream: stream.write(text.encode()))
    return path


def page(found: InertiaFit) -> str:
    """The text of the page. matplotlib (extra [view]) draws the figures."""
    problem, fitted = found.evidence
    known = directions(
        fitted_information(problem, fitted.solution, fitted.weight), np.asarray(fitted.solution.shared)
    )
    rows = "".join(
        f"<tr><td>{html.escape(in_words(row[None])[0])}</td><td>{deviation:.3g}</td></tr>"
        for row, deviation in zip(known.rows, known.deviation)
    )
    advice = next_throw(problem, fitted).sentence()
    parts = [
        f"<h1>Inertia of {html.escape(found.nuisance.source)}</h1><pre>{html.escape(found.summary())}</pre>",
        "<h2>Cramér–Rao bound</h2><p>The five independent directions of the inertia ratios, least known first, and the "
        "smallest standard error that any unbiased estimate from white noise of this size can have.</p>"
        f"<table><tr><th>direction</th><th>bound</th></tr>{rows}</table><p>{html.escape(advice)}</p>",
        "<h2>Residuals</h2><p>Simulated less measured. Noise without pattern is what a free tumble leaves.</p>",
        _residuals(found),
        f"<h2>Correlation of the ratios</h2>{_correlation(found)}",
    ]
    head = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Inertia</title><style>{_STYLE}</style>'
    )
    return head + "".join(parts) + "</html>\n"


def residuals(found: InertiaFit) -> list[np.ndarray]:
    """Residuals (S, K, 3) of each channel in its own unit, NaN where a flight is shorter than the longest."""
    problem, fitted = found.evidence
    parts = scaled_residuals(problem, fitted)
    return [part * fitted.scales[channel] for part, channel in zip(parts, problem.residual.channels_used)]


def _residuals(found: InertiaFit) -> str:
    figure, axes_of = _figure()
    problem, fitted = found.evidence
    parts = residuals(found)
    drawn = np.flatnonzero(fitted.weight > 0)[:_FLIGHTS_DRAWN]
    axes = axes_of(len(parts), 2)
    for row, (part, channel) in enumerate(zip(parts, problem.residual.channels_used)):
        for flight in drawn:
            time = np.cumsum(np.asarray(fitted.data.interval)[flight, 0])
            axes[row][0].plot(time, part[flight], lw=0.7)
        axes[row][0].set(xlabel="time in flight [s]", ylabel=_UNITS[channel], title=f"{len(drawn)} flights")
        values = part[fitted.weight > 0]
        values = values[np.isfinite(values)]
        edges = np.linspace(-4, 4, 61) * fitted.scales[channel]
        axes[row][1].hist(values, edges, density=True, alpha=0.6)
        normal = np.exp(-0.5 * (edges / fitted.scales[channel]) ** 2) / (
            fitted.scales[channel] * np.sqrt(2 * np.pi)
        )
        axes[row][1].plot(edges, normal, "k--", lw=1)
        axes[row][1].set(xlabel=_UNITS[channel], title="all samples, and white noise (dashed)")
    return _svg(figure)


def _correlation(found: InertiaFit) -> str:
    figure, axes_of = _figure()
    axes = axes_of(1, 1)[0][0]
    deviation = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    shown = axes.imshow(found.covariance / np.outer(deviation, deviation), vmin=-1, vmax=1, cmap="RdBu")
    axes.set_xticks(range(6), NAMES)
    axes.set_yticks(range(6), NAMES)
    figure.colorbar(shown)
    return _svg(figure)


def _figure() -> tuple[Any, Any]:
    """An empty figure that no window shows, and how to divide it into rows and columns."""
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained")

    def axes_of(rows: int, columns: int) -> Any:
        figure.set_size_inches(5.2 * columns, 3.2 * rows)
        return figure.subplots(rows, columns, squeeze=False)

    return figure, axes_of


def _svg(figure: Any) -> str:
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({"svg.hashsalt": "jaxrb"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]
