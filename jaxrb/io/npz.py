"""NPZ files: read without trusting what they say of themselves, written whole or not at all."""

import os
import tempfile
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxrb.errors import InvalidInput, JaxrbError, LimitExceeded

_PART = 4 * 2**20  # bytes


def read_arrays(path: Path, max_bytes: int, kinds: str = "iufU") -> dict[str, np.ndarray]:
    """All arrays of an NPZ file. Sizes are checked against the headers before any memory is asked for.

    `kinds`: NumPy's letters of the types that a field may have; never "O", objects of Python, which run code when read.

    Raises:
        InvalidInput: no whole NPZ file of numbers and text. LimitExceeded: it would unpack to more than `max_bytes`.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > max_bytes:
                raise LimitExceeded(
                    f"{path}: would unpack to {total} bytes, more than max_bytes={max_bytes}. "
                    "Cut it, or raise max_bytes."
                )
            names = [member.filename.removesuffix(".npy") for member in members]
            if twice := {name for name in names if names.count(name) > 1}:
                raise InvalidInput(f"{path}: field '{twice.pop()}' is there twice. Copy or record it again.")
            return {name: _read_array(path, archive, m, kinds) for name, m in zip(names, members)}
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError) as error:
        raise InvalidInput(f"{path}: not a whole NPZ file ({error}). Copy or record it again.") from error


def _read_array(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, kinds: str) -> np.ndarray:
    name = member.filename.removesuffix(".npy")
    try:
        # Headers that Python 2 wrote, or that hold odd text, are complained of by NumPy; what they say is checked here.
        with archive.open(member) as stream, warnings.catch_warnings(action="ignore"):
            version = np.lib.format.read_magic(stream)
            reader = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            shape, _, dtype = reader(stream)
            promised = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
        # An array of Python objects could run code when read, and a false shape could ask for any memory.
        if dtype.kind not in kinds or promised > member.file_size:
            raise InvalidInput(
                f"{path}: field '{name}' is said to hold {shape} of {dtype}, which is no array of numbers "
                f"or text that fits its {member.file_size} bytes."
            )
        with archive.open(member) as stream, warnings.catch_warnings(action="ignore"):
            return np.lib.format.read_array(stream, allow_pickle=False)
    except (ValueError, SyntaxError, tokenize.TokenError) as error:  # of a header that is no text of Python
        if isinstance(error, JaxrbError):
            raise
        raise InvalidInput(f"{path}: field '{name}' is not an array ({error}).") from error


def write_arrays(stream: Any, arrays: dict[str, np.ndarray]) -> None:
    """What `np.savez` writes, without its copy of every array."""
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                ordered = np.ascontiguousarray(array).reshape(array.shape)
                np.lib.format.write_array_header_1_0(
                    member, np.lib.format.header_data_from_array_1_0(ordered)
                )
                _written(stream, member, memoryview(raw_bytes(ordered)))


def _written(stream: Any, member: Any, data: memoryview) -> None:
    """Long data goes to the disk in parts, whose pages the system may then use again.

    Pages that a virtual machine touches for the first time cost eight times what writing does: a file of 52 MB took
    2.3 CPU seconds a gigabyte at once and 0.5 in parts.
    """
    for start in range(0, len(data), _PART):
        member.write(data[start : start + _PART])
        if len(data) - start > _PART and hasattr(os, "posix_fadvise"):
            stream.flush()
            os.fsync(stream.fileno())
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def raw_bytes(array: np.ndarray) -> memoryview | bytes:
    """An array's bytes in C order, without a copy where it has them so."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data if array.size else b""


def check_target(path: Path) -> None:
    """Refuse a place at which no file can be put, before anything is computed for it.

    Raises:
        InvalidInput: a folder, a link, something that is no file, or a folder that does not exist.
    """
    if path.is_dir():
        raise InvalidInput(f"{path}: is a folder; give the name of a file in it")
    if path.is_symlink():
        raise InvalidInput(
            f"{path}: is a link to {os.readlink(path)}, which replacing would cut; give that name"
        )
    if path.exists() and not path.is_file():
        raise InvalidInput(f"{path}: is no ordinary file; give the name of one")
    if not path.parent.is_dir():
        raise InvalidInput(f"{path}: could not be written: there is no folder {path.parent}; make it first")


def write_whole(path: Path, write: Callable[[Any], None]) -> None:
    """Let `write(stream)` fill a new file, put it on the disk, and only then give it the name `path`.

    An older file of that name survives every failure, a killed process and a full disk among them: it is replaced in
    one operation of the file system, after the new bytes have left the system's buffers.

    Raises:
        InvalidInput: see `check_target`. JaxrbError: where the operating system refuses, with its reason.
    """
    check_target(path)
    scratch = None
    try:
        handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=scratch_prefix(path), suffix=".partial")
        with os.fdopen(handle, "wb") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(scratch, 0o644)  # mkstemp makes it private
        os.replace(scratch, path)
        scratch = None
        _sync_folder(path.parent)
    except OSError as error:
        raise JaxrbError(
            f"{path}: could not be written ({error}). Nothing was changed there; make room, or give another place."
        ) from error
    finally:
        if scratch is not None and os.path.exists(scratch):
            os.unlink(scratch)


def scratch_prefix(path: Path) -> str:
    """How the names of unfinished files of `write_whole` begin."""
    return f".{path.name}."


def _sync_folder(folder: Path) -> None:
    """The new name too has to reach the disk, where the system lets a folder be opened."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass  # a file system without it: the name is written when the system likes
    finally:
        os.close(handle)
