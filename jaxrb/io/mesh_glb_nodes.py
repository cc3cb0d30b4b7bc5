"""The node tree of a glTF file: where each mesh stands."""

from typing import Any

import numpy as np

from jaxrb.checks import warn
from jaxrb.errors import InvalidInput, LimitExceeded

MAX_NODES = 100_000


def placements(where: str, document: dict) -> list[tuple[int, np.ndarray]]:
    """Every mesh number that the file's scene shows, with its transform (4, 4) to the scene's frame.

    Raises:
        InvalidInput: a node that is its own ancestor or has two parents, a number that names nothing.
    """
    nodes = document.get("nodes", [])
    if not isinstance(nodes, list) or not all(isinstance(node, dict) for node in nodes):
        raise InvalidInput(f"{where}: 'nodes' is no list of objects; it is damaged")
    if len(nodes) > MAX_NODES:
        raise LimitExceeded(f"{where}: {len(nodes)} nodes are more than {MAX_NODES}; merge its parts")
    found, seen = [], set()
    waiting = [(number, np.eye(4)) for number in _roots(where, document, nodes)]
    while waiting:
        number, above = waiting.pop()
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(nodes):
            raise InvalidInput(
                f"{where}: names node {str(number)[:20]}, but there are {len(nodes)}; it is damaged"
            )
        if number in seen:
            raise InvalidInput(
                f"{where}: node {number} is reached twice: a cycle, or two parents; it is damaged"
            )
        seen.add(number)
        node = nodes[number]
        matrix = above @ _transform(f"{where}, node {number}", node)
        if "skin" in node:
            warn(f"{where}, node {number}: its skin (bones) is not applied; the mesh is taken as it rests")
        if "mesh" in node:
            found.append((node["mesh"], matrix))
        waiting += [(child, matrix) for child in reversed(_numbers(where, node, "children"))]
    for mesh, _ in found:
        if not isinstance(mesh, int) or isinstance(mesh, bool):
            raise InvalidInput(f"{where}: names mesh {str(mesh)[:20]}; it is damaged")
    return found


def _roots(where: str, document: dict, nodes: list[dict]) -> list:
    scenes = document.get("scenes", [])
    if not isinstance(scenes, list) or not scenes:
        children = {c for node in nodes for c in _numbers(where, node, "children") if isinstance(c, int)}
        return [i for i in range(len(nodes)) if i not in children]
    number = document.get("scene", 0)
    if not isinstance(number, int) or not 0 <= number < len(scenes) or not isinstance(scenes[number], dict):
        raise InvalidInput(
            f"{where}: names scene {str(number)[:20]}, but there are {len(scenes)}; it is damaged"
        )
    return list(reversed(_numbers(where, scenes[number], "nodes")))


def _numbers(where: str, holder: dict, key: str) -> list:
    value = holder.get(key, [])
    if not isinstance(value, list):
        raise InvalidInput(f"{where}: {key!r} of a node is no list; it is damaged")
    return value


def _transform(here: str, node: dict) -> np.ndarray:
    """A node's own matrix (4, 4): given, or translation · rotation (x, y, z, w) · scale."""
    if "matrix" in node:
        return _floats(here, node, "matrix", 16).reshape(4, 4).T  # by columns
    matrix = np.eye(4)
    x, y, z, w = _floats(here, node, "rotation", 4, (0.0, 0.0, 0.0, 1.0))
    length = x * x + y * y + z * z + w * w
    if not 0.99 < length < 1.01:
        raise InvalidInput(f"{here}: its rotation {[x, y, z, w]} is no unit quaternion; it is damaged")
    s = 2.0 / length
    matrix[:3, :3] = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    matrix[:3, :3] *= _floats(here, node, "scale", 3, (1.0, 1.0, 1.0))
    matrix[:3, 3] = _floats(here, node, "translation", 3, (0.0, 0.0, 0.0))
    return matrix


def _floats(here: str, node: dict, key: str, count: int, default: Any = None) -> np.ndarray:
    value = node.get(key, default)
    numbers = isinstance(value, (list, tuple)) and all(type(v) in (int, float) for v in value)
    try:
        array = np.array(value, float) if numbers else np.empty(0)
    except OverflowError:  # a whole number of a thousand digits
        array = np.empty(0)
    if array.shape != (count,) or not (np.isfinite(array).all() and np.abs(array).max() < 1e15):
        raise InvalidInput(f"{here}: {key!r} is {str(value)[:60]}; give {count} finite numbers")
    return array
