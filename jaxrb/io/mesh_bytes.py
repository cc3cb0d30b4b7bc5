"""What the mesh readers share: refusals, and numbers out of bytes without trusting them."""

import numpy as np

from jaxrb.errors import InvalidInput, LimitExceeded

Arrays = tuple[np.ndarray, np.ndarray]  # vertices (n, 3) float64, triangles (m, 3) whole numbers


def too_many(where: str, count: int, limit: int) -> LimitExceeded:
    """The refusal of a mesh that is too large."""
    return LimitExceeded(
        f"{where}: {count} triangles are more than max_triangles={limit}; simplify it or raise max_triangles"
    )


def fanned(where: str, polygons: list[list[int]], limit: int) -> np.ndarray:
    """Polygons as triangles (m, 3) from their first corners; exact where they are plane."""
    count = sum(len(polygon) - 2 for polygon in polygons)
    if count > limit:
        raise too_many(where, count, limit)
    fans = [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]
    return np.array(fans, np.int64).reshape(-1, 3)


def real(where: str, text: bytes) -> float:
    """One number of a text file."""
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{where}: {shown(text)} is not a number") from None


def whole(where: str, text: bytes) -> int:
    """One whole number of a text file, which counts or names something in it."""
    try:
        number = int(text)
    except ValueError:
        raise InvalidInput(f"{where}: {shown(text)} is not a whole number") from None
    if abs(number) >= 2**40:
        raise InvalidInput(f"{where}: {shown(text)} is no number of anything in a file")
    return number


def shown(text: bytes) -> str:
    """A piece of a file for a message."""
    return repr(text[:40].decode("ascii", "replace"))
