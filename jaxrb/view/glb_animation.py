"""A run as binary glTF 2.0 with an animation, for Blender and other programs (Khronos Group 2021)."""

import json
import os
import struct
from pathlib import Path as File
from typing import Any

import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.io.npz import write_whole
from jaxrb.scene.path import Path
from jaxrb.view.viewer_record import check_path
from jaxrb.view.viewer_scene import Seen, bodies_of, obstacles_of
from jaxrb.view.viewer_surfaces import Part, Surface, quaternion_of

_FLOAT, _UNSIGNED = 5126, 5125
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_Z_UP = [
    -np.sqrt(0.5),
    0.0,
    0.0,
    np.sqrt(0.5),
]  # glTF has y up; Blender turns it back, so z is up there again
# The viewer's colours, as linear light.
COLOURS = [(91, 141, 184), (221, 154, 87), (111, 165, 138), (185, 121, 155), (215, 189, 92), (127, 134, 196)]
STILL = (154, 154, 150)


def save_glb(path: Path, file: str | os.PathLike) -> File:
    """Write a run as a GLB file: a node for each body, with its shape, and an animation of all saved states.

    Keys are the saved times less the first, positions and orientations in float32, between keys linear and slerp as in
    the viewer. Half-spaces are squares about the motion. Bodies without a shape are drawn as in the viewer, and the
    node's `extras.note` says so. Returns where.

    Raises:
        WrongStructure: no path of one world. InvalidInput: states that are not finite, a name that does not end in
            .glb, or a place where no file can be put.
    """
    check_path("save_glb", path)
    target = File(file)
    if target.suffix.lower() != ".glb":
        raise InvalidInput(f"{target}: give the file a name that ends in .glb")
    data = glb_of(path)
    write_whole(target, lambda stream: stream.write(data))
    return target


def glb_of(path: Path) -> bytes:
    """The bytes of the file."""
    times = np.asarray(path.times, float)
    position = np.asarray(path.states.position, float)
    turn = _continuous(quaternion_of(path.states.orientation))
    bad = ~(np.isfinite(position).all(axis=-1) & np.isfinite(turn).all(axis=-1))
    if bad.any():
        at, body = np.argwhere(bad)[0]
        raise InvalidInput(
            f"save_glb: body {body} has no finite place from {times[at]:.6g} s on; cut the path before, as in "
            f"dataclasses.replace(path, times=path.times[:{at}], states=jax.tree.map(lambda x: x[:{at}], path.states))"
        )
    if (np.diff(times) <= 0).any():
        raise InvalidInput(
            "save_glb: two saved states have the same time, which an animation cannot tell apart"
        )
    document = _Document()
    roots = []
    for i, seen in enumerate(bodies_of(path.scene)):
        node = document.body(seen, COLOURS[i % len(COLOURS)])
        document.nodes[node] |= {
            "translation": position[0, i].tolist(),
            "rotation": turn[0, i, [1, 2, 3, 0]].tolist(),
        }
        roots.append(node)
    if len(times) > 1:
        document.animate(roots, times - times[0], position, turn[..., [1, 2, 3, 0]])
    for seen in obstacles_of(path.scene):
        roots.append(document.body(square_under(seen, position), STILL))
    document.nodes.append({"name": "world, z up", "rotation": _Z_UP, "children": roots})
    return document.bytes()


def _continuous(turn: np.ndarray) -> np.ndarray:
    """Quaternions (k, n, 4), each with the sign nearer to the one before: not every program takes the short way."""
    agree = np.where(np.einsum("kni,kni->kn", turn[1:], turn[:-1]) < 0, -1.0, 1.0)
    return turn * np.concatenate([np.ones((1, turn.shape[1])), np.cumprod(agree, axis=0)])[..., None]


def square_under(seen: Seen, position: np.ndarray) -> Seen:
    """A half-space as a square under the motion, wide enough for it; anything else as it is."""
    if seen.plane is None:
        return seen
    normal, offset = seen.plane[:3], seen.plane[3]
    flat = position.reshape(-1, 3)
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    reach = 2.0 * float(np.linalg.norm(np.ptp(flat, axis=0))) + 1.0
    aside = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    aside /= np.linalg.norm(aside)
    across = np.cross(normal, aside)
    foot = middle + (offset - normal @ middle) * normal
    corners = np.array(
        [foot + reach * (a * aside + b * across) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )
    surface = Surface(
        corners.astype(np.float32),
        np.tile(normal, (4, 1)).astype(np.float32),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    still = Part(surface, np.ones(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return Seen(seen.name, [still])


class _Document:
    """The file as it grows: nodes, meshes, and the bytes that they point to."""

    def __init__(self) -> None:
        self.nodes: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, int]] = []
        self.animations: list[dict[str, Any]] = []
        self.blob = bytearray()
        self.known: dict[Any, Any] = {}

    def put(self, array: np.ndarray, component: int, bounded: bool = False) -> int:
        """Number of the accessor of an array (count, width)."""
        array = np.ascontiguousarray(array, "<f4" if component == _FLOAT else "<u4")
        entry: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": component,
            "count": len(array),
            "type": _KINDS[1 if array.ndim == 1 else array.shape[1]],
        }
        if bounded:  # of the numbers as they are written
            rows = array.reshape(len(array), -1)
            entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.views.append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": array.nbytes})
        self.blob += array.tobytes()
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def body(self, seen: Seen, colour: tuple[int, int, int]) -> int:
        """Number of a node with a child for each part."""
        children = []
        for part in seen.parts:
            w, x, y, z = part.orientation.tolist()
            self.nodes.append({
                "mesh": self._mesh(part.surface, colour),
                "scale": part.scale.tolist(),
                "translation": part.position.tolist(),
                "rotation": [x, y, z, w],
            })  # fmt: skip
            children.append(len(self.nodes) - 1)
        note = {"extras": {"note": seen.note}} if seen.note else {}
        self.nodes.append({"name": seen.name, **({"children": children} if children else {}), **note})
        return len(self.nodes) - 1

    def _mesh(self, surface: Surface, colour: tuple[int, int, int]) -> int:
        look = self._once(("look", colour), lambda: self._material(colour))
        key = (surface.vertices.tobytes(), surface.triangles.tobytes())
        at = self._once(key, lambda: {
            "attributes": {
                "POSITION": self.put(surface.vertices, _FLOAT, bounded=True),
                "NORMAL": self.put(surface.normals, _FLOAT),
            },
            "indices": self.put(surface.triangles.ravel(), _UNSIGNED),
        })  # fmt: skip
        return self._once(
            (*key, look), lambda: self._added(self.meshes, {"primitives": [at | {"material": look}]})
        )

    def _material(self, colour: tuple[int, int, int]) -> int:
        linear = [((c / 255.0 + 0.055) / 1.055) ** 2.4 for c in colour]
        look = {"baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.7}
        return self._added(self.materials, {"pbrMetallicRoughness": look})

    def _once(self, key: Any, make: Any) -> Any:
        if key not in self.known:
            self.known[key] = make()
        return self.known[key]

    @staticmethod
    def _added(rows: list[Any], row: Any) -> int:
        rows.append(row)
        return len(rows) - 1

    def animate(self, nodes: list[int], times: np.ndarray, position: np.ndarray, turn: np.ndarray) -> None:
        """One animation that moves all nodes together."""
        keys = self.put(times, _FLOAT, bounded=True)
        channels, samplers = [], []
        for i, node in enumerate(nodes):
            for name, values in (("translation", position[:, i]), ("rotation", turn[:, i])):
                channels.append({"sampler": len(samplers), "target": {"node": node, "path": name}})
                samplers.append(
                    {"input": keys, "output": self.put(values, _FLOAT), "interpolation": "LINEAR"}
                )
        self.animations.append({"name": "run", "channels": channels, "samplers": samplers})

    def bytes(self) -> bytes:
        """The whole file; the last node is its root."""
        document = {
            "asset": {"version": "2.0", "generator": "jaxrb"},
            "scene": 0,
            "scenes": [{"nodes": [len(self.nodes) - 1]}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.blob)}],
            "animations": self.animations,
        }
        text = json.dumps(
            {key: value for key, value in document.items() if value != []}, allow_nan=False
        ).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.blob), b"BIN\0") + bytes(self.blob)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
