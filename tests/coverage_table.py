"""How much of jaxrb the tests run, by folder: lines and branches, from what coverage.py wrote.

    JAX_ENABLE_X64=1 coverage run -m pytest -n 2 && coverage combine && coverage json && python tests/coverage_table.py

Benchmarks are commands that people run, and no part of the suite: they stand in a row of their own. What runs in the
child process of the model compiler, or where there is no browser, is not seen.
"""

import collections
import json
import pathlib
import sys

COUNTS = ("covered_lines", "num_statements", "covered_branches", "num_branches")


def main() -> int:
    """Print the table; exit code 1 where the engine has less than 95 % of its lines or 90 % of its branches run."""
    files = json.loads(pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "coverage.json").read_text())[
        "files"
    ]
    rows: dict[str, list[int]] = collections.defaultdict(lambda: [0] * len(COUNTS))
    for name, found in files.items():
        parts = pathlib.PurePath(name).parts
        inside = parts[parts.index("jaxrb", max(0, len(parts) - 4)) + 1 :] if "jaxrb" in parts else parts
        folder = inside[0] if len(inside) > 1 else "jaxrb/*.py"
        groups = (folder, "whole") if folder == "bench" else (folder, "without bench", "whole")
        for group in groups:
            for i, count in enumerate(COUNTS):
                rows[group][i] += found["summary"][count]
    print(f"{'folder':14} {'lines':>7} {'run':>7}   {'branches':>8} {'run':>7}")
    for name, (line, lines, branch, branches) in sorted(
        rows.items(), key=lambda row: (row[0] in ("whole", "without bench"), row[0])
    ):
        print(
            f"{name:14} {lines:7} {100 * line / lines:6.1f}%   {branches:8} {100 * branch / max(branches, 1):6.1f}%"
        )
    line, lines, branch, branches = rows["without bench"]
    return int(line < 0.95 * lines or branch < 0.9 * branches)


if __name__ == "__main__":
    sys.exit(main())
