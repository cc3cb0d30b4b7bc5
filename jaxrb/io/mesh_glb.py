"""Binary glTF 2.0 (Khronos Group 2021, "glTF 2.0 specification"): triangles, placed by their nodes."""

import json
from typing import Any

import numpy as np

from jaxrb.checks import warn
from jaxrb.errors import InvalidInput
from jaxrb.io.mesh_bytes import Arrays, too_many
from jaxrb.io.mesh_glb_nodes import placements

_JSON, _BIN = b"JSON", b"BIN\0"
_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_LIST, _STRIP, _FAN = 4, 5, 6
# Extensions that change looks alone. A file that requires another cannot be read without knowing it.
_LOOKS = ("KHR_materials", "KHR_texture", "KHR_lights", "EXT_texture", "KHR_xmp")


def read_glb(where: str, data: bytes, max_triangles: int) -> Arrays:
    """All triangles of the file's scene in one list, each geometry as often as nodes place it."""
    document, blob = _chunks(where, data)
    _check_extensions(where, document)
    buffers = _list(where, document, "buffers")
    for i, buffer in enumerate(buffers):
        if not isinstance(buffer, dict) or "uri" in buffer or i > 0:
            uri = str(buffer.get("uri", ""))[:60] if isinstance(buffer, dict) else ""
            raise InvalidInput(
                f"{where}: buffer {i} is not in the file itself (uri {uri!r}); other files are never opened; "
                "export one self-contained .glb"
            )
    vertices, triangles, count, total = [], [], 0, 0
    known: dict[int, list[Arrays]] = {}
    for mesh, matrix in placements(where, document):
        if mesh not in known:
            known[mesh] = _geometries(where, document, blob, mesh, max_triangles)
        for points, faces in known[mesh]:
            total += len(faces)
            if total > max_triangles:
                raise too_many(where, total, max_triangles)
            # A reflection turns the triangles inside out.
            with np.errstate(divide="ignore", invalid="ignore"):  # of scales that are almost nothing
                mirrored = np.linalg.det(matrix[:3, :3]) < 0
            flipped = faces[:, ::-1] if mirrored else faces
            triangles.append(flipped + count)
            vertices.append(points @ matrix[:3, :3].T + matrix[:3, 3])
            count += len(points)
    if not vertices:
        raise InvalidInput(f"{where}: its scene places no triangles; is it the right file?")
    return np.concatenate(vertices), np.concatenate(triangles)


def _chunks(where: str, data: bytes) -> tuple[dict, bytes]:
    if data[:4] != b"glTF" or len(data) < 20:
        raise InvalidInput(
            f"{where}: no GLB file (it does not begin with 'glTF'); export it as binary glTF 2.0"
        )
    version, length = (int.from_bytes(data[i : i + 4], "little") for i in (4, 8))
    if version != 2 or length != len(data):
        raise InvalidInput(
            f"{where}: GLB version {version} of {length} bytes announced, {len(data)} there; it is cut, or not glTF 2.0"
        )
    chunks, place = [], 12
    while place + 8 <= len(data):
        size, kind = int.from_bytes(data[place : place + 4], "little"), data[place + 4 : place + 8]
        if place + 8 + size > len(data):
            raise InvalidInput(f"{where}: a chunk of {size} bytes ends after the file; is it cut?")
        chunks.append((kind, data[place + 8 : place + 8 + size]))
        place += 8 + size
    if not chunks or chunks[0][0] != _JSON:
        raise InvalidInput(f"{where}: the first chunk is not JSON; it is damaged")
    try:
        document = json.loads(chunks[0][1])
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{where}: its JSON cannot be read ({str(error)[:80]}); it is damaged") from None
    if not isinstance(document, dict):
        raise InvalidInput(f"{where}: its JSON is no object; it is damaged")
    blob = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == _BIN else b""
    return document, blob


def _check_extensions(where: str, document: dict) -> None:
    for name in _list(where, document, "extensionsRequired"):
        if not (isinstance(name, str) and name.startswith(_LOOKS)):
            raise InvalidInput(
                f"{where}: requires the extension {str(name)[:60]!r} (compressed or quantised geometry, perhaps); "
                "export it without"
            )


def _geometries(where: str, document: dict, blob: bytes, number: int, max_triangles: int) -> list[Arrays]:
    """The vertices (n, 3) and triangles (m, 3) of each primitive of a mesh."""
    mesh = _entry(where, document, "meshes", number)
    found, skipped = [], 0
    for i, primitive in enumerate(_list(f"{where}, mesh {number}", mesh, "primitives")):
        here = f"{where}, mesh {number}, primitive {i}"
        if not isinstance(primitive, dict) or not isinstance(primitive.get("attributes"), dict):
            raise InvalidInput(f"{here}: it has no attributes; it is damaged")
        mode = primitive.get("mode", _LIST)
        if mode not in (_LIST, _STRIP, _FAN):
            skipped += 1
            continue
        points = _accessor(here, document, blob, primitive["attributes"].get("POSITION"), ("VEC3",), (5126,))
        if "indices" in primitive:
            order = _accessor(here, document, blob, primitive["indices"], ("SCALAR",), (5121, 5123, 5125))[
                :, 0
            ]
        else:
            order = np.arange(len(points))
        if len(order) and order.max() >= len(points):
            raise InvalidInput(
                f"{here}: names vertex {order.max()}, but there are {len(points)}; it is damaged"
            )
        if len(order) // (3 if mode == _LIST else 1) > max_triangles:
            raise too_many(here, len(order) // (3 if mode == _LIST else 1), max_triangles)
        found.append((points.astype(float), _triangles(here, mode, order.astype(np.int64))))
    if skipped:
        warn(f"{where}, mesh {number}: {skipped} primitives of points or lines are left out")
    return found


def _triangles(here: str, mode: int, order: np.ndarray) -> np.ndarray:
    if mode == _LIST:
        if len(order) % 3:
            raise InvalidInput(
                f"{here}: {len(order)} corners are no whole number of triangles; it is damaged"
            )
        return order.reshape(-1, 3)
    if len(order) < 3:
        raise InvalidInput(f"{here}: a strip or fan of {len(order)} corners; three are needed")
    if mode == _FAN:
        return np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=-1)
    strip = np.stack([order[:-2], order[1:-1], order[2:]], axis=-1)
    strip[1::2] = strip[1::2][:, [1, 0, 2]]
    # Strips name a vertex twice where they turn: such triangles are joints, not geometry.
    a, b, c = strip.T
    return strip[(a != b) & (b != c) & (c != a)]


def _accessor(
    here: str, document: dict, blob: bytes, number: Any, kinds: tuple, components: tuple
) -> np.ndarray:
    """The numbers (count, width) of an accessor, of which every byte lies in the file."""
    accessor = _entry(here, document, "accessors", number)
    if "sparse" in accessor or "bufferView" not in accessor:
        raise InvalidInput(f"{here}: accessor {number} is sparse or has no data; export plain geometry")
    if accessor.get("type") not in kinds or accessor.get("componentType") not in components:
        raise InvalidInput(
            f"{here}: accessor {number} holds {str(accessor.get('type'))[:20]!r} of type "
            f"{str(accessor.get('componentType'))[:20]}, not {kinds[0]}; export positions as 32-bit floats"
        )
    view = _entry(here, document, "bufferViews", accessor["bufferView"])
    if view.get("buffer") != 0:
        raise InvalidInput(f"{here}: buffer {str(view.get('buffer'))[:20]} is not in the file itself")
    width = 3 if accessor["type"] == "VEC3" else 1
    kind = np.dtype(_TYPES[accessor["componentType"]])
    count = _whole(here, accessor, "count", 0)
    view_start, view_size = _whole(here, view, "byteOffset", 0), _whole(here, view, "byteLength", 0)
    offset, stride = (
        _whole(here, accessor, "byteOffset", 0),
        _whole(here, view, "byteStride", width * kind.itemsize),
    )
    if stride < width * kind.itemsize or count == 0:
        raise InvalidInput(f"{here}: accessor {number} has count {count} and stride {stride}; it is damaged")
    needed = offset + (count - 1) * stride + width * kind.itemsize
    if needed > view_size or view_start + view_size > len(blob):
        raise InvalidInput(
            f"{here}: accessor {number} announces {count} entries up to byte {view_start + needed}, but its view ends "
            f"at {view_start + view_size} and the data at {len(blob)}; the count lies or it is cut"
        )
    return np.ndarray((count, width), kind, blob, view_start + offset, (stride, kind.itemsize))


def _entry(where: str, document: dict, key: str, number: Any) -> dict:
    entries = _list(where, document, key)
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(entries):
        raise InvalidInput(
            f"{where}: names {key}[{str(number)[:20]}], but there are {len(entries)}; it is damaged"
        )
    if not isinstance(entries[number], dict):
        raise InvalidInput(f"{where}: {key}[{number}] is no object; it is damaged")
    return entries[number]


def _list(where: str, holder: dict, key: str) -> list:
    value = holder.get(key, [])
    if not isinstance(value, list):
        raise InvalidInput(f"{where}: {key!r} is no list; it is damaged")
    return value


def _whole(here: str, holder: dict, key: str, default: int) -> int:
    value = holder.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**40:
        raise InvalidInput(
            f"{here}: {key!r} is {str(value)[:20]}; it must be a whole number that is not negative"
        )
    return value
