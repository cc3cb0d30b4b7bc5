"""Reading triangle meshes: STL, OBJ, PLY and GLB, each by a strict reader of its own.

Readers of our own, in NumPy alone: a general loader trusts what a file says of itself, so that counts, sizes, indices,
references to other files and loops would all have to be checked before it sees the bytes, which is most of the work of
reading them. Sizes are checked against the bytes that are there before memory is asked for.
"""

import os
from pathlib import Path
from typing import Literal

import numpy as np

from jaxrb.errors import InvalidInput, JaxrbError, LimitExceeded
from jaxrb.geometry.mesh import TriangleMesh, merged
from jaxrb.io.mesh_bytes import too_many
from jaxrb.io.mesh_glb import read_glb
from jaxrb.io.mesh_obj import read_obj
from jaxrb.io.mesh_ply import read_ply
from jaxrb.io.mesh_stl import read_stl

_READERS = {".stl": read_stl, ".obj": read_obj, ".ply": read_ply, ".glb": read_glb}
_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
_PACKED = {
    b"PK\x03\x04": "zip",
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"(\xb5/\xfd": "zstd",
}

Unit = Literal["m", "cm", "mm", "in", "ft"]


def read_mesh(
    file: str | os.PathLike,
    *,
    unit: Unit = "m",
    max_triangles: int = 1_000_000,
    max_bytes: int = 2**29,
) -> TriangleMesh:
    """Read a triangle mesh from an STL, OBJ, PLY or GLB file.

    Vertices that are equal to the last digit become one. Polygons are cut into triangles from their first corner. All
    geometries of a GLB file become one mesh, each placed as its nodes say; the file's axes are kept (glTF has y up).

    Args:
        unit: of the file's lengths; only glTF says itself (metres).
        max_triangles, max_bytes: refuse files with more.

    Raises:
        InvalidInput: naming the file and the place, if it is missing, cut, packed, not what its name says, refers to
            other files, or holds a surface that `TriangleMesh` refuses. LimitExceeded: beyond the limits.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise InvalidInput(
            f"{path}: meshes are read from {', '.join(_READERS)}, not {suffix!r}; unpack or convert it"
        )
    if unit not in _METRES:
        raise InvalidInput(f"{path}: unit={unit!r} is not known; choose {', '.join(_METRES)}")
    data = _bytes_of(path, max_bytes)
    # NumPy complains of a signalling NaN when it is touched; the mesh refuses every NaN, and says where it is.
    with np.errstate(invalid="ignore"):
        vertices, triangles = _READERS[suffix](str(path), data, max_triangles)
        vertices = _METRES[unit] * vertices
    if not len(triangles):
        raise InvalidInput(f"{path}: there are no triangles in it; is it the right file?")
    if len(triangles) > max_triangles:
        raise too_many(str(path), len(triangles), max_triangles)
    outside = (triangles < 0) | (triangles >= len(vertices))
    if outside.any():
        row, corner = np.argwhere(outside)[0]
        raise InvalidInput(
            f"{path}: triangle {row} names vertex {triangles[row, corner]}, but there are {len(vertices)}; is it cut?"
        )
    vertices, triangles = merged(vertices, triangles)
    used, renumbered = np.unique(triangles, return_inverse=True)
    return TriangleMesh(vertices[used], renumbered.reshape(-1, 3), name=path.name)


def _bytes_of(path: Path, max_bytes: int) -> bytes:
    try:
        if not path.is_file():
            raise InvalidInput(f"{path}: no such file (or not a file); give the path of a mesh")
        size = path.stat().st_size
        if size > max_bytes:
            raise LimitExceeded(
                f"{path}: {size} bytes are more than max_bytes={max_bytes}; simplify it or raise that"
            )
        data = path.read_bytes()
    except OSError as error:
        raise JaxrbError(f"{path}: could not be read ({error})") from error
    if not data.strip(b"\0 \t\r\n"):
        raise InvalidInput(f"{path}: the file is empty; export it again")
    for magic, kind in _PACKED.items():
        if data.startswith(magic):
            raise InvalidInput(f"{path}: this is a {kind} archive; unpack it and give the mesh inside")
    return data
