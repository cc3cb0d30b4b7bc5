"""STL, binary and text (Burns 1993, "Automated fabrication", section 6.5; 3D Systems 1989)."""

import re
import warnings

import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.io.mesh_bytes import Arrays, too_many

_HEADER, _RECORD = 84, 50
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# Longer words first, since each is blanked out before the next is counted; and how often a facet has it.
_WORDS = (
    (b"endfacet", 1),
    (b"endloop", 1),
    (b"facet", 1),
    (b"normal", 1),
    (b"outer", 1),
    (b"loop", 1),
    (b"vertex", 3),
)


def read_stl(where: str, data: bytes, max_triangles: int) -> Arrays:
    """Every corner a vertex of its own; normals are ignored, since the order of the corners says them."""
    count = int.from_bytes(data[80:84], "little") if len(data) >= _HEADER else -1
    # Binary files may begin with the word "solid" too; only the length tells.
    if count >= 0 and len(data) == _HEADER + _RECORD * count:
        if count > max_triangles:
            raise too_many(where, count, max_triangles)
        corners = np.frombuffer(data, _FACET, count, _HEADER)["corners"].astype(float).reshape(-1, 3)
    elif data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        corners = _text_corners(where, data, max_triangles)
    else:
        raise InvalidInput(
            f"{where}: no whole binary STL file: {len(data)} bytes are there, but its header says {max(count, 0)} "
            f"triangles, which take {_HEADER + _RECORD * max(count, 0)}; it is cut or no STL; export it again"
        )
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _text_corners(where: str, data: bytes, max_triangles: int) -> np.ndarray:
    # Names of solids may hold anything; everything else is keywords and numbers.
    names = re.compile(rb"^[ \t]*(?:end)?solid\b[^\r\n]*", re.IGNORECASE | re.MULTILINE)
    if b"endsolid" not in data.rstrip().rsplit(b"\n", 1)[-1].lower():
        raise InvalidInput(f"{where}: text STL without 'endsolid' at its end; it is cut; export it again")
    body = names.sub(b"", data).lower()
    count = body.count(b"endfacet")
    if count > max_triangles:
        raise too_many(where, count, max_triangles)
    for word, each in _WORDS:
        found = body.count(word)
        body = body.replace(word, b" ")
        if found != each * count:
            raise InvalidInput(
                f"{where}: text STL with {count} facets, but the word {word.decode()!r} is there {found} times, "
                f"not {each * count}; it is damaged; export it again"
            )
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", DeprecationWarning
        )  # said of text that stops being numbers: counted below
        try:
            numbers = np.fromstring(body, float, sep=" ")
        except ValueError:
            numbers = np.empty(0)
    if numbers.size != 12 * count:
        raise InvalidInput(
            f"{where}: text STL with {count} facets, but {numbers.size} numbers can be read, not {12 * count}; "
            "it is damaged; export it again"
        )
    return numbers.reshape(-1, 4, 3)[:, 1:].reshape(-1, 3)
