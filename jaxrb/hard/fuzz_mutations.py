"""Ways to spoil a file: what disks, transfers, editors and ill will do to bytes, text and archives."""

import io
import json
import re
import struct
import warnings
import zipfile
from collections.abc import Sequence
from typing import Any

import numpy as np

Random = np.random.Generator

_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]\w*")
# Numbers at which counts, sizes, signs and floating types end, and text that only looks like a number.
_TEXTS = (
    b"0", b"-0", b"-1", b"1", b"255", b"65536", b"2147483647", b"4294967295", b"9223372036854775808", b"1" * 400,
    b"9" * 5000, b"1e308", b"1e999", b"-1e999", b"1e-320", b"nan", b"inf", b"-Infinity", b"0x10", b"1_0", b"1,5",
    b"", b"\xc2\xbd", b"\xd9\xa1", b"true", b"None", b"[]", b"{}", b'"x"', b"1.", b".", b"--1", b"1e",
)  # fmt: skip
_PIECES = (
    *(struct.pack("<I", n) for n in (0, 1, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1)),
    *(struct.pack(">I", n) for n in (1, 2**31 - 1)),
    *(struct.pack("<f", x) for x in (float("nan"), float("inf"), 3e38, 1e-45)),
    *(struct.pack("<d", x) for x in (float("nan"), float("-inf"), 1e300, 5e-324)),
    b"\0" * 16,
    b"\xff" * 16,
    b"\n",
    b"\r\n",
    b"\xef\xbb\xbf",
)


def of_bytes(data: bytes, random: Random, others: Sequence[bytes]) -> bytes:
    """One to four injuries anywhere: flipped bits, cuts, repeats, false numbers, another file's beginning."""
    injured = bytearray(data)
    for _ in range(random.integers(1, 5)):
        at = int(random.integers(len(injured) + 1))
        size = int(min(len(injured) - at, 2 ** random.integers(0, 10)))
        kind = random.integers(9)
        if kind == 0 and injured:
            for place in random.integers(0, len(injured), random.integers(1, 9)):
                injured[place] ^= 1 << int(random.integers(8))
        elif kind == 1:
            del injured[at:]
        elif kind == 2:
            del injured[at : at + size]
        elif kind == 3:
            injured[at:at] = injured[at : at + size] * int(random.integers(1, 5))
        elif kind == 4:
            injured[at:at] = random.bytes(size)
        elif kind in (5, 6):
            piece = _PIECES[int(random.integers(len(_PIECES)))]
            injured[at : at + (len(piece) if kind == 5 else 0)] = piece
        elif kind == 7:
            other = others[int(random.integers(len(others)))]
            injured[:size] = other[:size]
        else:
            # Counts and offsets stand near the beginning.
            early = int(random.integers(min(len(injured), 256) + 1))
            injured[early : early + 4] = _PIECES[int(random.integers(7))]
    return bytes(injured)


def of_text(data: bytes, random: Random, others: Sequence[bytes]) -> bytes:
    """One to four: numbers and words exchanged, lines dropped, doubled or swapped; sometimes bytes."""
    for _ in range(random.integers(1, 5)):
        kind = random.integers(6)
        if kind in (0, 1):
            data = _exchanged(_NUMBER, data, random, _TEXTS)
        elif kind == 2:
            words = _WORD.findall(data) or [b"x"]
            data = _exchanged(_WORD, data, random, words)
        elif kind in (3, 4):
            lines = data.split(b"\n")
            a, b = random.integers(0, len(lines), 2)
            if kind == 3:
                lines[a : a + 1] = [] if random.integers(2) else [lines[b]] * int(random.integers(1, 50))
            else:
                lines[a], lines[b] = lines[b], lines[a]
            data = b"\n".join(lines)
        else:
            data = of_bytes(data, random, others)
    return data


def _exchanged(pattern: re.Pattern, data: bytes, random: Random, by: Sequence[bytes]) -> bytes:
    found = list(pattern.finditer(data))
    if not found:
        return data
    match = found[int(random.integers(len(found)))]
    return data[: match.start()] + by[int(random.integers(len(by)))] + data[match.end() :]


def of_json(document: Any, random: Random) -> Any:
    """Something else in one place of a tree of lists and objects; the tree is changed."""
    holders = [part for part in _parts(document) if part]
    if not holders:
        return document
    holder: Any = holders[random.integers(len(holders))]
    keys = list(holder) if isinstance(holder, dict) else range(len(holder))
    key = keys[random.integers(len(keys))]
    values = (
        None,
        -1,
        0,
        1,
        2**31,
        2**63,
        1e308,
        float("nan"),
        "",
        "x",
        "../x",
        [],
        {},
        [[]],
        True,
        [0] * 1000,
    )
    kind = random.integers(4)
    if kind == 0:
        del holder[key]
    elif kind == 1:
        donor: Any = holders[random.integers(len(holders))]
        holder[key] = next(iter(donor.values())) if isinstance(donor, dict) else donor[0]
        # A tree that holds itself cannot be written down.
        try:
            json.dumps(document)
        except (ValueError, RecursionError):
            holder[key] = None
    else:
        holder[key] = values[random.integers(len(values))]
    return document


def _parts(tree: Any) -> list[Any]:
    found, waiting = [], [tree]
    while waiting:
        part = waiting.pop()
        if isinstance(part, (dict, list)):
            found.append(part)
            waiting += part.values() if isinstance(part, dict) else part
    return found


def of_array(array: np.ndarray, random: Random) -> np.ndarray:
    """Another shape, type, size or value."""
    flat = array.ravel()
    numbers = flat.copy()
    if flat.size and flat.dtype.kind == "f":
        with np.errstate(over="ignore"):  # in float32 a large number is infinite
            numbers[random.integers(flat.size)] = random.choice([np.nan, np.inf, -1.0, 1e300, 0.0, 5e-324])
    elif flat.size and flat.dtype.kind in "iu":
        numbers[random.integers(flat.size)] = random.choice([0, 1, 99, np.iinfo(flat.dtype).max])
    choices = (
        flat[:1], flat[: flat.size // 2], array[None], np.zeros(0), np.zeros((0, 3)), np.asarray("x"),
        np.asarray(["nan"] * 3), np.repeat(flat, 2), np.zeros(2**14), np.asarray(True), array.astype("U8"),
        *(numbers.reshape(array.shape),) * 6,
    )  # fmt: skip
    return choices[random.integers(len(choices))]


def of_archive(data: bytes, random: Random, others: Sequence[bytes]) -> bytes:
    """Members of an NPZ file changed, renamed, dropped, doubled, with false headers; the archive's checksums right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    for _ in range(random.integers(1, 4)):
        if not members:
            break
        i = int(random.integers(len(members)))
        name, body = members[i]
        kind = random.integers(8)
        if kind == 0:
            del members[i]
        elif kind == 1:
            members[i] = (members[random.integers(len(members))][0], body)
        elif kind == 2:
            members[i] = (str(random.choice(["x.npy", "../x.npy", "x", ".npy", "/etc/x.npy"])), body)
        elif kind == 3:
            members[i] = (name, of_bytes(body, random, others))
        elif kind == 4:
            # NumPy's header is text: its types, shapes and order lie.
            head, rest = body[:128], body[128:]
            members[i] = (name, of_text(head, random, others)[:128].ljust(128) + rest)
        else:
            try:
                with warnings.catch_warnings(action="ignore"):
                    array = np.load(io.BytesIO(body))
            except Exception:  # it was spoiled a moment ago
                continue
            members[i] = (name, saved(of_array(array, random)))
    return zipped(members, random)


def saved(array: np.ndarray) -> bytes:
    """The bytes of an NPY file."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def zipped(members: Sequence[tuple[str, bytes]], random: Random) -> bytes:
    """An archive of them, packed or not."""
    stream = io.BytesIO()
    packing = zipfile.ZIP_DEFLATED if random.integers(2) else zipfile.ZIP_STORED
    # Two members of one name are among what is tried.
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(stream, "w", packing) as archive:
        for name, body in members:
            info = zipfile.ZipInfo(name)
            info.compress_type = packing
            archive.writestr(info, body)
    return stream.getvalue()
