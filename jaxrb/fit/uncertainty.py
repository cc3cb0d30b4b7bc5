"""What the data say and do not say: information, error bars, and directions without information. Host side.

Two kinds of error bar. The model-based one believes that residuals are independent noise; on repeated real
tosses it came out four to five times too small. The robust one is the jackknife over tosses: whatever goes
wrong within a toss, tosses are independent of one another. It is the one that is quoted.
"""

from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

from jaxrb.fit.parametrise import moved_ratios, ratios_from_coordinates
from jaxrb.fit.problem import Normal

if TYPE_CHECKING:
    from jaxrb.fit.problem import Solution
    from jaxrb.fit.stages import Problem

NAMES = ("xx", "yy", "zz", "xy", "xz", "yz")
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# An orthonormal basis of the symmetric matrices without trace (Frobenius), as rows of xx, yy, zz, xy, xz, yz:
# the five directions in which inertia ratios can differ.
_BASIS = np.array(
    [
        [1 / np.sqrt(2), -1 / np.sqrt(2), 0, 0, 0, 0],
        [1 / np.sqrt(6), 1 / np.sqrt(6), -2 / np.sqrt(6), 0, 0, 0],
        [0, 0, 0, 1 / np.sqrt(2), 0, 0],
        [0, 0, 0, 0, 1 / np.sqrt(2), 0],
        [0, 0, 0, 0, 0, 1 / np.sqrt(2)],
    ]
)
_WEIGHTS = np.array([1, 1, 1, 2, 2, 2])  # of the six numbers in the Frobenius product
# Ratios lie between 0 and ½. A direction whose standard deviation is beyond this is as good as unknown.
UNKNOWN = 0.1
# Below this, information relative to the best direction is round-off of float64 normal equations.
_ROUND_OFF = 1e-10


class Information(NamedTuple):
    """Fisher information (P, P) of the shared parameters, and each flight's part (S, P, P) and score."""

    total: np.ndarray
    parts: np.ndarray
    scores: np.ndarray


class Directions(NamedTuple):
    """Five uncorrelated directions of the ratios: rows of xx, yy, zz, xy, xz, yz (Frobenius length one).

    `deviation` (5,) is the model-based standard deviation along each (inf where the data say nothing), in
    descending order, and `move` (5, P) the change of the coordinates that goes a unit along it.
    """

    rows: np.ndarray
    deviation: np.ndarray
    move: np.ndarray


def information(normal: Normal, weight: np.ndarray) -> Information:
    """Information on the shared parameters after the flights' own unknowns are eliminated."""
    shared, g_shared = np.asarray(normal.shared, float), np.asarray(normal.shared_gradient, float)
    # Whole flights: each a chain of one window.
    border, local, g_local = (
        np.asarray(p, float)[:, 0] for p in (normal.border, normal.local, normal.local_gradient)
    )
    use = weight > 0
    local = np.where(use[:, None, None], local, np.eye(local.shape[-1]))
    solved = np.linalg.pinv(local, rcond=1e-14, hermitian=True) @ np.swapaxes(border, 1, 2)
    parts = weight[:, None, None] * (shared - border @ solved)
    parts = 0.5 * (parts + np.swapaxes(parts, 1, 2))
    scores = weight[:, None] * (g_shared - np.einsum("sqp,sq->sp", solved, g_local))
    return Information(parts.sum(axis=0), parts, scores)


def fitted_information(problem: "Problem", solution: "Solution", weight: np.ndarray) -> Information:
    """Information on the shared parameters that were fitted; those held come out as perfectly known."""
    info = information(solution.normal, weight)
    free = np.asarray(problem.free)
    mask = free[:, None] * free
    prior = np.zeros_like(info.total) if problem.prior is None else np.asarray(problem.prior.precision)
    return Information(info.total * mask + prior * mask, info.parts * mask, info.scores * free)


def model_covariance(info: Information) -> np.ndarray:
    """Inverse information (P, P): right if residuals are independent with the stated scales."""
    return np.linalg.pinv(info.total, rcond=1e-15, hermitian=True)


def jackknife_covariance(info: Information, toss: np.ndarray, used: np.ndarray) -> np.ndarray | None:
    """Covariance (P, P) from leaving out one toss at a time, to first order; None for fewer than two tosses.

    θ₋ₜ − θ = (H − Hₜ)⁻¹ gₜ needs no new fit. Bell and McCaffrey 2002 call it CR3: of the sandwiches it errs
    on the side of caution when tosses are few.
    """
    groups = np.unique(toss[used])
    if len(groups) < 2:
        return None
    moves = []
    for group in groups:
        mine = used & (toss == group)
        rest = info.total - info.parts[mine].sum(axis=0)
        moves.append(np.linalg.pinv(rest, rcond=1e-15, hermitian=True) @ info.scores[mine].sum(axis=0))
    moves = np.array(moves)
    count = len(groups)
    return (count - 1) / count * moves.T @ moves


def ratio_jacobian(coordinates: np.ndarray) -> np.ndarray:
    """Derivative (6, 5) of the ratios xx, yy, zz, xy, xz, yz with respect to a step from the coordinates."""
    here = np.asarray(coordinates[:5], float)
    jacobian = np.asarray(
        jax.jacfwd(lambda step: ratios_from_coordinates(moved_ratios(here, step)))(np.zeros(5))
    )
    return np.stack([jacobian[i, j] for i, j in PLACES])


def directions(info: Information, coordinates: np.ndarray) -> Directions:
    """The directions of the ratios in order of ignorance."""
    jacobian = ratio_jacobian(coordinates)
    if not (np.all(np.isfinite(jacobian)) and np.all(np.isfinite(info.total))):
        # Noise alone can send the coordinates out of the floating range: nothing is known there.
        return Directions(_BASIS, np.full(5, np.inf), np.zeros((5, 5)))
    to_basis = (_BASIS * _WEIGHTS) @ jacobian  # (5, 5)
    inverse = np.linalg.pinv(to_basis, rcond=1e-13)
    total = info.total
    if len(total) > 5:  # other shared parameters are eliminated first; of some a recording may tell nothing
        rest = total[5:, 5:]
        total = total[:5, :5] - total[:5, 5:] @ np.linalg.pinv(rest, hermitian=True) @ total[5:, :5]
    values, vectors = np.linalg.eigh(inverse.T @ total @ inverse)
    known = values > _ROUND_OFF * max(values[-1], 0.0)
    deviation = np.where(known, 1.0 / np.sqrt(np.where(known, values, 1.0)), np.inf)
    return Directions(vectors.T @ _BASIS, deviation, (inverse @ vectors).T)


def principal(ratios: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Principal ratios (3,), ascending, their standard errors (3,), and their axes as columns (3, 3)."""
    values, axes = np.linalg.eigh(ratios)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    # dλ = n·dI·n, with each off-diagonal number counted on both sides.
    rows = np.stack([np.array([axes[i, k] * axes[j, k] for i, j in PLACES]) * _WEIGHTS for k in range(3)])
    return values, np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", rows, covariance, rows), 0.0)), axes


def in_words(rows: np.ndarray) -> list[str]:
    """A space of directions, spanned by orthonormal rows (n, 6), in as plain words as it allows."""
    root = np.sqrt(_WEIGHTS)  # so that the Frobenius product is the plain one
    left = rows * root
    words = []
    for name, row in _PLAIN.items():
        unit = row * root / np.linalg.norm(row * root)
        inside = left @ unit
        if inside @ inside < 0.98 or not len(left):
            continue
        words.append(name)
        # What is left of the space after this direction is taken out of it.
        rest = left - np.outer(inside, unit)
        _, size, axes = np.linalg.svd(rest, full_matrices=False)
        left = axes[size > 0.5]
    return words + [_sum_of(row / root) for row in left]


_PLAIN = {
    "I_xx against I_yy": np.array([1, -1, 0, 0, 0, 0]),
    "I_xx against I_zz": np.array([1, 0, -1, 0, 0, 0]),
    "I_yy against I_zz": np.array([0, 1, -1, 0, 0, 0]),
    "I_zz against I_xx and I_yy": np.array([-1, -1, 2, 0, 0, 0]),
    "I_yy against I_xx and I_zz": np.array([-1, 2, -1, 0, 0, 0]),
    "I_xx against I_yy and I_zz": np.array([2, -1, -1, 0, 0, 0]),
    "I_xy": np.array([0, 0, 0, 1, 0, 0]),
    "I_xz": np.array([0, 0, 0, 0, 1, 0]),
    "I_yz": np.array([0, 0, 0, 0, 0, 1]),
}


def _sum_of(row: np.ndarray) -> str:
    row = row / row[np.argmax(np.abs(row))]
    terms = [(value, name) for value, name in zip(row, NAMES) if abs(value) > 0.1]
    text = " ".join(f"{'+' if value > 0 else '−'} {abs(value):.2g} I_{name}" for value, name in terms)
    return f"({text.removeprefix('+ ')})"
