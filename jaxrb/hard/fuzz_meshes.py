"""Meshes for the fuzzer: whole ones of each format to spoil, and what reads them."""

import json
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxrb.hard import fuzz_mutations as spoil
from jaxrb.io.mesh import read_mesh

_VERTICES = 0.5 * np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
_FACES = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
_TRIANGLES = np.concatenate([_FACES[:, [0, 1, 2]], _FACES[:, [0, 2, 3]]])


def stl() -> list[bytes]:
    """Whole files."""
    record = np.zeros(12, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = _VERTICES[_TRIANGLES]
    facets = [
        "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        + "endloop\nendfacet\n" for corners in _VERTICES[_TRIANGLES].tolist()
    ]  # fmt: skip
    return [
        b"a box".ljust(80) + struct.pack("<I", 12) + record.tobytes(),
        ("solid box\n" + "".join(facets) + "endsolid box\n").encode(),
    ]


def obj() -> list[bytes]:
    """Whole files."""
    lines = ["# a box", "mtllib box.mtl", "o box", *(f"v {x} {y} {z}" for x, y, z in _VERTICES.tolist())]
    whole = [*lines, "vn 0 0 1", *("f " + " ".join(f"{i + 1}//1" for i in face) for face in _FACES)]
    back = [*lines, *("f " + " ".join(str(i - 8) for i in face) for face in _FACES)]
    return ["\n".join(text).encode() for text in (whole, back)]


def ply() -> list[bytes]:
    """Whole files."""
    found = []
    for order, sign in (("ascii", ""), ("binary_little_endian", "<"), ("binary_big_endian", ">")):
        header = (
            f"ply\nformat {order} 1.0\ncomment a box\nelement vertex 8\nproperty float x\nproperty float y\n"
            "property float z\nproperty uchar red\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
        ).encode()
        if not sign:
            rows = [f"{x} {y} {z} 7" for x, y, z in _VERTICES.tolist()]
            rows += [f"{len(face)} " + " ".join(map(str, face)) for face in _FACES]
            found.append(header + "\n".join(rows).encode() + b"\n")
            continue
        body = b"".join(struct.pack(f"{sign}fffB", *vertex, 7) for vertex in _VERTICES)
        found.append(header + body + b"".join(struct.pack(f"{sign}B4i", 4, *face) for face in _FACES))
    return found


def glb() -> list[bytes]:
    """Whole files."""
    points, order = _VERTICES.astype("<f4").tobytes(), _TRIANGLES.astype("<u2").tobytes()
    quarter = [0.0, 0.0, 0.7071067811865476, 0.7071067811865476]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"children": [1, 2], "rotation": quarter, "translation": [1.0, 2.0, 3.0]},
            {"mesh": 0, "scale": [1.0, 2.0, -1.0]},
            {"mesh": 0, "matrix": [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0, 5.0, 0, 0, 1.0]},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 4}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points), "byteStride": 12},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(order)},
        ],
        "buffers": [{"byteLength": len(points) + len(order)}],
    }
    return [_glb_file(json.dumps(document).encode(), points + order)]


def _glb_file(text: bytes, blob: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def of_glb(data: bytes, random: spoil.Random, others: Sequence[bytes]) -> bytes:
    """Its JSON changed, as a tree or as text, and the lengths of its chunks made to agree."""
    size = int.from_bytes(data[12:16], "little")
    text, blob = data[20 : 20 + size], data[28 + size :]
    if random.integers(2):
        document = json.loads(text)
        for _ in range(random.integers(1, 4)):
            document = spoil.of_json(document, random)
        return _glb_file(json.dumps(document).encode(), blob)
    return _glb_file(spoil.of_text(text, random, others), blob)


def read(path: Path) -> str | None:
    """Read one; a complaint where what was accepted is no body."""
    mesh = read_mesh(path)
    found = mesh.mass_properties(700.0)
    numbers = (mesh.vertices, found.mass, found.center_of_mass, found.inertia.as_matrix())
    if not all(np.isfinite(np.asarray(part)).all() for part in numbers):
        return "a body that is not finite"
    return None if float(found.mass) > 0 else "a body without mass"
