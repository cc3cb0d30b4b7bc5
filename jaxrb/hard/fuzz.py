"""Spoiled files for every reader: nothing but jaxrb's own errors may come of them, in little time and memory.

    python -m jaxrb.hard.fuzz --count 10000
    python -m jaxrb.hard.fuzz --format ply --first 1234 --count 1 --keep folder

File number n of a format is the same for the same seed, whatever was read before it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxrb.errors import UnknownName
from jaxrb.hard.fuzz_child import MEMORY, SECONDS
from jaxrb.hard.fuzz_formats import FORMATS, spoiled
from jaxrb.tables import table

_MOST_DEATHS = 20
_CHILD = ("-m", "jaxrb.hard.fuzz_child")


def fuzz(
    formats: Sequence[str] = tuple(FORMATS),
    *,
    count: int = 1000,
    seed: int = 0,
    first: int = 0,
    keep: Path | None = None,
) -> list[dict[str, Any]]:
    """Read `count` spoiled files of each format in processes of their own; a row for each, with its faults.

    A fault is an error that is not jaxrb's, a warning that is not jaxrb's, an answer that is not finite, more than 2 s
    of the processor or 1 GiB beyond what the process had, or its death. Files with faults go to the folder `keep`.

    Raises:
        UnknownName: a format that is not there.
    """
    for name in formats:
        if name not in FORMATS:
            raise UnknownName(f"format {name!r} is not known; there are {', '.join(FORMATS)}")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, kind in FORMATS.items():
            for i, data in enumerate(kind.seeds()):
                (folder / f"{name}-{i}.seed").write_bytes(data)
        rows = [_row(folder, name, first, count, seed) for name in formats]
        if keep is not None:
            _keep(folder, keep, rows, seed)
    return rows


def _row(folder: Path, name: str, first: int, count: int, seed: int) -> dict[str, Any]:
    """The figures of one format; a process that dies is followed by another behind the file that killed it."""
    row: dict[str, Any] = {"format": name, "files": count, "refused": 0, "slowest_s": 0.0, "slowest": -1}
    row |= {"grown_bytes": 0, "faults": {}}
    at, end, deaths = first, first + count, 0
    while at < end and deaths < _MOST_DEATHS:
        command = [sys.executable, *_CHILD, str(folder), name, str(at), str(end - at), str(seed)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        told = [json.loads(line) for line in done.stdout.splitlines()]
        row["faults"] |= {line["at"]: line["fault"] for line in told if "fault" in line}
        if done.returncode == 0:
            last = told[-1]
            row["refused"] += last["refused"]
            row["grown_bytes"] = max(row["grown_bytes"], last["grown_bytes"])
            if last["slowest_s"] > row["slowest_s"]:
                row |= {"slowest_s": last["slowest_s"], "slowest": last["slowest"]}
            break
        reached = [line["at"] for line in told if "at" in line]
        deaths += 1
        words = done.stderr.strip().splitlines()
        number = reached[-1] if reached else at
        row["faults"][number] = f"the process died ({done.returncode}): {words[-1] if words else ''}"
        at = number + 1
    return row


def _keep(folder: Path, keep: Path, rows: list[dict[str, Any]], seed: int) -> None:
    keep.mkdir(parents=True, exist_ok=True)
    everything = [file.read_bytes() for file in sorted(folder.glob("*.seed"))]
    for row in rows:
        name = row["format"]
        own = [file.read_bytes() for file in sorted(folder.glob(f"{name}-*.seed"))]
        for number in row["faults"]:
            random = np.random.default_rng([seed, list(FORMATS).index(name), number])
            data = spoiled(FORMATS[name], own, everything, random)
            (keep / f"{name}-{number}{FORMATS[name].suffix}").write_bytes(data)


def main() -> None:
    """Exit code 1 where there is a fault."""
    said = (__doc__ or "").split("\n", 1)[0]
    parser = argparse.ArgumentParser("python -m jaxrb.hard.fuzz", description=said)
    parser.add_argument(
        "--format", action="append", choices=list(FORMATS), help="only this; may be given again"
    )
    parser.add_argument("--count", type=int, default=1000, help="files of each format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first file")
    parser.add_argument("--keep", type=Path, help="folder for the files with faults")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    given = parser.parse_args()
    rows = fuzz(
        given.format or tuple(FORMATS), count=given.count, seed=given.seed, first=given.first, keep=given.keep
    )
    if given.json:
        print(json.dumps(rows))
    else:
        print(
            table(
                [
                    {
                        "format": row["format"], "files": str(row["files"]), "refused": str(row["refused"]),
                        "slowest [s]": f"{row['slowest_s']:.3f} (number {row['slowest']})",
                        "memory beyond the start [MiB]": f"{row['grown_bytes'] / 2**20:.0f}",
                        "faults": str(len(row["faults"])),
                    }
                    for row in rows
                ]
            )
        )  # fmt: skip
        print(f"\nLimits: {SECONDS:g} s of the processor, {MEMORY / 2**30:g} GiB.")
        for row in rows:
            for number, fault in row["faults"].items():
                print(f"FAULT {row['format']} {number}: {fault}")
    if any(row["faults"] for row in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
