"""Stanford PLY, text and binary (Turk 1994, "The PLY polygon file format")."""

import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.io.mesh_bytes import Arrays, fanned, real, shown, too_many, whole

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
}
_TYPES |= {
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
}
_TYPES |= {"float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDICES = ("vertex_indices", "vertex_index")

# Name, type of the entries, and of a list the type of its length.
Property = tuple[str, str, str | None]
Element = tuple[str, int, list[Property]]


def read_ply(where: str, data: bytes, max_triangles: int) -> Arrays:
    """The elements `vertex` (x, y, z) and `face` (vertex_indices); other properties are read past."""
    end = data.find(b"end_header")
    stop = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or stop < 0 or end > 2**16:
        raise InvalidInput(f"{where}: no PLY header ('ply' … 'end_header'); it is cut or no PLY file")
    order, elements = _header(where, data[:end])
    body = data[stop + 1 :]
    columns: dict[str, dict[str, np.ndarray | list]] = {}
    for name, count, properties in elements:
        if name in columns:
            raise InvalidInput(f"{where}: element {name!r} is declared twice")
        if name == "face" and count > max_triangles:
            raise too_many(where, count, max_triangles)
        here = f"{where}, element {name!r}"
        # Each entry takes at least a byte, in text two with its blank: a count that lies is found before it costs.
        if count * max(len(properties), 1) > len(body):
            raise InvalidInput(
                f"{here}: {count} are announced, but only {len(body)} bytes are left; is it cut?"
            )
        read = _from_text if not order else _from_bytes
        columns[name], body = read(here, body, order, count, properties)
    return _geometry(where, columns, max_triangles)


def _geometry(where: str, columns: dict, max_triangles: int) -> Arrays:
    missing = [axis for axis in "xyz" if axis not in columns.get("vertex", {})]
    lists = [columns["face"][name] for name in _INDICES if name in columns.get("face", {})]
    if missing or not lists:
        what = (
            f"property {missing[0]!r} of element 'vertex'"
            if missing
            else "list 'vertex_indices' of element 'face'"
        )
        raise InvalidInput(f"{where}: {what} is missing; export it as a polygon mesh")
    vertices = np.stack([np.asarray(columns["vertex"][axis], float) for axis in "xyz"], axis=-1)
    faces = lists[0]
    if isinstance(faces, np.ndarray) and faces.ndim == 2 and faces.shape[1] == 3:
        return vertices, faces.astype(np.int64)
    polygons = [[int(i) for i in face] for face in faces]
    short = next((i for i, polygon in enumerate(polygons) if len(polygon) < 3), None)
    if short is not None:
        raise InvalidInput(f"{where}: face {short} has {len(polygons[short])} corners; three are needed")
    return vertices, fanned(where, polygons, max_triangles)


def _header(where: str, header: bytes) -> tuple[str, list[Element]]:
    order, elements = None, []
    for line in header.decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit():
            elements.append((words[1], whole(where, words[2].encode()), []))
        elif words[0] == "property" and len(words) == 3 and words[1] in _TYPES and elements:
            elements[-1][2].append((words[2], _TYPES[words[1]], None))
        elif (
            words[:2] == ["property", "list"]
            and len(words) == 5
            and {*words[2:4]} <= set(_TYPES)
            and elements
        ):
            length = _TYPES[words[2]]
            if length[0] == "f" or (_TYPES[words[3]][0] == "f" and words[4] in _INDICES):
                raise InvalidInput(
                    f"{where}: header line {line.strip()[:60]!r}: lengths and indices are whole numbers"
                )
            elements[-1][2].append((words[4], _TYPES[words[3]], length))
        else:
            raise InvalidInput(f"{where}: header line {line.strip()[:60]!r} is not PLY")
        if len(elements) > 100 or (elements and len(elements[-1][2]) > 1000):
            raise InvalidInput(
                f"{where}: more than 100 elements or 1000 properties are declared; is it a PLY file?"
            )
    for name, _, properties in elements:
        names = [property[0] for property in properties]
        lists = {property[0] for property in properties if property[2] is not None}
        if len(set(names)) < len(names) or lists & {"x", "y", "z"} or {*names} & {*_INDICES} - lists:
            raise InvalidInput(f"{where}: element {name!r} declares a property twice, or a number as a list")
    if order is None:
        raise InvalidInput(
            f"{where}: the header names no format (ascii, binary_little_endian, binary_big_endian)"
        )
    return order, elements


def _from_text(
    here: str, body: bytes, order: str, count: int, properties: list[Property]
) -> tuple[dict, bytes]:
    del order
    columns: dict[str, list] = {name: [] for name, _, _ in properties}
    lines = body.split(b"\n", count)
    if len(lines) < count or (count and len(lines) == count and not lines[-1].strip()):
        raise InvalidInput(f"{here}: {count} lines are announced, but {len(lines)} are there; is it cut?")
    for i in range(count):
        words = lines[i].split()
        place = 0
        for name, kind, length in properties:
            number = real if kind[0] == "f" else whole
            size = 1
            if length is not None:
                size = whole(here, words[place]) if place < len(words) else -1
                place += 1
            if size < 0 or place + size > len(words):
                raise InvalidInput(
                    f"{here}: entry {i}, {shown(lines[i])}, ends before its {name!r}; is it cut?"
                )
            values = [number(here, word) for word in words[place : place + size]]
            columns[name].append(values if length is not None else values[0])
            place += size
    return columns, (lines[count] if len(lines) > count else b"")


def _from_bytes(
    here: str, body: bytes, order: str, count: int, properties: list[Property]
) -> tuple[dict, bytes]:
    """All entries at once where every list has the length that it has in the first entry; else one by one."""
    sizes = _list_sizes(here, body, order, properties) if count else [0] * len(properties)
    fields: list[tuple] = []
    for i, ((_, kind, length), size) in enumerate(zip(properties, sizes)):
        if length is not None:
            fields.append((f"n{i}", order + length))
        fields.append((f"p{i}", order + kind) if length is None else (f"p{i}", order + kind, (size,)))
    entry = np.dtype(fields)
    if entry.itemsize * count <= len(body) and entry.itemsize:
        table = np.frombuffer(body, entry, count)
        lists = [(i, size) for i, size in enumerate(sizes) if properties[i][2] is not None]
        if all((table[f"n{i}"] == size).all() for i, size in lists):
            return {name: table[f"p{i}"] for i, (name, _, _) in enumerate(properties)}, body[table.nbytes :]
    elif not any(length for _, _, length in properties):
        raise InvalidInput(
            f"{here}: {count} entries take {entry.itemsize * count} bytes, but {len(body)} are left; is it cut?"
        )
    return _one_by_one(here, body, order, count, properties)


def _one_by_one(
    here: str, body: bytes, order: str, count: int, properties: list[Property]
) -> tuple[dict, bytes]:
    columns: dict[str, list] = {name: [] for name, _, _ in properties}
    place = 0
    for i in range(count):
        for name, kind, length in properties:
            size = 1
            if length is not None:
                size, place = _length(here, body, order + length, place), place + np.dtype(length).itemsize
            step = size * np.dtype(kind).itemsize
            if size < 0 or place + step > len(body):
                raise InvalidInput(f"{here}: the bytes end in {name!r} of entry {i} of {count}; is it cut?")
            values = np.frombuffer(body, order + kind, size, place)
            columns[name].append(values if length is not None else values[0])
            place += step
    return columns, body[place:]


def _list_sizes(here: str, body: bytes, order: str, properties: list[Property]) -> list[int]:
    sizes, place = [], 0
    for _, kind, length in properties:
        size = 1
        if length is not None:
            size, place = _length(here, body, order + length, place), place + np.dtype(length).itemsize
        place += size * np.dtype(kind).itemsize
        if place > len(body):
            raise InvalidInput(f"{here}: the bytes end in its first entry; is it cut?")
        sizes.append(size)
    return sizes


def _length(here: str, body: bytes, kind: str, place: int) -> int:
    if place + np.dtype(kind).itemsize > len(body):
        raise InvalidInput(f"{here}: the bytes end before a list; is it cut?")
    size = int(np.frombuffer(body, kind, 1, place)[0])
    if not 0 <= size <= len(body) - place:
        raise InvalidInput(
            f"{here}: a list of {size} entries, but {len(body) - place} bytes are left; is it cut?"
        )
    return size
