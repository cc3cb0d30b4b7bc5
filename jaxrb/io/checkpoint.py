"""Files of runs: all that a run needs to go on, or to be looked at again, in an NPZ file without pickle.

header        text, JSON: schema, versions, settings, the scene's fingerprint, why a failed run stopped
origin_…      scene, method, initial state and torque, as far as they can be written
progress_…    what the next step needs
saved_…       the states saved so far
checksum      SHA-256 of the names, types, shapes and SHA-256s of all of these (of schema 1: of all at once)
"""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxrb.checks import warn
from jaxrb.errors import InvalidInput, JaxrbError, WrongStructure
from jaxrb.io.npz import check_target, raw_bytes, read_arrays, scratch_prefix, write_arrays, write_whole
from jaxrb.io.tree import checksum, decoded, digest, encoded

SCHEMA = 2
CHECKPOINT, FAILURE = "checkpoint", "failure"


class Sums:
    """SHA-256 of arrays that grow by rows at their end: each byte is read once, in however many files it stands."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[Any, int]] = {}  # the sum of so many rows

    def of(self, arrays: dict[str, np.ndarray]) -> dict[str, str]:
        """The sums of arrays by name, of which only the rows that are new are read."""
        found = {}
        for name, array in arrays.items():
            known, rows = self._seen.get(name, (hashlib.sha256(), 0))
            grown = known.copy()
            grown.update(raw_bytes(array[rows:]))
            self._seen[name] = (
                grown,
                len(array),
            )  # at once: Ctrl-C may come anywhere, and another file after it
            found[name] = grown.hexdigest()
        return found


def write(
    path: Path, header: dict[str, Any], origin: dict[str, Any], progress: Any, saved: Any, sums: Sums
) -> None:
    """Write a run's file, whole or not at all.

    `origin`: trees of jaxrb's classes by name; of one that holds a function the file says that it is missing, and the
    program that wrote it has to give it again. `progress`, `saved`: trees whose structure the reader knows. `sums`: of
    what was saved in the files before.
    """
    arrays: dict[str, np.ndarray] = {}
    host: list[np.ndarray] = []
    kept, missing = {}, {}
    for name, part in origin.items():
        try:
            kept[name] = encoded(part, host)
        except WrongStructure as error:
            missing[name] = str(error)
    header = header | {"origin": kept, "missing": missing}
    for name, leaves in (
        ("origin", host), ("progress", jax.tree.leaves(progress)), ("saved", jax.tree.leaves(saved))
    ):  # fmt: skip
        arrays |= {f"{name}_{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
    text = json.dumps(header | {"schema": SCHEMA, "jax": jax.__version__}, sort_keys=True)
    arrays["header"] = np.asarray(text)
    known = sums.of({name: array for name, array in arrays.items() if name.startswith("saved_")})
    arrays["checksum"] = np.asarray(checksum(arrays, known))
    write_whole(path, lambda stream: write_arrays(stream, arrays))


class RunFile:
    """A run's file, read and checked; `header` and the arrays of each part.

    Raises:
        InvalidInput: no such file, damaged, or of a newer jaxrb. LimitExceeded: more than `max_bytes`.
    """

    def __init__(self, path: Path, max_bytes: int):
        if not path.is_file():
            raise InvalidInput(f"{path}: no such file (or not a file); give the path of a run's file")
        arrays = read_arrays(path, max_bytes, "iufUb")
        if not {"header", "checksum"} <= set(arrays):
            raise InvalidInput(f"{path}: no file of a run: it has no header and checksum")
        told = str(arrays.pop("checksum"))
        if told != (found := checksum(arrays)) and told != digest(arrays):
            raise InvalidInput(
                f"{path}: the checksum is {found[:12]}…, but {told[:12]}… was written: the file has changed since; "
                "take an earlier copy"
            )
        self.path = path
        self.header = self._header(str(arrays.pop("header")))
        self._arrays = arrays

    def _header(self, text: str) -> dict[str, Any]:
        try:
            header = dict(json.loads(text))
            schema = header["schema"]
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise InvalidInput(f"{self.path}: its header is no JSON of a run ({error})") from None
        if not isinstance(schema, int) or not 1 <= schema <= SCHEMA:
            raise InvalidInput(
                f"{self.path}: its schema is {schema!r}; this jaxrb reads 1 to {SCHEMA}: update jaxrb"
            )
        if header.get("jax") != jax.__version__:
            warn(
                f"{self.path}: was written with jax {header.get('jax')}, this is {jax.__version__}: what follows may "
                "differ from an uninterrupted run in the last bits"
            )
        return header

    def expect(self, name: str, value: Any, mend: str) -> None:
        """Refuse a file whose header says anything else of `name`."""
        told = self.header.get(name)
        if told != value:
            raise InvalidInput(
                f"{self.path}: {name} is {_short(told)} there and {_short(value)} here; {mend}"
            )

    def number(self, name: str) -> int:
        """A count in the header."""
        value = self.header.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**31:
            raise InvalidInput(f"{self.path}: {name} is {_short(value)} in its header, but must be a count")
        return value

    def origin(self, name: str, kind: type = object) -> Any:
        """Something that the run began with, a `kind`.

        Raises:
            InvalidInput: the file could not hold it, and says why; or holds something else.
        """
        kept, missing = (self.header.get(part) for part in ("origin", "missing"))
        if not isinstance(kept, dict) or name not in kept:
            why = missing.get(name) if isinstance(missing, dict) else None
            raise InvalidInput(
                f"{self.path}: holds no {name} ({why or 'it was not written'}); give {name}=… as it was"
            )
        arrays = [
            self._arrays[key] for i in range(len(self._arrays)) if (key := f"origin_{i}") in self._arrays
        ]
        made = decoded(kept[name], arrays, str(self.path))
        if not isinstance(made, kind):
            raise InvalidInput(
                f"{self.path}: its {name} is a {type(made).__name__}, not a {kind.__name__}; rb.run did not write it"
            )
        return made

    @contextmanager
    def must_fit(self) -> Iterator[None]:
        """While a program is made of what is in the file: that it cannot be made is the file's fault.

        A checksum that is right says only that the bytes are those that somebody wrote.
        """
        try:
            yield
        except JaxrbError:
            raise
        except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
            raise InvalidInput(
                f"{self.path}: what is in it makes no run ({type(error).__name__}: {_short(str(error))}); was it "
                "written by rb.run, with this scene?"
            ) from error

    def tree(self, name: str, like: Any, rows: bool = False) -> Any:
        """The part `name` in the structure of `like`, an example of its shapes; `rows`: with a leading axis more."""
        examples, structure = jax.tree.flatten(like)
        found = []
        for i, example in enumerate(examples):
            array = self._arrays.get(f"{name}_{i}")
            shape = None if array is None else array.shape[1:] if rows else array.shape
            if array is None or shape != np.shape(example) or array.dtype != example.dtype:
                told = "missing" if array is None else f"{array.dtype}{list(array.shape)}"
                raise InvalidInput(
                    f"{self.path}: array {name}_{i} is {told}, which is no part of this run; was it written by "
                    "another scene, method or version?"
                )
            found.append(array)
        return jax.tree.unflatten(structure, found)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:56]}…"


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold the right to write `path`; the system takes it back from a process that dies.

    Raises:
        JaxrbError: another process holds it, or the folder cannot be written to.
    """
    check_target(path)
    lock = path.with_name(f"{path.name}.lock")
    try:
        import fcntl
    except (
        ImportError
    ):  # no such locks on this system: two writers each write whole files, the later one stays
        yield
        return
    try:
        handle = os.open(lock, os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0), 0o644)
    except OSError as error:
        raise JaxrbError(f"{path}: could not be written ({error}); give another place") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise JaxrbError(
                f"{path}: another run writes there ({error}); wait for it, or give another file"
            ) from error
        for left in path.parent.glob(f"{scratch_prefix(path)}*.partial"):  # of processes that were killed
            left.unlink(missing_ok=True)
        yield
    finally:
        # The lock file stays: taking it away would let two processes lock two files of one name.
        os.close(handle)
