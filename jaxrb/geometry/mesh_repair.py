"""What is doubtful in a triangle mesh and can be mended: said aloud, then mended. On the host, in float64."""

from typing import Any

import numpy as np

from jaxrb.body.mass_properties import tetrahedra
from jaxrb.checks import warn
from jaxrb.errors import InvalidInput
from jaxrb.geometry.connectivity import Connectivity

# A part drawn in millimetres and read as metres is a thousand times too large; between these it may be meant.
_SMALLEST, _LARGEST = 1e-4, 1e4
_TINIEST = 1e-30
# More separate pieces than this are not checked for lying inside one another.
_MOST_SHELLS = 256


def without_repeats(where: str, connectivity: Connectivity) -> Connectivity:
    """Without triangles that name a vertex twice, and with each triangle once. Needs no positions."""
    triangles = connectivity.triangles
    a, b, c = triangles.T
    collapsed = (a == b) | (b == c) | (c == a)
    if collapsed.all():
        raise InvalidInput(f"{where}: every triangle names a vertex twice; there is no surface")
    if collapsed.any():
        warn(
            f"{where}: {collapsed.sum()} triangles without area, first triangle {np.argmax(collapsed)} with "
            f"vertices {triangles[collapsed][0].tolist()}, are dropped"
        )
        triangles = triangles[~collapsed]
    first_corner = triangles.argmin(axis=1)
    rolled = triangles[np.arange(len(triangles))[:, None], (first_corner[:, None] + np.arange(3)) % 3]
    _, kept = np.unique(rolled, axis=0, return_index=True)
    if len(kept) < len(triangles):
        repeated = np.setdiff1d(np.arange(len(triangles)), kept)
        warn(
            f"{where}: {len(repeated)} triangles are there twice (doubled shells), first triangle {repeated[0]}; "
            "each is counted once"
        )
        triangles = triangles[np.sort(kept)]
    return connectivity if triangles is connectivity.triangles else Connectivity(triangles)


def wound_alike(where: str, connectivity: Connectivity) -> Connectivity:
    """With neighbours wound in the same sense, where that is possible."""
    disputed = connectivity.disputed_edges
    if not len(disputed):
        return connectivity
    turned, possible = connectivity.wound_alike()
    if not possible:
        return connectivity  # a one-sided surface; it has no inside, and whoever asks for its mass is told
    warn(
        f"{where}: neighbouring triangles are wound in opposite senses at {len(disputed)} edges, first between "
        f"vertices {disputed[0].tolist()}; {turned.sum()} triangles are turned over"
    )
    return _turned(connectivity, turned)


def without_slivers(where: str, connectivity: Connectivity, vertices: np.ndarray) -> Connectivity:
    """Without triangles whose corners lie on a line, unless they are needed to close the surface."""
    corners = vertices[connectivity.triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
    # Longest side squared times the round-off of a double: below that the corners lie on a line.
    flat = area <= 4 * np.finfo(float).eps * (sides**2).sum(axis=-1).max(axis=1)
    if flat.all():
        _refuse_degenerate(where, vertices[np.unique(connectivity.triangles)])
        raise InvalidInput(f"{where}: every triangle is without area; there is no surface")
    if not flat.any():
        return connectivity
    kept = Connectivity(connectivity.triangles[~flat])
    needed = len(kept.open_edges) > len(connectivity.open_edges)
    what = "are kept, since the surface would be open without them" if needed else "are dropped"
    warn(f"{where}: {flat.sum()} triangles without area, first triangle {np.argmax(flat)}, {what}")
    return connectivity if needed else kept


def turned_outward(where: str, connectivity: Connectivity, vertices: np.ndarray) -> Connectivity:
    """With every closed piece wound anticlockwise seen from outside, and inner walls of hollow bodies the other way."""
    if not connectivity.is_closed:
        return connectivity
    shells = connectivity.shells
    count = int(shells.max()) + 1
    triangles = connectivity.triangles
    corners = vertices[triangles] - vertices[triangles].mean(axis=(0, 1))
    parts = tetrahedra(np, corners)[0]
    volumes = np.bincount(shells, parts)
    # A folded sheet encloses nothing, and its round-off has no sign.
    volumes[np.abs(volumes) <= 1e-12 * np.bincount(shells, np.abs(parts))] = 0.0
    inside = np.zeros(count, bool)
    if 1 < count <= _MOST_SHELLS:
        inside = _inside_another(corners, shells, volumes)
    wrong = (volumes < 0) & ~inside
    if wrong.any():
        turned = wrong[shells]
        warn(
            f"{where}: turned inside out (the volume of {wrong.sum()} closed pieces is negative); "
            f"{turned.sum()} triangles are turned over"
        )
        connectivity = _turned(connectivity, turned)
    nested = (volumes > 0) & inside
    if nested.any():
        warn(
            f"{where}: {nested.sum()} closed pieces lie inside another and are wound like it; their volume counts "
            "twice. If they are cavities, turn them over; if the file holds the surface twice, delete one"
        )
    return connectivity


def check_extent(where: str, vertices: np.ndarray) -> None:
    """Refuse what lies on a point, a line or a plane; doubt what has an unlikely size."""
    extent = float(np.ptp(vertices, axis=0).max())
    _refuse_degenerate(where, vertices)
    if not _SMALLEST <= extent <= _LARGEST:
        warn(f"{where}: {extent:.3g} m from end to end; are the lengths in another unit (unit='mm')?")


def warn_of_unused(where: str, count: int, used: np.ndarray) -> None:
    """Say which vertices belong to no triangle."""
    first = np.setdiff1d(np.arange(count), used)[0]
    warn(
        f"{where}: {count - len(used)} vertices belong to no triangle, first vertex {first}; they are dropped"
    )


def winding_number(point: np.ndarray, corners: np.ndarray) -> float:
    """How many times closed triangles (m, 3, 3) enclose a point (3,), by the solid angles.

    Van Oosterom and Strackee 1983, "The solid angle of a plane triangle".
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    triple = np.einsum("mi,mi->m", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("mi,mi->m", u, v) for u, v in ((a, b), (b, c), (c, a)))
    return float(np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi))


def _inside_another(corners: np.ndarray, shells: np.ndarray, volumes: np.ndarray) -> np.ndarray:
    """Whether each closed piece lies in the material of others (count,): their walls and cavities cancel."""
    count = len(volumes)
    order = np.argsort(shells, kind="stable")
    pieces = np.split(corners[order], np.searchsorted(shells[order], np.arange(1, count)))
    low = np.array([piece.min(axis=(0, 1)) for piece in pieces])
    high = np.array([piece.max(axis=(0, 1)) for piece in pieces])
    inside = np.zeros(count, bool)
    for i in range(count):
        around = (low < low[i]).all(axis=1) & (high > high[i]).all(axis=1)
        point = pieces[i].mean(axis=1)[0]
        # A piece that is itself inside out still encloses; its sign is not what is asked here.
        enclosing = [abs(winding_number(point, pieces[j])) > 0.5 for j in np.flatnonzero(around)]
        inside[i] = sum(enclosing) % 2 == 1
    return inside


def _turned(connectivity: Connectivity, which: np.ndarray) -> Connectivity:
    triangles: Any = connectivity.triangles.copy()
    triangles[which] = triangles[which][:, [0, 2, 1]]
    return Connectivity(triangles)


def _refuse_degenerate(where: str, vertices: np.ndarray) -> None:
    centred = vertices - vertices.mean(axis=0)
    size = np.linalg.svd(centred, compute_uv=False) if len(vertices) > 2 else np.zeros(3)
    small = 1e-12 * max(float(np.abs(centred).max()), 1e-4 * float(np.abs(vertices).max()))
    rank = int((size > small).sum())
    if rank == 3 and size[0] < _TINIEST:
        raise InvalidInput(
            f"{where}: {size[0]:.3g} m across; volumes leave the floating range; choose smaller units"
        )
    if rank == 3:
        return
    flat = ("in one point", "on one line", "in one plane")[rank]
    plate = "; give a plate its thickness, for instance as a Box" if rank == 2 else ""
    raise InvalidInput(f"{where}: all {len(vertices)} vertices lie {flat}, which encloses no volume{plate}")
