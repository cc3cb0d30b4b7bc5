"""A run from the side as a picture or a moving picture, by matplotlib (extra `[view]`), without a display."""

from pathlib import Path as File
from typing import Any

import jax
import numpy as np

from jaxrb.body.state import State
from jaxrb.scene.path import Path
from jaxrb.view.figures import new_figure, save
from jaxrb.view.side_view import draw_side, side_of

_FRAMES, _SECONDS = (
    90,
    4.5,
)  # most frames of a moving picture, and how long it lasts unless the run is shorter
_SIZE, _DPI = (6.4, 4.8), 100


def save_png(path: Path, file: File) -> File:
    """The bodies at the last saved time."""
    figure = new_figure(_SIZE)
    axes = figure.subplots()
    _draw(axes, path, len(path.times) - 1, side_of(path.scene, path.states))
    return save(figure, file)


def save_gif(path: Path, file: File) -> File:
    """The run at its own speed if it takes no longer than some seconds, else faster; never more than 90 frames."""
    from matplotlib.animation import PillowWriter

    times = np.asarray(path.times, float)
    across = side_of(path.scene, path.states)
    count = min(_FRAMES, len(times))
    wanted = np.linspace(times[0], times[-1], count)
    saves = np.unique(np.abs(times[:, None] - wanted).argmin(axis=0))
    span = min(_SECONDS, times[-1] - times[0]) or 1.0
    figure = new_figure(_SIZE)
    axes = figure.subplots()
    limits = []
    for at in (saves[0], saves[len(saves) // 2], saves[-1]):
        _draw(axes, path, at, across)
        limits.append((*axes.get_xlim(), *axes.get_ylim()))
        axes.clear()
    position = np.asarray(path.states.position, float)[..., [across, 2]]
    limits.append(
        tuple(np.stack([np.nanmin(position, (0, 1)), np.nanmax(position, (0, 1))], axis=-1).ravel())
    )
    x0, x1, y0, y1 = np.array(limits).T
    writer: Any = PillowWriter(fps=max(1, round(len(saves) / span)))
    with writer.saving(figure, file, _DPI):
        for at in saves:
            axes.clear()
            _draw(axes, path, at, across)
            axes.set(xlim=(x0.min(), x1.max()), ylim=(y0.min(), y1.max()))
            writer.grab_frame()
    return file


def _draw(axes: Any, path: Path, at: int, across: int) -> None:
    state: State = jax.tree.map(lambda leaf: leaf[at], path.states)
    draw_side(axes, path.scene, state, across)
    axes.set(title=f"{float(path.times[at]):.3f} s")
