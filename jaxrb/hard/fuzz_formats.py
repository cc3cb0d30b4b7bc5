"""The files that jaxrb reads: for each format whole ones to spoil, how to spoil them, and what reads them."""

import contextlib
import dataclasses
import io
import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxrb.errors import JaxrbError
from jaxrb.hard import fuzz_meshes as meshes
from jaxrb.hard import fuzz_models as models
from jaxrb.hard import fuzz_mutations as spoil
from jaxrb.io.checkpoint import FAILURE, RunFile
from jaxrb.io.recording import Recording
from jaxrb.io.recording_files import read_recording, write_recording
from jaxrb.io.replay import opened
from jaxrb.io.run import run
from jaxrb.io.tree import decoded, digest, fingerprint
from jaxrb.scene.library import example_of, thrown_brick

Mutation = Callable[[bytes, spoil.Random, Sequence[bytes]], bytes]


@dataclasses.dataclass(frozen=True)
class Format:
    """`seeds()`: whole files; `mutations`: ways to spoil one, each as likely; `read(path)`: what a user calls.

    `read` returns a complaint where it accepts what is no sound answer; `compiled`: by MuJoCo, in a process of its own.
    """

    suffix: str
    seeds: Callable[[], list[bytes]]
    mutations: tuple[Mutation, ...]
    read: Callable[[Path], str | None]
    compiled: bool = False


def spoiled(kind: Format, seeds: Sequence[bytes], others: Sequence[bytes], random: spoil.Random) -> bytes:
    """One file: mostly a whole one spoiled, one in twenty pure noise. `others`: seeds of all formats."""
    if random.integers(20) == 0:
        return random.bytes(int(2 ** random.uniform(0, 14)))
    mutation = kind.mutations[int(random.integers(len(kind.mutations)))]
    return mutation(seeds[int(random.integers(len(seeds)))], random, others)


def _recording() -> Recording:
    random = np.random.default_rng(0)
    turned = random.normal(size=(10, 4))
    rows: dict[str, Any] = {
        name: random.normal(size=(10, 3)) for name in ("angular_velocity", "position", "velocity")
    }
    return Recording(
        np.r_[0:6, 0:4] * 0.01, orientation=turned / np.linalg.norm(turned, axis=1, keepdims=True), length=[6, 4],
        specific_force=random.normal(size=(10, 3)), metadata={"body": "brick"}, **rows,
    )  # fmt: skip


def _recordings(suffix: str) -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        return [write_recording(_recording(), Path(folder) / f"run.{suffix}").read_bytes()]


def _stacked_recordings() -> list[bytes]:
    """Our own layout, and the one without time."""
    stream = io.BytesIO()
    spin = np.ones((10, 3), np.float32)
    np.savez(stream, angular_velocity=spin, rate_hz=100.0, length=np.asarray([6, 4]), toss_id=np.arange(2))
    return [*_recordings("npz"), stream.getvalue()]


def _read_recording(path: Path) -> str | None:
    found = read_recording(path)
    good = all(np.isfinite(column).all() for column in found.columns().values())
    return (
        None
        if good and found.length.sum() == len(found.time)
        else "a recording that is not finite or not whole"
    )


_SCENE = b"""import jaxrb as rb

brick = rb.Body.from_shape(rb.Box(half_extents=(0.10, 0.05, 0.02)), density=700.0)
bodies = (rb.replicate(brick, 3), rb.Body(2.0, (0.1, 0.2, 0.25)))
effects = (rb.UniformGravity((0, 0, -9.81)), rb.QuadraticDrag(coefficient=0.4, area=0.02))
effects += (rb.SpringDamper(stiffness=15.0, rest_length=0.2, body_a=0, body_b=1),)
effects += (rb.RigidContact(rb.HalfSpace(normal=(0, 0, 1)), friction=0.5, bodies=(0, 1)),)
scene = rb.Scene(bodies, effects)
place = ((0, 0, 1.0), (1, 0, 1.0), (2, 0, 1.0), (3, 0, 1.0))
state = scene.state(position=place, angular_velocity=(0.1, 5.0, 0.1), velocity=(1.0, 0, 0))
duration = 2.0
dt = 1e-3
"""


def _read_scene(path: Path) -> str | None:
    example = example_of(str(path))
    good = all(np.isfinite(np.asarray(part, float)).all() for part in example.start.values())
    return None if good and np.isfinite(example.duration) else "a start that is not finite"


def _checkpoints() -> list[bytes]:
    """Of a run on its way, and of one that failed, so that its tree is read to the end."""
    example = thrown_brick()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.npz"
        run(example.scene, example.state(), dt=1e-3, steps=4, save_every=2, checkpoint=file)
        data = file.read_bytes()
    return [data, _resealed(data, lambda header: header | {"kind": FAILURE, "first_bad_step": 4})]


def _resealed(data: bytes, change: Callable[[dict], Any]) -> bytes:
    """With another header, and the checksum that belongs to it."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = dict(archive)
    arrays.pop("checksum", None)
    arrays["header"] = np.asarray(json.dumps(change(json.loads(str(arrays["header"])))))
    return _sealed(arrays)


def _of_header(data: bytes, random: spoil.Random, others: Sequence[bytes]) -> bytes:
    """Something else in its header, and all checksums right."""

    def changed(header: dict) -> Any:
        for _ in range(random.integers(1, 4)):
            header = spoil.of_json(header, random)
        return header

    return _resealed(data, changed)


def _of_arrays(data: bytes, random: spoil.Random, others: Sequence[bytes]) -> bytes:
    """Something else in its arrays, and all checksums right, the scene's too."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = dict(archive)
    arrays.pop("checksum")
    for _ in range(random.integers(1, 3)):
        name = str(random.choice(sorted(set(arrays) - {"header"})))
        arrays[name] = spoil.of_array(arrays[name], random)
    header = json.loads(str(arrays["header"]))
    tree = [arrays[key] for i in range(len(arrays)) if (key := f"origin_{i}") in arrays]
    with contextlib.suppress(JaxrbError):  # then the reader has to refuse it for the same reason
        header["scene_sha256"] = fingerprint(decoded(header["origin"]["scene"], tree, "a spoiled file"))
    arrays["header"] = np.asarray(json.dumps(header))
    return _sealed(arrays)


def _sealed(arrays: dict[str, np.ndarray]) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays, checksum=np.asarray(digest(arrays)))  # pyright: ignore[reportArgumentType]
    return stream.getvalue()


def _read_checkpoint(path: Path) -> str | None:
    opened(RunFile(path, 2**30))
    return None


_BYTES, _TEXT = (spoil.of_bytes,), (spoil.of_text, spoil.of_bytes)
_ARCHIVE = (spoil.of_archive, spoil.of_archive, spoil.of_bytes)
# A reader of another kind of file joins the list here: whole files, ways to spoil them, and the call that reads one.
FORMATS: dict[str, Format] = {
    "npz": Format(".npz", _stacked_recordings, _ARCHIVE, _read_recording),
    "csv": Format(".csv", lambda: _recordings("csv"), _TEXT, _read_recording),
    "stl": Format(".stl", meshes.stl, _TEXT, meshes.read),
    "obj": Format(".obj", meshes.obj, _TEXT, meshes.read),
    "ply": Format(".ply", meshes.ply, _TEXT, meshes.read),
    "glb": Format(".glb", meshes.glb, (meshes.of_glb, meshes.of_glb, spoil.of_bytes), meshes.read),
    "scene": Format(".py", lambda: [_SCENE], (spoil.of_text,), _read_scene),
    "checkpoint": Format(".npz", _checkpoints, (_of_header, _of_arrays, *_ARCHIVE), _read_checkpoint),
    "mjcf": Format(".xml", models.mjcf, _TEXT, models.read_mjcf, compiled=True),
    "urdf": Format(".urdf", models.urdf, _TEXT, models.read_urdf, compiled=True),
}
