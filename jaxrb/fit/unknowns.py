"""The unknowns of `rb.fit`: a tree of numbers and bodies, and the coordinates in which they are stepped."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.errors import InvalidInput, NotIdentifiable
from jaxrb.fit.inertial import Inertial
from jaxrb.math.arrays import Array, Scalar

_ROUND_OFF = 1e-12  # of the information, relative to its largest direction, once each number has its own unit
_WORTH_A_WORD = 0.05


@dataclass(frozen=True, eq=False)
class Numbers:
    """A leaf of numbers: those that start positive are stepped by their logarithm, others in units of their start."""

    start: Array

    @property
    def size(self) -> int:
        return int(np.size(self.start))

    def value(self, step: Array) -> Array:
        flat = jnp.ravel(self.start)
        positive, unit = flat > 0, jnp.where(flat == 0, 1.0, jnp.abs(flat))
        moved = jnp.where(positive, flat * jnp.exp(jnp.where(positive, step, 0.0)), flat + unit * step)
        return moved.reshape(self.start.shape)

    def penalty(self, step: Array, barrier: Scalar) -> Array:
        return jnp.zeros((0,), step.dtype)

    def reached(self, step: Array) -> bool:
        return False

    def relative(self, step: Array) -> np.ndarray:
        return np.eye(self.size)

    def relative_names(self, name: str) -> list[str]:
        shape, name = np.shape(self.start), name or "unknown"
        return [name if not shape else f"{name}{list(index)}" for index in np.ndindex(*shape)]


@dataclass(frozen=True)
class Unknowns:
    """Leaves with their places in a step (P,), and the tree that they make."""

    leaves: tuple[Numbers | Inertial, ...]
    tree: Any
    paths: tuple[str, ...]
    dtype: Any

    @property
    def size(self) -> int:
        """P, the numbers of a step."""
        return sum(self._sizes)

    @property
    def _sizes(self) -> list[int]:
        return [leaf.size for leaf in self.leaves]

    @property
    def penalised(self) -> bool:
        """Whether a prior or a bounding shape adds to the cost."""
        return any(isinstance(leaf, Inertial) and leaf.penalised for leaf in self.leaves)

    @property
    def bounded(self) -> bool:
        """Whether a bounding shape holds a body."""
        return any(isinstance(leaf, Inertial) and leaf.within is not None for leaf in self.leaves)

    def values(self, step: Array) -> Any:
        """The tree a step (P,) away from the start."""
        return jax.tree.unflatten(self.tree, [leaf.value(part) for leaf, part in self._parts(step)])

    def penalty(self, step: Array, barrier: Scalar) -> Array:
        """Residuals (R,) that do not come from data."""
        rows = [leaf.penalty(part, barrier) for leaf, part in self._parts(step)]
        return jnp.concatenate([*rows, jnp.zeros((0,), step.dtype)])

    def reached(self, step: Array) -> tuple[str, ...]:
        """Names of the bodies that their bounding shape holds back."""
        named = zip(self.paths, self._parts(step))
        return tuple(path or "unknown" for path, (leaf, part) in named if leaf.reached(part))

    def rates(self, step: Array) -> np.ndarray:
        """Derivative (N, P) of the tree's numbers by the step."""
        return np.asarray(jax.jacfwd(lambda s: raveled(self.values(s)))(step), float)

    def check_seen(self, information: np.ndarray, step: Array, source: str) -> None:
        """Refuse directions without information (P, P); `null_vectors` (n, P) are relative changes.

        Raises:
            NotIdentifiable: naming each direction.
        """
        names = [n for leaf, path in zip(self.leaves, self.paths) for n in leaf.relative_names(path)]
        if not np.all(np.isfinite(information)):
            raise NotIdentifiable(f"{source}: the motion has no finite derivative by {', '.join(names)}.")
        # A prior knows a whole body, however little beside sharp data: round-off must not count it as open.
        known = np.repeat([getattr(leaf, "prior", None) is not None for leaf in self.leaves], self._sizes)
        values, vectors = np.linalg.eigh(information + np.diag(known * np.trace(information)))
        null = vectors.T[values <= _ROUND_OFF * max(values[-1], 1e-300)]
        if not len(null):
            return
        relative = np.zeros((self.size, self.size))
        at = 0
        for leaf, part in self._parts(step):
            relative[at : at + leaf.size, at : at + leaf.size] = leaf.relative(part)
            at += leaf.size
        null = _plain(null @ relative.T)
        words = [
            " ".join(f"{value:+.2g} {name}" for value, name in zip(row, names) if abs(value) > _WORTH_A_WORD)
            for row in null
        ]
        error = NotIdentifiable(
            f"{source}: nothing that was recorded changes along {'; '.join(words)} (relative). Hold one of them"
            + (", or give a prior." if any(isinstance(leaf, Inertial) for leaf in self.leaves) else ".")
        )
        error.null_vectors = null  # pyright: ignore[reportAttributeAccessIssue]
        raise error

    def _parts(self, step: Array) -> list[tuple[Any, Array]]:
        cuts = np.cumsum(self._sizes)[:-1].tolist()
        return list(zip(self.leaves, jnp.split(step, cuts)))


def unknowns_of(start: Any) -> Unknowns:
    """Of a tree to start from.

    Raises:
        InvalidInput: for a start that is not finite.
    """
    found, tree = jax.tree_util.tree_flatten_with_path(start)
    leaves = tuple(
        leaf if isinstance(leaf, Inertial) else Numbers(jnp.asarray(leaf, float)) for _, leaf in found
    )
    for leaf in leaves:
        if isinstance(leaf, Numbers) and not bool(jnp.all(jnp.isfinite(leaf.start))):
            raise InvalidInput(
                f"fit: an unknown starts at {np.asarray(leaf.start).tolist()}; give finite numbers."
            )
    paths = tuple(path_name(path) for path, _ in found)
    return Unknowns(leaves, tree, paths, jnp.asarray(0.0).dtype)


def path_name(path: Any) -> str:
    """Of a place in a tree, such as body.mass."""
    return jax.tree_util.keystr(path, simple=True, separator=".")


def names_of(found: Any) -> tuple[str, ...]:
    """A name for each number of a tree, in order."""
    named = jax.tree_util.tree_flatten_with_path(found)[0]
    return tuple(name for path, leaf in named for name in Numbers(leaf).relative_names(path_name(path)))


def raveled(found: Any) -> Array:
    """All numbers of a tree (N,)."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(found)])


def unraveled(numbers: np.ndarray, like: Any) -> Any:
    """A tree of the same shapes with these numbers (N,)."""
    leaves, tree = jax.tree.flatten(like)
    shapes: list[tuple[int, ...]] = [np.shape(leaf) for leaf in leaves]
    cuts = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
    parts = [part.reshape(shape) for part, shape in zip(np.split(numbers, cuts), shapes)]
    return jax.tree.unflatten(tree, parts)


def _plain(rows: np.ndarray) -> np.ndarray:
    """The same space by rows with as many zeros as elimination makes, each of length one."""
    rows = rows.copy()
    used: list[int] = []
    for k in range(len(rows)):
        size = np.abs(rows[k:])
        size[:, used] = 0.0
        at, column = np.unravel_index(np.argmax(size), size.shape)
        rows[[k, k + int(at)]] = rows[[k + int(at), k]]
        rows[k] /= rows[k, column]
        used.append(int(column))
        others = np.arange(len(rows)) != k
        rows[others] -= np.outer(rows[others, column], rows[k])
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)
