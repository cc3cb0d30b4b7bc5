"""Wavefront OBJ: its polygons; curves, lines, points and looks are not geometry of a solid (Wavefront 1992)."""

import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.io.mesh_bytes import Arrays, fanned, real, shown, too_many, whole

_IGNORED = {
    b"vn",
    b"vt",
    b"g",
    b"o",
    b"s",
    b"mg",
    b"usemtl",
    b"mtllib",
    b"usemap",
    b"maplib",
    b"l",
    b"p",
    b"lod",
}
_IGNORED |= {b"bevel", b"c_interp", b"d_interp", b"shadow_obj", b"trace_obj"}


def read_obj(where: str, data: bytes, max_triangles: int) -> Arrays:
    """Vertices and polygons of all groups together; materials and other files it names are not looked at."""
    vertices: list[tuple[float, float, float]] = []
    polygons: list[list[int]] = []
    lines = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    for number, line in enumerate(lines, 1):
        words = line.split(b"#", 1)[0].split()
        if not words:
            continue
        here = f"{where}, line {number}"
        if words[0] == b"v":
            # A fourth number is a weight, six are a place and a colour.
            if len(words) not in (4, 5, 7, 8):
                raise InvalidInput(f"{here}: a vertex of {len(words) - 1} numbers; three are needed")
            vertices.append((real(here, words[1]), real(here, words[2]), real(here, words[3])))
        elif words[0] == b"f":
            if len(words) < 4:
                raise InvalidInput(f"{here}: a face of {len(words) - 1} corners; three are needed")
            polygons.append([_corner(here, word, len(vertices)) for word in words[1:]])
            if len(polygons) > max_triangles:
                raise too_many(where, len(polygons), max_triangles)
        elif words[0] not in _IGNORED:
            raise InvalidInput(
                f"{here}: {shown(words[0])} is no element of a polygon mesh; is it an OBJ file?"
            )
    triangles = fanned(where, polygons, max_triangles)
    return np.array(vertices, float).reshape(-1, 3), triangles


def _corner(here: str, word: bytes, count: int) -> int:
    """The vertex number, from 0, of a corner such as 7, 7/1, 7//3, 7/1/3 or −1, which is the last so far."""
    index = whole(here, word.split(b"/", 1)[0])
    place = index - 1 if index > 0 else count + index
    # A face may name vertices that follow it only by positive numbers; their number is checked at the end.
    if index == 0 or place < 0:
        raise InvalidInput(
            f"{here}: a face names vertex {index}, but {count} vertices stand before it, numbered from 1; is it cut?"
        )
    return place
