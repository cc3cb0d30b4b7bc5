"""The process in which spoiled files are read: with little memory, watched, and free to die."""

import faulthandler
import json
import os
import resource
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from jaxrb.errors import JaxrbError, JaxrbWarning
from jaxrb.hard import fuzz_compiler
from jaxrb.hard.fuzz_formats import FORMATS, spoiled

SECONDS, MEMORY = 2.0, 2**30  # of the processor, and bytes, that reading a file may take
_WATCHDOG = 30.0  # seconds of the clock: on a busy machine a process waits longer than it works


def main(folder: Path, name: str, first: int, count: int, seed: int) -> None:
    """Read files number `first` and on; say of each what it is about to read, and in the end what it cost."""
    kind = FORMATS[name]
    seeds = {file.stem: file.read_bytes() for file in sorted(folder.glob("*.seed"))}
    own = [data for stem, data in seeds.items() if stem.split("-")[0] == name]
    path = folder / f"spoiled{kind.suffix}"
    if kind.compiled and hasattr(os, "fork"):
        fuzz_compiler.installed()
    for data in own:  # a whole file is read first, so that what is loaded and compiled once is no file's cost
        path.write_bytes(data)
        attempt(name, path)
    at_rest = _limit_memory()
    slowest, refused = (0.0, -1), 0
    for number in range(first, first + count):
        random = np.random.default_rng([seed, list(FORMATS).index(name), number])
        path.write_bytes(spoiled(kind, own, list(seeds.values()), random))
        print(json.dumps({"at": number}), flush=True)
        faulthandler.dump_traceback_later(_WATCHDOG, exit=True, file=sys.stderr)
        began = time.process_time()
        fault = attempt(name, path)
        took = time.process_time() - began
        faulthandler.cancel_dump_traceback_later()
        refused += fault == ""
        slowest = max(slowest, (took, number))
        if took > SECONDS:
            fault = f"took {took:.1f} s"
        if fault:
            print(json.dumps({"at": number, "fault": fault}), flush=True)
    grown = _peak() - at_rest
    told = {"refused": refused, "slowest_s": slowest[0], "slowest": slowest[1], "grown_bytes": max(grown, 0)}
    print(json.dumps(told), flush=True)


def attempt(name: str, path: Path) -> str | None:
    """What is wrong with how a file was read; "" where it was refused as it should be, None where it was accepted."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            fault = FORMATS[name].read(path)
        except JaxrbError:
            fault = ""
        except BaseException as error:  # SystemExit, MemoryError and KeyboardInterrupt are faults too
            where = error.__traceback__
            while where is not None and where.tb_next is not None:
                where = where.tb_next
            line = f"{Path(where.tb_frame.f_code.co_filename).name}:{where.tb_lineno}" if where else "?"
            fault = f"{type(error).__name__} at {line}: {str(error)[:120]}"
    # What Python says of the text of a scene's own program is between the two of them.
    foreign = [w for w in caught if not issubclass(w.category, (JaxrbWarning, SyntaxWarning))]
    if not fault and foreign:
        return f"{foreign[0].category.__name__}: {str(foreign[0].message)[:120]}"
    return fault


def _limit_memory() -> int:
    """Allow so much more address space than there is now, where the system counts it; the peak of bytes so far."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    except OSError:
        pass  # only Linux says it; there the limit is held, elsewhere what was taken is told in the end
    else:
        limit = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    return _peak()


def _peak() -> int:
    """Bytes of memory that this process has held at most."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return 1024 * next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:6]))
