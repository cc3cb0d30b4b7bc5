"""Where rods of a mechanism lie, and joints between them at points of the world."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrb.body.body import Body
from jaxrb.joints.kinds import BallJoint, Hinge
from jaxrb.math.quaternion import Quaternion


class Rods:
    """Where rods lie that lead from point to point, their z axis along them; and joints between them at points."""

    def __init__(self, points: Sequence[np.ndarray]):
        self._set(list(itertools.pairwise(points)), points)

    @classmethod
    def of(cls, ends: Sequence[tuple[np.ndarray, np.ndarray]]) -> "Rods":
        """Rods between these ends."""
        rods = cls.__new__(cls)
        rods._set(list(ends), ())
        return rods

    def _set(self, ends: list, points: Sequence[np.ndarray]) -> None:
        self.points = points
        self.middles = [0.5 * (a + b) for a, b in ends]
        self.turns = [_along(b - a) for a, b in ends]

    @property
    def start(self) -> dict[str, Any]:
        """The arguments of `Scene.state`."""
        turns = [_wxyz(turn).tolist() for turn in self.turns]
        return {"position": [m.tolist() for m in self.middles], "orientation": turns}

    def local(self, body: int | None, point: np.ndarray) -> tuple[float, ...]:
        """A point of the world in the frame of a rod, or of the world."""
        if body is None:
            return tuple(point.tolist())
        return tuple((self.turns[body].T @ (point - self.middles[body])).tolist())

    def seen(self, a: int, b: int | None) -> Quaternion:
        """The attitude of a as seen from b."""
        turn = self.turns[a] if b is None else self.turns[b].T @ self.turns[a]
        return Quaternion(_wxyz(turn))

    def ball(self, a: int, b: int | None, point: int | np.ndarray) -> BallJoint:
        """A ball joint at a point, or the point of that number."""
        place = self.points[point] if isinstance(point, int) else point
        return BallJoint(self.local(a, place), self.local(b, place), bodies=(a, b))

    def hinge(self, a: int, b: int | None, point: int | np.ndarray, axis: Any, *drives: Any) -> Hinge:
        """A hinge at a point about an axis of the world; angle zero is here."""
        place = self.points[point] if isinstance(point, int) else point
        own = self.turns[a].T @ np.asarray(axis, float)
        return Hinge(
            own, self.local(a, place), self.local(b, place), self.seen(a, b), bodies=(a, b), drives=drives
        )


def rod(length: float, mass: float) -> Body:
    """A thin rod along z, as thick as a hundredth of its length."""
    across = mass * length**2 / 12.0
    return Body(mass, (across, across, 0.5 * mass * (0.005 * length) ** 2))


def _along(direction: np.ndarray) -> np.ndarray:
    """A rotation matrix whose third column points along `direction`; y stays across the plane x-z."""
    z = direction / np.linalg.norm(direction)
    helper = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _wxyz(matrix: np.ndarray) -> np.ndarray:
    """The quaternion of a rotation matrix, on the host, so that making a scene compiles nothing."""
    m = matrix
    squares = np.array([1 + np.trace(m), *(1 + 2 * m[i, i] - np.trace(m) for i in range(3))])
    skew = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    table = np.zeros((4, 4))
    table[0], table[1:, 0] = [squares[0], *skew], skew
    table[1:, 1:] = m + m.T
    table[1, 1], table[2, 2], table[3, 3] = squares[1:]
    best = table[squares.argmax()]
    return best / np.linalg.norm(best)
