"""Work and precision with contact as a picture."""

from collections.abc import Sequence
from typing import Any

from jaxrb.accuracy.contact_work_precision import ContactWorkPrecision
from jaxrb.view.figures import new_figure

_LEAST = 1e-15  # errors are drawn no lower


def contact_figure(found: Sequence[ContactWorkPrecision]) -> Any:
    """Error against CPU time, a panel for each scene."""
    picture = new_figure((5.2 * len(found), 4.8))
    panels = picture.subplots(1, len(found), squeeze=False)[0]
    names = list(dict.fromkeys(p.who for scene in found for p in scene.points))
    for panel, scene in zip(panels, found, strict=True):
        for i, who in enumerate(names):
            chosen = [p for p in scene.points if p.who == who]
            known = max(scene.uncertainty, _LEAST)
            panel.loglog(
                [1e3 * p.run_seconds for p in chosen],
                [max(p.error, known) for p in chosen],
                marker="o" if who.startswith("solve") else "s",
                markersize=4,
                linewidth=2.0 if who == "solve_contact" else 1.0,
                color=f"C{i}",
                label=who,
            )
        panel.axhline(scene.uncertainty, color="0.5", linewidth=0.8)
        panel.set(xlabel="CPU time of the run [ms]", title=scene.about)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("error of position [m] and attitude [rad]")
    panels[0].legend(fontsize=8)
    return picture
