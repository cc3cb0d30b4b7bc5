"""The law of contact at one point: no pull, no overlap, friction within Coulomb's disc.

Written as a projection: with the relative velocity v, the impulse λ, the speed b that the normal must at least reach
and any compliance R > 0, the hard law is λ = P(λ − (v − b n)/R), where P cuts the normal part at zero and the
tangential part to the length μ λₙ. Of a pair's couple (`contact/resistance.py`) P cuts both parts to their lengths.
(Alart and Curnier 1991, "A mixed formulation for frictional contact problems prone to Newton like solution methods".)
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide, safe_sqrt


class Bounds(NamedTuple):
    """What impulses may be: `across` the length of the tangential part, None: there is none; `least` and `most` of the
    normal part, None: at least zero."""

    across: Scalar | None
    least: Scalar | None = None
    most: Scalar | None = None

    def pressing(self, along: Scalar) -> Scalar:
        """The normal part nearest to `along`."""
        if self.least is None or self.most is None:
            return jnp.maximum(along, 0.0)
        return jnp.clip(along, self.least, self.most)

    def gives(self, along: Scalar) -> Array:
        """Whether the normal part follows a small change of `along`."""
        if self.least is None or self.most is None:
            return along > 0
        return (along > self.least) & (along < self.most)


def predicted(impulse: Vector, velocity: Vector, bias: Scalar, normal: Vector, stiffness: Scalar) -> Vector:
    """λ − (v − b n)/R (..., 3), with `stiffness` = 1/R [kg], zero where there is no contact."""
    return impulse - stiffness[..., None] * (velocity - bias[..., None] * normal)


def projected(wanted: Vector, normal: Vector, bounds: Bounds) -> Vector:
    """The allowed impulse nearest to `wanted` (..., 3)."""
    along = jnp.sum(wanted * normal, axis=-1)
    pressing = bounds.pressing(along)
    if bounds.across is None:
        return pressing[..., None] * normal
    scale, tangential = _cut(wanted, along, normal, bounds.across)
    return pressing[..., None] * normal + scale[..., None] * tangential


def curvature(wanted: Vector, normal: Vector, bounds: Bounds, stiffness: Scalar) -> Array:
    """−∂λ/∂v (..., 3, 3) of `projected(predicted(...))` at fixed bounds."""
    along = jnp.sum(wanted * normal, axis=-1)
    pressing = jnp.where(bounds.gives(along), stiffness, 0.0)
    if bounds.across is None:
        return _outer(pressing, normal)
    scale, tangential = _cut(wanted, along, normal, bounds.across)
    side = stiffness * scale
    length = safe_sqrt(jnp.sum(tangential * tangential, axis=-1))
    sliding = jnp.where(scale >= 1.0, 0.0, side)
    sideways = side[..., None, None] * jnp.eye(3, dtype=wanted.dtype)
    across = divide(tangential, length[..., None])
    return sideways + _outer(pressing - side, normal) - _outer(sliding, across)


def _outer(scale: Scalar, v: Vector) -> Array:
    return (scale[..., None] * v)[..., :, None] * v[..., None, :]


def _cut(wanted: Vector, along: Scalar, normal: Vector, bound: Scalar) -> tuple[Scalar, Vector]:
    """The factor that brings the tangential part within the disc, and that part."""
    tangential = wanted - along[..., None] * normal
    length = safe_sqrt(jnp.sum(tangential * tangential, axis=-1))
    return within(length, bound), tangential


def within(length: Scalar, bound: Scalar) -> Scalar:
    """The factor that brings a length to its bound where it is beyond it.

    A disc of no radius holds nothing, not even its middle: else what does not slide yet would stick where nothing
    presses.
    """
    outside = (length > bound) | (bound <= 0)
    return jnp.where(outside, divide(bound, jnp.where(outside, length, 1.0)), 1.0)
