"""Interpolation between rotations."""

from typing import TypeVar

import jax.numpy as jnp

from jaxrb.math.arrays import Scalar
from jaxrb.math.rotation import Rotation

R = TypeVar("R", bound=Rotation)


def slerp(start: R, end: R, fraction: Scalar) -> R:
    """The rotation at `fraction` of the way from `start` to `end`, at constant angular velocity, the short way round.

    Written as start · exp(f · log(start⁻¹ end)), which is smooth for equal ends too (Shoemake 1985). For ends half a
    turn apart two ways are equally short, and one is taken.
    """
    step = (start.inverse() @ end).log() * jnp.asarray(fraction)[..., None]
    return start @ type(start).exp(step)
