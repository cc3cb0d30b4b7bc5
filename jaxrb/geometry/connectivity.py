"""Which triangles of a surface share edges: structure, known on the host, wherever the vertices stand."""

import functools
from typing import Any

import numpy as np

from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, WrongStructure


class Connectivity:
    """The triangles (m, 3) of a surface as vertex numbers: hashable, so that it can be part of a tree's structure."""

    def __init__(self, triangles: Any):
        array = np.array(triangles, np.int32)
        array.setflags(write=False)
        self.triangles = array
        self._hash = hash((array.shape, array.tobytes()))

    @classmethod
    def checked(cls, where: str, triangles: Any, vertices: int) -> "Connectivity":
        """The same with every number in its range.

        Raises:
            WrongStructure: not whole numbers (m, 3). InvalidInput: a number that no vertex has.
        """
        if isinstance(triangles, cls):
            triangles = triangles.triangles
        if not is_concrete(triangles):
            raise WrongStructure(
                f"{where}: vertex numbers are structure and cannot be traced; give a host array"
            )
        array = np.asarray(triangles)
        if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
            raise WrongStructure(
                f"{where}: shape {array.shape} of {array.dtype}; give whole numbers (m, 3), three vertices a triangle"
            )
        if not len(array):
            raise InvalidInput(f"{where}: no triangles; a mesh needs at least four")
        wrong = (array < 0) | (array >= vertices)
        if wrong.any():
            row, corner = np.argwhere(wrong)[0]
            raise InvalidInput(
                f"{where}: triangle {row} names vertex {array[row, corner]}, but there are {vertices} vertices, "
                "numbered from 0; was the list of vertices cut, or numbered from 1?"
            )
        return cls(array)

    def __len__(self) -> int:
        return len(self.triangles)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (
            isinstance(other, Connectivity)
            and self._hash == other._hash
            and np.array_equal(self.triangles, other.triangles)
        )

    def __repr__(self) -> str:
        return f"Connectivity({len(self)} triangles)"

    @functools.cached_property
    def _edges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Edges (e, 2) once each, the edge of each side (m, 3), uses of each edge, uses in ascending direction."""
        sides = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
        ascending = sides[:, 0] < sides[:, 1]
        low, high = sides.min(axis=1).astype(np.int64), sides.max(axis=1).astype(np.int64)
        size = int(high.max()) + 1
        keys, edge, uses = np.unique(low * size + high, return_inverse=True, return_counts=True)
        forward = np.bincount(edge, weights=ascending, minlength=len(keys)).astype(int)
        return np.stack([keys // size, keys % size], axis=1), edge.reshape(-1, 3), uses, forward

    @property
    def edges(self) -> np.ndarray:
        """Every edge once, as pairs of vertex numbers (e, 2)."""
        return self._edges[0]

    @property
    def open_edges(self) -> np.ndarray:
        """Edges (k, 2) of one triangle only: the rims of holes."""
        edges, _, uses, _ = self._edges
        return edges[uses == 1]

    @property
    def crowded_edges(self) -> np.ndarray:
        """Edges (k, 2) at which three or more triangles meet: there the surface is no manifold."""
        edges, _, uses, _ = self._edges
        return edges[uses > 2]

    @property
    def disputed_edges(self) -> np.ndarray:
        """Edges (k, 2) of two triangles that run along it in the same direction: one of the two is turned over."""
        edges, _, uses, forward = self._edges
        return edges[(uses == 2) & (forward != 1)]

    @property
    def is_closed(self) -> bool:
        """Whether each edge belongs to exactly two triangles that run along it in opposite directions."""
        _, _, uses, forward = self._edges
        return bool(((uses == 2) & (forward == 1)).all())

    @functools.cached_property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """The triangle across each side (m, 3), −1 at a rim or a crowded edge, and whether the two are at odds."""
        _, edge, uses, forward = self._edges
        flat = edge.ravel()
        order = np.argsort(flat, kind="stable")
        pair = np.flatnonzero(uses[flat[order]] == 2)
        first, second = order[pair[::2]], order[pair[1::2]]
        across = np.full(flat.shape, -1, np.int64)
        across[first], across[second] = second // 3, first // 3
        return across.reshape(-1, 3), ((uses == 2) & (forward != 1))[edge]

    @functools.cached_property
    def shells(self) -> np.ndarray:
        """The number (m,) of the connected piece to which each triangle belongs, from 0."""
        across, _ = self.neighbours
        own = np.arange(len(self))
        across = np.where(across < 0, own[:, None], across)
        label = own
        while True:  # the smallest number in the neighbourhood, with pointer jumping: a few rounds
            least = np.minimum(label, label[across].min(axis=1))
            np.minimum.at(least, label, least)
            least = least[least]
            if np.array_equal(least, label):
                return np.unique(label, return_inverse=True)[1].ravel()
            label = least

    def wound_alike(self) -> tuple[np.ndarray, bool]:
        """Triangles turned over (m,) so that neighbours agree, and whether that is possible at all.

        In each connected piece the smaller number of triangles is turned.
        """
        across, odds = self.neighbours
        shells = self.shells
        turned = np.full(len(self), -1, np.int64)
        seeds = np.unique(shells, return_index=True)[1]
        turned[seeds] = 0
        front = seeds
        while len(front):
            reached = across[front]
            new = (reached >= 0) & (turned[reached] < 0)
            faces, first = np.unique(reached[new], return_index=True)
            turned[faces] = (turned[front][:, None] ^ odds[front])[new][first]
            front = faces
        known = across >= 0
        possible = bool(((turned[across] ^ turned[:, None]) == odds)[known].all())
        most = np.bincount(shells, weights=turned) * 2 > np.bincount(shells)
        return (turned ^ most[shells]).astype(bool), possible
