"""Mesh files written byte by byte, so that each can be damaged where a test wants it."""

import json
import struct

import numpy as np


def binary_stl(vertices, triangles, count=None):
    """With a false `count` where one is given."""
    record = np.zeros(
        len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    record["corners"] = vertices[triangles]
    return (
        b"solid".ljust(80) + struct.pack("<I", len(triangles) if count is None else count) + record.tobytes()
    )


def text_stl(vertices, triangles):
    facets = [
        "facet normal 0 0 0\n outer loop\n"
        + "".join("  vertex {:.17g} {:.17g} {:.17g}\n".format(*corner) for corner in corners)
        + " endloop\nendfacet\n"
        for corners in vertices[triangles]
    ]
    return ("solid a facet of vertex\n" + "".join(facets) + "endsolid\n").encode()


def obj(vertices, triangles, negative=False):
    shift = -len(vertices) if negative else 1
    lines = ["# made for a test", "mtllib away.mtl", "o part", "vn 0 0 1"]
    lines += ["v {:.17g} {:.17g} {:.17g}".format(*vertex) for vertex in vertices]
    lines += ["f " + " ".join(f"{i + shift}//1" for i in triangle) for triangle in triangles]
    return "\n".join(lines).encode()


def ply(vertices, faces, order="binary_little_endian"):
    """With a colour after each vertex and a number before each face."""
    header = (
        f"ply\nformat {order} 1.0\ncomment x\nelement vertex {len(vertices)}\nproperty double x\nproperty double y\n"
        f"property double z\nproperty uchar red\nelement face {len(faces)}\nproperty int part\n"
        "property list uchar int vertex_indices\nend_header\n"
    ).encode()
    if order == "ascii":
        lines = ["{:.17g} {:.17g} {:.17g} 7".format(*vertex) for vertex in vertices]
        lines += [f"3 {len(face)} " + " ".join(map(str, face)) for face in faces]
        return header + "\n".join(lines).encode() + b"\n"
    sign = "<" if "little" in order else ">"
    body = b"".join(struct.pack(sign + "dddB", *vertex, 7) for vertex in vertices)
    return header + body + b"".join(struct.pack(f"{sign}iB{len(f)}i", 3, len(f), *f) for f in faces)


def glb_document(vertices, triangles):
    """The JSON of a file with one mesh, one node, and its bytes."""
    positions, indices = vertices.astype("<f4").tobytes(), triangles.astype("<u2").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3 * len(triangles), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(positions)},
            {"buffer": 0, "byteOffset": len(positions), "byteLength": len(indices)},
        ],
        "buffers": [{"byteLength": len(positions) + len(indices)}],
    }
    return document, positions + indices


def glb(document, blob):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks
