"""What the viewer is given: a header (JSON) and the numbers that it points to, in one block of bytes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene
from jaxrb.view.viewer_contacts import STEP, SavedContacts, contacts_of
from jaxrb.view.viewer_scene import Seen, add_bounds, bodies_of, obstacles_of
from jaxrb.view.viewer_surfaces import Part, quaternion_of

SCHEMA = 1


class Record:
    """`header` and `numbers`: little-endian arrays one after another, each at a multiple of eight bytes.

    In the header an array stands as {"at": byte, "shape": […], "type": "f8" | "f4" | "i4"}.
    """

    def __init__(self) -> None:
        self.header: dict[str, Any] = {"schema": SCHEMA}
        self.numbers = bytearray()

    def put(self, array: Any, kind: str = "f8") -> dict[str, Any]:
        """Add an array; what stands for it in the header."""
        array = np.ascontiguousarray(array, np.dtype(f"<{kind}"))
        at = len(self.numbers)
        self.numbers += array.tobytes()
        self.numbers += b"\0" * (-len(self.numbers) % 8)
        return {"at": at, "shape": list(array.shape), "type": kind}


def record_of(
    path: Path, title: str = "", *, bounds: bool = True, forces: bool = False, dt: float | None = None
) -> Record:
    """The record of a run; `dt` [s] is the step whose contact forces are told.

    Raises:
        WrongStructure: no path of one world, or one that is being traced.
    """
    check_path("view", path)
    notes = []
    bodies = bodies_of(path.scene)
    if bounds and (missing := add_bounds(bodies)):
        notes.append(missing)
    record = Record()
    times = np.asarray(path.times, float)
    orientation = quaternion_of(path.states.orientation)
    _put_motion(record, title, times, np.asarray(path.states.position, float), orientation, notes)
    _put_bodies(record, bodies, obstacles_of(path.scene))
    record.header["series"] = _series(record, path)
    record.header["events"] = _events(record, path)
    record.header["forces"] = _forces(record, path) if forces else []
    found = contacts_of(path.scene, path.states, dt or STEP) if forces else None
    record.header["contacts"] = _contacts(record, found)
    if path.contact is not None and record.header["events"] is None and not forces:
        notes.append("points and forces of contact are not shown: ask for them by forces=True")
    return record


def record_of_arrays(
    arrays: dict[str, np.ndarray], bodies: list[Seen], obstacles: list[Seen], title: str
) -> Record:
    """The record of the arrays that `jaxrb simulate --save` writes.

    Raises:
        InvalidInput: arrays that are missing, or of shapes that do not fit.
    """
    for name in ("time", "position", "orientation_wxyz"):
        if name not in arrays:
            raise InvalidInput(f"{title}: holds no {name!r}; give a file that `jaxrb simulate --save` wrote")
    times, position, turn = (
        np.asarray(arrays[name], float) for name in ("time", "position", "orientation_wxyz")
    )
    k, n = len(times) if times.ndim == 1 else -1, len(bodies)
    if position.shape != (k, n, 3) or turn.shape != (k, n, 4):
        raise InvalidInput(
            f"{title}: time {times.shape}, position {position.shape} and orientation_wxyz {turn.shape} do not fit "
            f"{n} bodies; is it the file of another scene?"
        )
    record = Record()
    _put_motion(record, title, times, position, turn / np.linalg.norm(turn, axis=-1, keepdims=True), [])
    _put_bodies(record, bodies, obstacles)
    lines = {
        "energy": "energy",
        "work, normal": "contact_normal_work",
        "work, friction": "contact_friction_work",
    }
    found = {
        label: arrays[name]
        for label, name in lines.items()
        if name in arrays and np.shape(arrays[name]) == (k,)
    }
    record.header["series"] = [_chart(record, "Energy since the start", "J", found)] if found else []
    pressed = SavedContacts.of_arrays(title, arrays, k)
    record.header |= {"events": None, "forces": [], "contacts": _contacts(record, pressed)}
    return record


def check_path(where: str, path: Any) -> None:
    """Refuse what cannot be drawn as one run."""
    if not isinstance(path, Path):
        raise WrongStructure(
            f"{where}: {type(path).__name__} is no path; give what rb.rollout, rb.run or rb.solve returned"
        )
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((path.times, path.states))):
        raise WrongStructure(f"{where}: the path is being traced by jit, grad or vmap; draw it outside")
    if np.ndim(path.times) != 1:
        raise WrongStructure(
            f"{where}: times of shape {np.shape(path.times)} are those of many worlds; draw one of them: "
            "jax.tree.map(lambda leaf: leaf[0], path)"
        )
    if not len(path.times):
        raise WrongStructure(f"{where}: the path holds no saved state; save at least one")


def _put_motion(
    record: Record, title: str, times: np.ndarray, position: np.ndarray, turn: np.ndarray, notes: list[str]
) -> None:
    good = np.isfinite(position).all(axis=-1) & np.isfinite(turn).all(axis=-1)
    if not good.all():
        at, body = np.argwhere(~good)[0]
        notes.insert(0, f"body {body} has no finite place from {times[at]:.6g} s on, and is not drawn there")
    record.header |= {
        "title": title or "Run",
        "times": record.put(times),
        "position": record.put(position),
        "orientation": record.put(turn),
        "notes": notes,
    }


def _put_bodies(record: Record, bodies: list[Seen], obstacles: list[Seen]) -> None:
    surfaces: list[Any] = []
    known: dict[Any, int] = {}

    def number(part: Part) -> int:
        surface = part.surface
        key = (surface.vertices.tobytes(), surface.triangles.tobytes())
        if key not in known:
            known[key] = len(surfaces)
            surfaces.append(
                {"vertices": record.put(surface.vertices, "f4"), "normals": record.put(surface.normals, "f4"),
                 "triangles": record.put(surface.triangles, "i4")}
            )  # fmt: skip
        return known[key]

    def plain(seen: Seen) -> dict[str, Any]:
        parts = [
            {"surface": number(part), "scale": part.scale.tolist(), "position": part.position.tolist(),
             "orientation": part.orientation.tolist()}
            for part in seen.parts
        ]  # fmt: skip
        found: dict[str, Any] = {"name": seen.name, "note": seen.note, "parts": parts}
        for name in ("plane", "ball", "box"):
            if (value := getattr(seen, name)) is not None:
                found[name] = value.tolist()
        return found | ({} if seen.hull is None else {"hull": record.put(seen.hull, "f4")})

    record.header["bodies"] = [plain(seen) for seen in bodies]
    record.header["obstacles"] = [plain(seen) for seen in obstacles]
    record.header["surfaces"] = surfaces


def _chart(record: Record, title: str, unit: str, lines: dict[str, Any]) -> dict[str, Any]:
    """Lines over time. An energy is told as its change, which no axis of large numbers hides."""
    values = {name: np.asarray(value, float) for name, value in lines.items()}
    if "energy" in values:
        values["energy"] = values["energy"] - values["energy"][0]
    return {
        "title": title,
        "unit": unit,
        "lines": [{"name": name, "values": record.put(value)} for name, value in values.items()],
    }


def _series(record: Record, path: Path) -> list[dict[str, Any]]:
    known = path.diagnostics
    energy: dict[str, Any] = {"energy": known.energy}
    if path.contact is not None:
        energy |= {
            "work, normal": path.contact.normal_work,
            "work, friction": path.contact.friction_work,
        }
    spin = np.asarray(known.angular_momentum, float)
    drift = {
        name: np.abs(np.asarray(getattr(known.drift, name), float)).max(axis=-1) for name in ("scale", "skew")
    }
    if not drift["skew"].any():
        del drift["skew"]  # of a quaternion there is none
    return [
        _chart(record, "Energy since the start", "J", energy),
        _chart(record, "Angular momentum", "kg m²/s", {"change": np.linalg.norm(spin - spin[0], axis=-1)}),
        _chart(record, "Drift of the rotations", "1", drift),
    ]


def _events(record: Record, path: Path) -> dict[str, Any] | None:
    """The impacts of `solve_events`: when, where, and the impulse on the first body."""
    events = getattr(path, "events", None)
    if events is None:
        return None
    count = int(events.count)
    return {
        "time": record.put(np.asarray(events.time)[:count]),
        "pair": record.put(np.asarray(events.pair)[:count], "i4"),
        "point": record.put(np.asarray(events.point)[:count]),
        "impulse": record.put(np.asarray(events.impulse)[:count]),
    }


def _contacts(record: Record, found: SavedContacts | None) -> dict[str, Any] | None:
    """Points and forces of contact at each saved state."""
    if found is None or not len(found.point):
        return None
    return {
        "first": record.put(found.first, "i4"),
        "point": record.put(found.point, "f4"),
        "force": record.put(found.force, "f4"),
    }


def _forces(record: Record, path: Path) -> list[dict[str, Any]]:
    """The force (k, n, 3) [N] of each effect that has one; rigid contact acts by impulses, see `viewer_contacts`."""
    found = _evaluated(path.scene, path.states)
    return [
        {"name": name.split(" ")[1], "values": record.put(force, "f4")}
        for name, force in found.items()
        if np.asarray(force).any()
    ]


@jax.jit
def _evaluated(scene: Scene, states: State) -> dict[str, Any]:
    dynamics = scene.prepared(states.dtype)

    def at(state: State) -> dict[str, Any]:
        found = {}
        for i, effect in enumerate(dynamics.effects):
            force = effect.wrench_on(dynamics.bodies, state).force
            if force is not None:
                name = type(getattr(effect, "law", effect)).__name__
                found[f"{i:03d} {name}"] = jnp.broadcast_to(force, state.position.shape)
        return found

    return jax.vmap(at)(states)
