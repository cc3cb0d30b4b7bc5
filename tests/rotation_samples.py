"""Rotations to test with: generic ones, and those where a textbook formula divides zero by zero or changes sign."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb import EulerAngles, Quaternion, Rotation, RotationMatrix
from jaxrb.math.euler_angles import SEQUENCES

# Parameters of the tests: a class, or EulerAngles with one of its twelve sequences.
REPRESENTATIONS = {"Quaternion": (Quaternion, ""), "RotationMatrix": (RotationMatrix, "")} | {
    f"EulerAngles-{sequence}": (EulerAngles, sequence) for sequence in SEQUENCES
}
# For programs that run once: their compile time is what the tests cost.
QUICK = {"xla_backend_optimization_level": 0}
GROUPS = (Quaternion, RotationMatrix)  # the two whose product is a product of their numbers


def unit_vectors(count: int, seed: int = 0) -> np.ndarray:
    """Uniform directions (count, 3) in float64."""
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def rotation_vectors(dtype, seed: int = 0) -> np.ndarray:
    """Rotation vectors (k, 3): zero, tiny, about the switches of the series, generic, at and about half a turn."""
    axes = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 0], [0, 1, -1], [1, 1, 1]], unit_vectors(3, seed)])
    axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    angles = [
        1e-12,
        1e-9,
        1e-4,
        0.2,
        0.5,
        1.0,
        np.pi / 2,
        2 * np.pi / 3,
        np.pi - 1e-9,
        np.pi,
        np.pi - 1e-4,
        3.0,
    ]
    special = (np.asarray(angles)[:, None, None] * axes).reshape(-1, 3)
    generic = unit_vectors(60, seed + 1) * np.random.default_rng(seed).uniform(0, np.pi, (60, 1))
    return np.concatenate([np.zeros((1, 3)), special, generic]).astype(np.dtype(dtype))


def of_vectors(kind: type[Rotation], sequence: str, vectors) -> Rotation:
    """The rotations with these vectors in a representation."""
    if kind is EulerAngles:
        return EulerAngles.from_rotation(Quaternion.exp(vectors), sequence)
    return kind.exp(vectors)


def identity(kind: type[Rotation], sequence: str, dtype) -> Rotation:
    """The identity in a representation."""
    if kind is EulerAngles:
        return EulerAngles(jnp.zeros(3, dtype), sequence)
    return kind.identity(dtype)


def numbers(rotation: Rotation) -> jax.Array:
    """The single array that a rotation consists of."""
    (leaf,) = jax.tree.leaves(rotation)
    return leaf


def largest(difference) -> float:
    """Largest magnitude, as a float64 number; NaN stays NaN."""
    return float(np.abs(np.asarray(difference, np.float64)).max())
