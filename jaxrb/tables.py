"""Plain-text tables for the command line."""

from collections.abc import Mapping, Sequence
from typing import Any


def table(rows: Sequence[Mapping[str, Any]], headings: Mapping[str, str] | None = None) -> str:
    """Rows of equal keys as aligned columns; `headings` chooses and names the columns."""
    if not rows:
        return "(nothing)"
    headings = headings or {key: key for key in rows[0]}
    cells = [[_cell(row[key]) for key in headings] for row in rows]
    titles = list(headings.values())
    widths = [max(len(title), *(len(line[i]) for line in cells)) for i, title in enumerate(titles)]
    numeric = [all(isinstance(row[key], (int, float)) for row in rows) for key in headings]
    lines = [_line(titles, widths, numeric), "  ".join("─" * width for width in widths)]
    return "\n".join(lines + [_line(line, widths, numeric) for line in cells])


def _line(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    parts = [c.rjust(w) if r else c.ljust(w) for c, w, r in zip(cells, widths, right, strict=True)]
    return "  ".join(parts).rstrip()


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if value == 0 or 1e-2 <= abs(value) < 1e4:
            return f"{value:.3g}"
        return f"{value:.1e}"
    return str(value)
