"""Nearly convex parts of a mesh that is not convex, by CoACD, kept in a file since finding them takes seconds."""

import hashlib
import importlib.metadata
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, JaxrbError, WrongStructure
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.mesh import TriangleMesh

_LAYOUT = 1  # of the file


def convex_decomposition(
    mesh: TriangleMesh,
    *,
    concavity: float = 0.05,
    max_parts: int | None = None,
    seed: int = 0,
    cache: str | os.PathLike | None = None,
) -> tuple[ConvexHull, ...]:
    """Convex hulls that together nearly fill a mesh, for collisions (needs the extras [mesh] and [decompose]).

    Wei, Liu, Ling, Su 2022, "Approximate convex decomposition for 3D meshes with collision-aware concavity and tree
    search". The parts overlap and round off what they cover: take mass and inertia from the mesh itself.

    Args:
        mesh: closed. concavity: how far a part may stay from its hull, relative to the size of the mesh, 0.01 to 1.
        max_parts: join parts until there are at most so many.
        seed: of the search; the same seed gives the same parts.
        cache: a folder in which results are kept, under a name made of geometry and settings.

    Raises:
        InvalidInput: an open mesh, a setting out of range, a folder that cannot be written.
        JaxrbError: where CoACD is not installed.
    """
    vertices, triangles = _geometry(mesh)
    if not 0.01 <= concavity <= 1:
        raise InvalidInput(f"convex_decomposition: concavity is {concavity}, but must lie between 0.01 and 1")
    if max_parts is not None and max_parts < 1:
        raise InvalidInput(f"convex_decomposition: max_parts is {max_parts}, but must be at least 1")
    settings = (float(concavity), max_parts, int(seed))
    file = None if cache is None else Path(cache) / f"parts-{_digest(vertices, triangles, settings)}.npz"
    parts = None if file is None else _recall(file)
    if parts is None:
        parts = _decomposed(vertices, triangles, *settings)
        if file is not None:
            _keep(file, parts)
    return tuple(ConvexHull(part) for part in parts)


def _geometry(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    if not isinstance(mesh, TriangleMesh):
        raise WrongStructure(
            f"convex_decomposition: {type(mesh).__name__} is no TriangleMesh; convex shapes need none"
        )
    if not is_concrete(mesh.vertices):
        raise WrongStructure(
            "convex_decomposition: parts are found on the host and cannot be traced; find them before"
        )
    if not mesh.is_closed:
        raise InvalidInput(
            f"TriangleMesh {mesh.name!r} is open, so its parts have no inside; close it, or take mesh.convex_hull()"
        )
    return np.asarray(mesh.vertices, float), mesh.triangles.triangles


def _digest(vertices: np.ndarray, triangles: np.ndarray, settings: tuple) -> str:
    try:
        version = importlib.metadata.version("coacd")
    except importlib.metadata.PackageNotFoundError:
        version = "any"
    digest = hashlib.sha256(repr((_LAYOUT, version, settings, vertices.shape, triangles.shape)).encode())
    digest.update(vertices.tobytes() + triangles.astype("<i4").tobytes())
    return digest.hexdigest()


def _decomposed(
    vertices: np.ndarray, triangles: np.ndarray, concavity: float, max_parts: int | None, seed: int
) -> list[np.ndarray]:
    try:
        import coacd
    except ImportError as error:
        raise JaxrbError("convex_decomposition needs CoACD: pip install jaxrb[decompose]") from error
    coacd.set_log_level("error")
    most = -1 if max_parts is None else int(max_parts)
    found = coacd.run_coacd(coacd.Mesh(vertices, triangles), concavity, max_convex_hull=most, seed=seed)
    if not found:
        raise JaxrbError("convex_decomposition: CoACD found no parts; check the mesh, or raise concavity")
    return [np.asarray(part[0], float) for part in found]


def _recall(file: Path) -> list[np.ndarray] | None:
    """The parts, if they are known. A file that cannot be read counts as none and is written anew."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            points, counts = stored["points"], stored["counts"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    sound = (
        points.ndim == 2 and points.shape[1:] == (3,) and points.dtype == float and np.isfinite(points).all()
    )
    if not (sound and counts.ndim == 1 and counts.dtype.kind == "i" and len(counts) and (counts >= 4).all()):
        return None
    return np.split(points, np.cumsum(counts)[:-1]) if counts.sum() == len(points) else None


def _keep(file: Path, parts: list[np.ndarray]) -> None:
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(dir=file.parent, prefix=file.stem, suffix=".part")
        with os.fdopen(handle, "wb") as stream:  # a reader never sees half a file
            np.savez(stream, points=np.concatenate(parts), counts=np.array([len(part) for part in parts]))
        os.replace(scratch, file)
    except OSError as error:
        raise InvalidInput(
            f"convex_decomposition: cache folder {file.parent}: {error.strerror}; name one that you can write"
        ) from error
