"""The smallest ball and a tight box of points, on the host in float64."""

import itertools

import numpy as np

from jaxrb.geometry.hull import ConvexHull

_MOST_AXES = 400  # directions tried for a box; beyond that a fair sample of them


def smallest_ball(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of the smallest ball of points (n, 3), which is unique.

    By pivoting (Gärtner 1999, "Fast and robust smallest enclosing balls"): the farthest point joins those on the
    surface, of which the smallest ball of at most five is found outright, until none lies outside.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    at = points - middle
    chosen = [int(np.argmax((at**2).sum(axis=1)))]
    center, squared = at[chosen[0]], 0.0
    for _ in range(len(points) + 100):
        distance = ((at - center) ** 2).sum(axis=1)
        farthest = int(np.argmax(distance))
        if farthest in chosen or distance[farthest] <= squared * (1 + 1e-14):
            break
        chosen, center, squared = _ball_of_few(at, [*chosen, farthest])
    return center + middle, float(np.sqrt(((at - center) ** 2).sum(axis=1).max()))


def _ball_of_few(points: np.ndarray, numbers: list[int]) -> tuple[list[int], np.ndarray, float]:
    """The smallest ball of at most five points: that through some of them which holds the others."""
    best = None
    few = points[numbers]
    for count in range(1, min(len(numbers), 4) + 1):
        for subset in itertools.combinations(range(len(numbers)), count):
            corner, sides = few[subset[0]], few[list(subset[1:])] - few[subset[0]]
            # Equally far from all of the subset, in the flat that they span.
            offset = np.linalg.lstsq(2 * sides, (sides**2).sum(axis=1), rcond=None)[0] if count > 1 else 0.0
            center = corner + offset
            squared = ((few - center) ** 2).sum(axis=1).max()
            if best is None or squared < best[2] * (1 - 1e-13):
                best = ([numbers[i] for i in subset], center, squared)
    assert best is not None
    return best


def tight_box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes (3, 3) as columns, and low (3,), high (3,) along them, of a tight box of points that span space."""
    hull = ConvexHull(points)
    points = np.asarray(hull.vertices, float)
    normals = _normals(points, np.asarray(hull.faces))
    ends = np.asarray(hull.edges)[:, :2]
    along = points[ends[:, 1]] - points[ends[:, 0]]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    spread = np.linalg.eigh(np.cov(points.T))[1]
    candidates = np.concatenate([spread.T, np.eye(3), _sample(normals, _MOST_AXES), _edge_products(along)])
    boxes = sorted((_flush_box(points, axis) for axis in candidates), key=lambda box: box[0])[:8]
    best = boxes[0]
    for box in boxes:
        for _ in range(20):
            turned = min((_flush_box(points, axis) for axis in box[1].T), key=lambda found: found[0])
            if turned[0] >= box[0] * (1 - 1e-9):
                break
            box = turned
        best = min(best, box, key=lambda found: found[0])
    heights = points @ best[1]
    return best[1], heights.min(axis=0), heights.max(axis=0)


def _flush_box(points: np.ndarray, axis: np.ndarray) -> tuple[float, np.ndarray]:
    """The smallest box with a given axis: its rectangle has a side along a side of the outline (Freeman 1975)."""
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side), axis], axis=1)
    local = points @ frame
    outline = local[_outline(local[:, :2]), :2]
    sides = np.roll(outline, -1, axis=0) - outline
    lengths = np.linalg.norm(sides, axis=-1, keepdims=True)
    long = lengths[:, 0] > 1e-9 * lengths.max()  # of corners that fall on each other the direction is noise
    sides = sides[long] / lengths[long]
    across = np.stack([-sides[:, 1], sides[:, 0]], axis=-1)
    areas = np.ptp(outline @ sides.T, axis=0) * np.ptp(outline @ across.T, axis=0)
    k = int(areas.argmin())
    turn = np.stack([sides[k], across[k]], axis=1)
    axes = np.concatenate([frame[:, :2] @ turn, frame[:, 2:]], axis=1)
    return float(areas[k] * np.ptp(local[:, 2])), axes


def _outline(points: np.ndarray) -> np.ndarray:
    """Numbers of the corners of the convex outline of points (n, 2), in order (Andrew 1979, monotone chain)."""
    order = np.lexsort((points[:, 1], points[:, 0]))

    def chain(numbers: np.ndarray) -> list[int]:
        kept: list[int] = []
        for i in numbers:
            while len(kept) > 1:
                (ax, ay), (bx, by), (cx, cy) = points[kept[-2]], points[kept[-1]], points[i]
                if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0:
                    break
                kept.pop()
            kept.append(int(i))
        return kept[:-1]

    return np.array(chain(order) + chain(order[::-1]))


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _edge_products(along: np.ndarray) -> np.ndarray:
    """Axes at right angles to two edges: the other kind of face that a smallest box can have."""
    pairs = np.array(list(itertools.combinations(range(min(len(along), 60)), 2))).reshape(-1, 2)
    some = _sample(along, 60)
    axes = np.cross(some[pairs[:, 0]], some[pairs[:, 1]])
    length = np.linalg.norm(axes, axis=-1)
    return _sample(axes[length > 1e-6] / length[length > 1e-6, None], _MOST_AXES)


def _sample(rows: np.ndarray, most: int) -> np.ndarray:
    """At most so many rows, always the same ones."""
    if len(rows) <= most:
        return rows
    return rows[np.random.default_rng(0).choice(len(rows), most, replace=False)]
