"""Symmetric banded systems A x = b of joints, of full rank or not.

A = J M⁻¹ Jᵀ is singular where joints say a thing twice: a door on two hinges, a closed loop in the plane, Bricard's
mechanism. The forces of such joints are not unique, but the motion is. A small multiple ε of the diagonal makes the
matrix safe to factorise and is taken out again by refinement with A itself (Riley 1955, Math. Tables Aids Comput. 9,
96): after k rounds an eigenvalue λ of the scaled matrix is met to (ε/(ε + λ))^k, and what A cannot see stays zero.

ε must not be too small either. In the middle of a step Bricard's mechanism is off its joints by dt², where its matrix
is regular with an eigenvalue of dt⁴: solved exactly, that gives accelerations that are wrong by O(1). Energy drift in
10 s at dt 1e-3, in J: 1e-4 with ε = 3e-14, 7e-9 with 3e-10, 1e-9 with 3e-8, 6e-4 with 3e-6.

Rows are put in an order in which neighbours are near each other (Cuthill and McKee 1969), and the matrix is kept as its
diagonal blocks and those beside them: time and memory grow linearly with a chain, and a tangle is one dense block. One
dense matrix for all would cost a chain of 50 links 174 µs a factor where LAPACK has a core to itself, and 70 ms where
its threads wait for each other.
"""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import solve_triangular

from jaxrb.math.arrays import Array

_ROUNDS = 3
_LEAST_WIDTH = 12  # of a block: below it the turns of the loop cost more than what is in them
# Rows up to which one block is cheapest. Of more than 32 BLAS shares the work among threads, which then wait for each
# other on a busy machine: a step of the doll (38 rows) takes 1.8 CPU ms as one block, 0.5 as blocks of 17.
_DENSE = 30


def ordered(one: np.ndarray, other: np.ndarray, count: int) -> tuple[np.ndarray, int]:
    """Place (count,) of each row in the order of Cuthill and McKee, and the width of the blocks.

    `one`, `other`: the pairs of rows that have an entry.
    """
    neighbours: list[set[int]] = [set() for _ in range(count)]
    for i, j in zip(one.tolist(), other.tolist()):
        neighbours[i].add(j)
    degree = [len(found) for found in neighbours]
    place = np.full(count, -1, np.int32)
    done = 0
    for start in sorted(range(count), key=degree.__getitem__):
        if place[start] >= 0:
            continue
        queue = [start]
        place[start] = done
        done += 1
        for row in queue:
            for near in sorted(neighbours[row], key=degree.__getitem__):
                if place[near] < 0:
                    place[near] = done
                    done += 1
                    queue.append(near)
    band = int(np.abs(place[one] - place[other]).max(initial=0))
    width = max(band, _LEAST_WIDTH)
    return place, count if count <= max(_DENSE, 2 * width) else width


class Banded(eqx.Module):
    """A symmetric matrix in blocks (m, w, w): on the diagonal, and `beside` each the one to its left (the first: 0)."""

    diagonal: Array
    beside: Array
    _scale: Array
    _inverse: Array
    _tied: Array

    def __init__(self, diagonal: Array, beside: Array):
        self.diagonal, self.beside = diagonal, beside
        self._factorise(lax.stop_gradient(diagonal), lax.stop_gradient(beside))

    @classmethod
    def of_entries(
        cls, one: np.ndarray, other: np.ndarray, entries: Array, place: np.ndarray, width: int
    ) -> "Banded":
        """From entries (k,) at rows `one` and columns `other`, both triangles; those named twice are added."""
        i, j = place[one], place[other]
        blocks = -(-len(place) // width)
        zeros = jnp.zeros((blocks, width, width), entries.dtype)

        def put(keep: np.ndarray) -> Array:
            chosen = np.nonzero(keep)[0].astype(np.int32)
            where = (i[chosen] // width, i[chosen] % width, j[chosen] % width)
            return zeros.at[where].add(entries[chosen])

        return cls(put(i // width == j // width), put(i // width == j // width + 1))

    def times(self, x: Array) -> Array:
        """A x for x (m, w)."""
        return _times(self.diagonal, self.beside, x)

    def solve(self, right: Array) -> Array:
        """x (m, w), with the derivative that A x = b gives it, forward and reverse."""
        diagonal, beside = lax.stop_gradient((self.diagonal, self.beside))

        def found(_: Any, b: Array) -> Array:
            def refined(x: Array, _: None) -> tuple[Array, None]:
                return x + self._once(b - _times(diagonal, beside, x)), None

            return lax.scan(refined, self._once(b), length=_ROUNDS - 1)[0]

        return lax.custom_linear_solve(self.times, right, found, symmetric=True)

    def _factorise(self, diagonal: Array, beside: Array) -> None:
        width, dtype = diagonal.shape[-1], diagonal.dtype
        entries = jnp.diagonal(diagonal, axis1=-2, axis2=-1)
        # Rows that fill up the last block, and those of bodies that cannot move, are zero: so is their force.
        empty = entries <= 0
        scale = jnp.where(empty, 0.0, 1.0 / jnp.sqrt(jnp.where(empty, 1.0, entries)))
        before = jnp.concatenate([jnp.zeros_like(scale[:1]), scale[:-1]])
        eps = float(jnp.finfo(dtype).eps)
        # A factor of n rows exists for sure above about n eps (Higham 2002, theorem 10.7).
        shift = max(math.sqrt(eps) / 16.0, 4.0 * entries.size * eps)
        own = scale[..., None] * diagonal * scale[:, None, :]
        own = own + (shift + empty.astype(dtype))[..., None] * jnp.eye(width, dtype=dtype)
        left = scale[..., None] * beside * before[:, None, :]
        unit = jnp.eye(width, dtype=dtype)
        self._scale = scale
        if own.shape[0] == 1:
            self._inverse, self._tied = _inverse_of_factor(own[0], unit)[None], left
            return

        def one(inverse: Array, blocks: tuple[Array, Array]) -> tuple[Array, tuple[Array, Array]]:
            own, left = blocks
            tied = left @ inverse.T
            inverse = _inverse_of_factor(own - tied @ tied.T, unit)
            return inverse, (inverse, tied)

        _, (self._inverse, self._tied) = lax.scan(one, jnp.zeros_like(unit), (own, left))

    def _once(self, right: Array) -> Array:
        """(A + ε D)⁻¹ times a right-hand side."""
        if right.shape[0] == 1:
            inverse = self._inverse[0]
            return self._scale * (inverse.T @ (inverse @ (self._scale * right)[0]))[None]
        none = jnp.zeros_like(right[0])

        def down(y: Array, part: tuple[Array, ...]) -> tuple[Array, Array]:
            inverse, tied, b = part
            y = inverse @ (b - tied @ y)
            return y, y

        def up(x: Array, part: tuple[Array, ...]) -> tuple[Array, Array]:
            inverse, tied_of_next, y = part
            x = inverse.T @ (y - tied_of_next.T @ x)
            return x, x

        _, y = lax.scan(down, none, (self._inverse, self._tied, self._scale * right))
        of_next = jnp.concatenate([self._tied[1:], jnp.zeros_like(self._tied[:1])])
        _, x = lax.scan(up, none, (self._inverse, of_next, y), reverse=True)
        return self._scale * x


def _inverse_of_factor(matrix: Array, unit: Array) -> Array:
    lower = jnp.linalg.cholesky(matrix, symmetrize_input=False)
    return solve_triangular(lower, unit, lower=True)


def _times(diagonal: Array, beside: Array, x: Array) -> Array:
    product = _apply(diagonal, x)
    if x.shape[0] == 1:
        return product
    none = jnp.zeros_like(x[:1])
    before = jnp.concatenate([none, x[:-1]])
    above = _apply(jnp.swapaxes(beside, -1, -2), x)
    return product + _apply(beside, before) + jnp.concatenate([above[1:], none])


def _apply(blocks: Array, x: Array) -> Array:
    return jnp.einsum("mij,mj->mi", blocks, x)


def blocked(values: Array, place: np.ndarray, width: int) -> Array:
    """Values (rows,) in the order of the blocks (m, w), zeros at the end."""
    blocks = -(-len(place) // width)
    source = np.full(blocks * width, len(place), np.int32)
    source[place] = np.arange(len(place), dtype=np.int32)
    padded = jnp.concatenate([values, jnp.zeros((1,), values.dtype)])
    return padded[source].reshape(blocks, width)


def unblocked(values: Array, place: np.ndarray) -> Array:
    """The inverse of `blocked`."""
    return values.reshape(-1)[place]
