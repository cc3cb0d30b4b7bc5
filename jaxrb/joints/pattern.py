"""Which rows of joints share a body: known when the program is traced."""

import dataclasses
import functools

import numpy as np

from jaxrb.joints.banded import ordered


@dataclasses.dataclass(frozen=True)
class Pattern:
    """Of the rows: their `bodies` (rows, 2); the `pairs` of rows that share a body, (row, row, side, side); the `place`
    (rows,) of each in the blocks of the matrix, and their `width`."""

    bodies: np.ndarray
    pairs: tuple[np.ndarray, ...]
    place: np.ndarray
    width: int


@functools.lru_cache(maxsize=64)
def pattern_of(bodies: tuple[tuple[int, int], ...], count: int) -> Pattern:
    """The pattern of rows between these bodies, of which there are `count`."""
    array = np.asarray(bodies, np.int32)
    found = []
    for body in np.unique(array[array < count]):
        row, side = np.nonzero(array == body)
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(len(row)), np.arange(len(row))))
        found.append(np.stack([row[i], row[j], side[i], side[j]]))
    pairs = np.concatenate(found, axis=1).astype(np.int32)
    place, width = ordered(pairs[0], pairs[1], len(array))
    return Pattern(array, tuple(pairs), place, width)
