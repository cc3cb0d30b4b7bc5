"""Trees of jaxrb's own classes as JSON and arrays, and back: no pickle, so that reading runs no one's code."""

import dataclasses
import hashlib
import json
from typing import Any

import jax
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.freedom import Freedom
from jaxrb.body.inertia import Inertia
from jaxrb.body.state import State
from jaxrb.checks import check_quantity, quantities
from jaxrb.effects.effect import Effect
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.geometry.connectivity import Connectivity
from jaxrb.geometry.primitives import Pose
from jaxrb.geometry.shape import Shape
from jaxrb.integrators.method import Method
from jaxrb.io.npz import raw_bytes
from jaxrb.math.rotation import Rotation
from jaxrb.scene.scene import Scene

_ROOTS = (Body, Effect, Freedom, Inertia, Method, Pose, Rotation, Scene, Shape, State)
_DEEPEST = 32


def encoded(tree: Any, arrays: list[np.ndarray], functions: bool = False) -> Any:
    """The tree as plain JSON; its arrays are appended to `arrays` and named by number.

    `functions`: whether a function may stand for itself by its name, as a fingerprint wants it.

    Raises:
        WrongStructure: something that cannot be written, such as a function.
    """
    if tree is None or isinstance(tree, (bool, int, str)):
        return tree
    if isinstance(tree, float):
        return {"float": tree.hex()}
    if isinstance(tree, (tuple, list)):
        return {type(tree).__name__: [encoded(item, arrays, functions) for item in tree]}
    if isinstance(tree, dict) and all(isinstance(key, str) for key in tree):
        return {"dict": {key: encoded(item, arrays, functions) for key, item in tree.items()}}
    if isinstance(tree, (jax.Array, np.ndarray, np.generic)):
        arrays.append(np.asarray(tree))
        return {"array": len(arrays) - 1}
    if isinstance(tree, Connectivity):
        arrays.append(tree.triangles)
        return {"triangles": len(arrays) - 1}
    if dataclasses.is_dataclass(tree) and (functions or _name(type(tree)) in _classes()):
        fields = {f.name: encoded(getattr(tree, f.name), arrays, functions) for f in dataclasses.fields(tree)}
        return {"is": _name(type(tree)), "fields": fields}
    if functions and callable(tree):
        return {"function": f"{getattr(tree, '__module__', '?')}:{getattr(tree, '__qualname__', type(tree))}"}
    raise WrongStructure(f"{tree!r} is no number, array or class of jaxrb: no file can hold it")


def decoded(plain: Any, arrays: list[np.ndarray], where: str) -> Any:
    """The tree that `encoded` made plain.

    Raises:
        InvalidInput: naming the file `where`, for anything else.
    """
    try:
        return _decoded(plain, arrays, where, _classes(), _DEEPEST)
    except (TypeError, ValueError, KeyError, IndexError, AttributeError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"{where}: its tree cannot be read ({type(error).__name__}: {error})") from error


def fingerprint(tree: Any) -> str:
    """SHA-256 of a tree's structure and of every bit of its numbers; of functions only their names."""
    arrays: list[np.ndarray] = []
    plain = encoded(tree, arrays, functions=True)
    return digest({str(i): array for i, array in enumerate(arrays)}, json.dumps(plain, sort_keys=True))


def digest(arrays: dict[str, np.ndarray], text: str = "") -> str:
    """SHA-256 of named arrays: names, types, shapes and every bit; in hexadecimal digits."""
    found = hashlib.sha256(text.encode())
    for name in sorted(arrays):
        array = arrays[name]
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(raw_bytes(array))
    return found.hexdigest()


def checksum(arrays: dict[str, np.ndarray], known: dict[str, str] | None = None) -> str:
    """SHA-256 of names, types and shapes of arrays and of the SHA-256 of each one's bytes, which `known` may hold."""
    known = known or {}
    lines = [
        f"{name} {array.dtype.str} {array.shape} {known.get(name) or hashlib.sha256(raw_bytes(array)).hexdigest()}"
        for name, array in sorted(arrays.items())
    ]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _classes() -> dict[str, type]:
    """What may be made from a file: the final classes of the library that scenes consist of."""
    found: dict[str, type] = {}
    waiting = list(_ROOTS)
    while waiting:
        kind = waiting.pop()
        waiting += kind.__subclasses__()
        if kind.__module__.startswith("jaxrb."):
            found[_name(kind)] = kind
    return found


def _decoded(plain: Any, arrays: list[np.ndarray], where: str, classes: dict[str, type], room: int) -> Any:
    if room == 0:
        raise InvalidInput(f"{where}: its tree is more than {_DEEPEST} levels deep")
    if plain is None or isinstance(plain, (bool, int, str)):
        return plain

    def inner(item: Any) -> Any:
        return _decoded(item, arrays, where, classes, room - 1)

    if plain.keys() == {"is", "fields"}:
        if (kind := plain["is"]) not in classes:
            raise InvalidInput(
                f"{where}: {str(kind)[:60]!r} is no class of this jaxrb's scenes; update jaxrb"
            )
        return _made(classes[kind], {name: inner(item) for name, item in plain["fields"].items()}, where)
    if len(plain) != 1:
        raise InvalidInput(f"{where}: a node of its tree has {len(plain)} kinds")
    ((kind, value),) = plain.items()
    if kind == "float":
        return float.fromhex(value)
    if kind in ("tuple", "list"):
        return (tuple if kind == "tuple" else list)(inner(item) for item in value)
    if kind == "dict":
        return {name: inner(item) for name, item in value.items()}
    if kind in ("array", "triangles") and isinstance(value, int) and value >= 0:
        return arrays[value] if kind == "array" else Connectivity(arrays[value])
    raise InvalidInput(f"{where}: a node of its tree is a {str(kind)[:60]!r}")


def _made(kind: type, fields: dict[str, Any], where: str) -> Any:
    """An instance as it was: without the constructor, which would repair and convert what once was right already.

    The limits on its numbers are asked again: a right checksum says only that somebody wrote these bytes.
    """
    wanted = {f.name for f in dataclasses.fields(kind)}  # pyright: ignore[reportArgumentType]
    if wanted != set(fields):
        off = sorted(wanted ^ set(fields))
        raise InvalidInput(f"{where}: a {kind.__name__} differs in {', '.join(off)}; another jaxrb wrote it")
    for field in quantities(kind):
        value = fields[field.name]
        if value is not None:
            if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
                raise InvalidInput(f"{where}: {kind.__name__}.{field.name} is no array of real numbers")
            check_quantity(f"{where}: {kind.__name__}.{field.name}", value, **field.metadata["quantity"])
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made
