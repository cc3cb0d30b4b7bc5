"""`rb.view`: a run as one HTML page that needs nothing else. Light to import; what it needs is loaded when called."""

import html
import os
from pathlib import Path as File
from typing import Any

_FRAME_HEIGHT = 560  # [px] in a notebook


class View:
    """A run that can be looked at: as the last value of a notebook's cell, or saved as a file.

    `html` is the whole page.
    """

    def __init__(self, page: str):
        self.html = page

    def save(self, file: str | os.PathLike) -> File:
        """Write the page, whole or not at all; returns where.

        Raises:
            InvalidInput: a name that does not end in .html, or a place where no file can be put.
        """
        from jaxrb.errors import InvalidInput
        from jaxrb.io.npz import write_whole

        path = File(file)
        if path.suffix.lower() not in (".html", ".htm"):
            raise InvalidInput(f"{path}: the viewer is a web page; give it a name that ends in .html")
        write_whole(path, lambda stream: stream.write(self.html.encode("utf-8")))
        return path

    def _repr_html_(self) -> str:
        # A sandbox without allow-same-origin: the page's scripts reach neither the notebook nor the network.
        return (
            f'<iframe title="Viewer of a run" sandbox="allow-scripts" srcdoc="{html.escape(self.html)}" '
            f'style="width:100%;height:{_FRAME_HEIGHT}px;border:0;border-radius:8px" loading="lazy"></iframe>'
        )

    def __repr__(self) -> str:
        return f"View({len(self.html) / 1e6:.2f} MB of HTML; show it in a notebook, or .save('run.html'))"


def view(
    path: Any,
    file: str | os.PathLike | None = None,
    *,
    title: str = "",
    bounds: bool = True,
    forces: bool = False,
    dt: float | None = None,
) -> View:
    """The run as a page with a player: play, pause, scrub, follow a body, trails, bounding volumes, energy and drift.

    The page is one file that works offline and makes no request. Between saved states positions are interpolated
    linearly and orientations at constant angular velocity; at saved times they are exactly the saved ones.

    Args:
        path: of one world, from `rb.rollout`, `rb.run`, `rb.solve`, `rb.solve_events`, …
        file: where to write the page (.html); None: only return it, which a notebook shows.
        title: heading of the page.
        bounds: hold bounding spheres, oriented boxes and hulls ready to be shown.
        forces: compute each effect's forces at the saved states and hold them ready as arrows, and those of rigid
            contact at the points where it presses. The impacts of `rb.solve_events` are always shown.
        dt: [s] the step whose contact forces are told, by default 1 ms: give that of the run.

    Raises:
        WrongStructure: no path, one of many worlds, one that is being traced. InvalidInput: see `View.save`.
    """
    from jaxrb.view.viewer_page import page_of
    from jaxrb.view.viewer_record import record_of

    found = View(page_of(record_of(path, title, bounds=bounds, forces=forces, dt=dt)))
    if file is not None:
        found.save(file)
    return found
