"""A loss at a point: its derivatives in both modes along directions, and its values ahead and behind."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.gradient_check_differences import Differences
from jaxrb.checks import is_concrete
from jaxrb.draws import drawn
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.scene.settings import check_count

_ALL_COORDINATES = 12  # beyond so many numbers, directions are drawn
_DRAWN = 6


class Point:
    """A loss and the place at which it is looked at, as lists of floating leaves."""

    def __init__(self, loss: Callable, at: Any, scale: Any, key: Any, samples: int, jit: bool):
        numbers, self.rest = eqx.partition(at, _is_floating)
        self.paths, leaves = [], []
        for path, leaf in jax.tree_util.tree_flatten_with_path(numbers)[0]:
            self.paths.append(jax.tree_util.keystr(path) or "value")
            leaves.append(jnp.asarray(leaf))
        if not leaves:
            raise WrongStructure(
                "gradient_check: `at` holds no floating array; give what the loss depends on"
            )
        if not all(is_concrete(leaf) for leaf in leaves):
            raise WrongStructure("gradient_check: cannot look inside jit, grad or vmap; call it outside")
        self.leaves, self.structure = leaves, jax.tree.structure(numbers)
        self.host = [np.asarray(leaf, float) for leaf in leaves]
        self.scales = self._scales(scale, numbers)
        self.compile = jax.jit if jit else lambda f: f
        self.keys = (
            None if key is None else jax.random.split(key, check_count("gradient_check: samples", samples, 2))
        )

        def one(leaves: list, *key: Any) -> Any:
            return loss(eqx.combine(jax.tree.unflatten(self.structure, leaves), self.rest), *key)

        self.one = one
        self.each = self.compile(
            one if key is None else lambda leaves: jax.vmap(one, (None, 0))(leaves, self.keys)
        )
        values = self.each(leaves)
        shape = np.shape(values) if key is None else np.shape(values)[1:]
        if shape != () or not jnp.issubdtype(jnp.result_type(values), jnp.floating):
            raise WrongStructure(
                f"gradient_check: the loss gives {shape} of {jnp.result_type(values)}; give one real number"
            )
        self.values = np.asarray(values, float)
        self.value, self.dtype = float(self.values.mean()), jnp.result_type(values)

    def _scales(self, scale: Any, numbers: Any) -> list[float]:
        if scale is None:
            return [float(np.abs(leaf).max(initial=0.0)) or 1.0 for leaf in self.host]
        given = jax.tree.leaves(scale)
        given = given * len(self.leaves) if jax.tree.structure(scale) == jax.tree.structure(0) else given
        scales = [float(np.max(s)) for s in given]
        if len(scales) != len(self.leaves) or not all(np.isfinite(s) and s > 0 for s in scales):
            raise InvalidInput(
                f"gradient_check: scale {scale!r}; give a positive number, or one for each of the "
                f"{len(self.leaves)} floating leaves of `at`, in a tree like it"
            )
        return scales

    def lines(self, directions: int | None) -> tuple[list[str], list[list[np.ndarray]], list[float]]:
        """Names, directions (a list of leaves each) and by how much a step of 1 goes along each."""
        size = sum(leaf.size for leaf in self.host)
        if directions is None and size <= _ALL_COORDINATES:
            names, lines, sizes = [], [], []
            for i, (path, leaf, scale) in enumerate(zip(self.paths, self.host, self.scales, strict=True)):
                for at in np.ndindex(leaf.shape):
                    line = [np.zeros_like(other) for other in self.host]
                    line[i][at] = 1.0
                    names.append(path + (str(list(at)) if at else ""))
                    lines.append(line)
                    sizes.append(scale)
            return names, lines, sizes
        count = check_count("gradient_check: directions", _DRAWN if directions is None else directions, 1)
        draw = drawn(0)
        lines = [
            [
                s * draw.choice([-1.0, 1.0], leaf.shape) / np.sqrt(size)
                for leaf, s in zip(self.host, self.scales)
            ]
            for _ in range(count)
        ]
        return [f"random direction {i}" for i in range(count)], lines, [1.0] * count

    def differences(
        self, line: list[np.ndarray], size: float, steps: np.ndarray, eps: float, progress: Any
    ) -> Differences:
        """The loss ahead of the point and behind it. Steps are those that the numbers' own type can take."""
        rows: list[tuple] = []
        length = sum(float((part**2).sum()) for part in line)
        for h in steps * size:
            row = []
            for sign in (1.0, -1.0):
                moved = [jnp.asarray(x + sign * h * part, leaf.dtype)
                         for x, part, leaf in zip(self.host, line, self.leaves, strict=True)]  # fmt: skip
                taken = sum(
                    float(((np.asarray(m, float) - x) * part).sum())
                    for m, x, part in zip(moved, self.host, line)
                )
                row.append((abs(taken) / length, np.asarray(self.each(moved), float)))
                if progress is not None:
                    progress()
            rows.append(tuple(row))
        taken = np.array([0.5 * (a[0] + b[0]) for a, b in rows])
        kept = np.flatnonzero((taken > 0) & (np.diff(taken, prepend=0.0) > 0))
        # A step that rounding made longer or shorter on one side is put right by the slope in between.
        ahead, behind = (
            np.array(
                [np.mean(self.value + (rows[i][k][1] - self.values) * taken[i] / rows[i][k][0]) for i in kept]
            )
            for k in (0, 1)
        )
        scatter = None
        if self.keys is not None:
            each = [(rows[i][0][1] - rows[i][1][1]) / (2 * taken[i]) for i in kept]
            scatter = np.array([e.std(ddof=1) / np.sqrt(len(e)) for e in each])
        return Differences(taken[kept], self.value, ahead, behind, eps, scatter)

    def derivatives(self, lines: list[list[np.ndarray]]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Slopes (directions, samples) by each mode that runs, and what the others raised."""
        stacked = [
            jnp.asarray(np.stack(parts), leaf.dtype)
            for parts, leaf in zip(zip(*lines), self.leaves, strict=True)
        ]

        def along(leaves: list, line: list) -> Any:
            return jax.jvp(self.each, (leaves,), (line,))[1]

        def forward() -> np.ndarray:
            slopes = np.asarray(self.compile(jax.vmap(along, (None, 0)))(self.leaves, stacked), float)
            return slopes.reshape(len(lines), -1)

        def reverse() -> np.ndarray:
            gradient = jax.grad(self.one)
            if self.keys is None:
                found = [np.asarray(g, float)[None] for g in self.compile(gradient)(self.leaves)]
            else:
                each = self.compile(lambda leaves: jax.vmap(gradient, (None, 0))(leaves, self.keys))
                found = [np.asarray(g, float) for g in each(self.leaves)]
            return np.array([_products(found, line) for line in lines])

        modes, failed = {}, {}
        for mode, run in (("forward", forward), ("reverse", reverse)):
            try:
                modes[mode] = run()
            except Exception as error:  # whatever JAX or a user's rule raises: it is told in the report
                failed[mode] = f"{type(error).__name__}: {str(error).strip().splitlines()[0]}"
        return modes, failed

    def growth(self, over_time: Callable, lines: list[list[np.ndarray]], sizes: list[float]) -> tuple:
        """Times (k,) and the length of the gradient, in scaled coordinates, at each."""

        def losses(leaves: list) -> Any:
            return over_time(eqx.combine(jax.tree.unflatten(self.structure, leaves), self.rest))

        stacked = [
            jnp.asarray(np.stack(parts), leaf.dtype)
            for parts, leaf in zip(zip(*lines), self.leaves, strict=True)
        ]
        slopes = self.compile(jax.vmap(lambda line: jax.jvp(losses, (self.leaves,), (line,))))(stacked)
        (times, _), (_, changes) = slopes
        scaled = np.asarray(changes, float) * np.asarray(sizes)[:, None]
        return tuple(np.asarray(times, float)[0]), tuple(np.linalg.norm(scaled, axis=0))


def _products(gradients: list[np.ndarray], line: list[np.ndarray]) -> np.ndarray:
    """Slopes (samples,) along a direction. A number that the direction does not move has no part, finite or not."""
    total = 0.0
    for g, part in zip(gradients, line, strict=True):
        moved = part != 0
        total = total + (g[:, moved] * part[moved]).sum(axis=-1)
    return np.asarray(total)


def _is_floating(leaf: Any) -> bool:
    return isinstance(leaf, float) or (
        isinstance(leaf, (jax.Array, np.ndarray, np.generic)) and jnp.issubdtype(leaf.dtype, jnp.floating)
    )
