"""Work and precision with contact in words."""

from collections.abc import Sequence

from jaxrb.accuracy.contact_work_precision import ContactWorkPrecision
from jaxrb.tables import table


def summary(found: Sequence[ContactWorkPrecision], front: bool = False) -> str:
    """Tables: all points of each scene (or those that nothing cheaper matches), and times at equal error."""
    parts = []
    for scene in found:
        rows = [
            {
                "": "*" if p.on_front else "",
                "who": p.who,
                "setting": p.setting,
                "error [m, rad]": f"≤ {scene.uncertainty:.1e}"
                if p.error < scene.uncertainty
                else f"{p.error:.1e}",
                "run [CPU ms]": f"{1e3 * p.run_seconds:.3g}",
                "steps": p.steps,
            }
            for p in scene.points
            if p.on_front or not front
        ]
        equal = [
            row
            | {
                "error": f"{row['error']:.1e}",
                "time over theirs": ""
                if row["time over theirs"] is None
                else f"{row['time over theirs']:.2g}",
            }
            for row in scene.at_equal_error()
        ]
        parts += [
            f"{scene.scene}: {scene.about}. Truth: {scene.how}, known to {scene.uncertainty:.1e}.",
            table(rows),
            "",
            "The cheapest run of solve_contact that errs no more than",
            table(equal),
            "",
        ]
    return "\n".join(parts)
