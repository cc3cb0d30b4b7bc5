"""The law of contact at one point: no pull, no overlap, friction within Coulomb's disc.

Written as a projection: with the relative velocity v, the impulse λ, the speed b that the normal must at least reach
and any compliance R > 0, the hard law is λ = P(λ − (v − b n)/R), where P cuts the normal part at zero and the
tangential part to the length μ λₙ.
(Alart and Curnier 1991, "A mixed formulation for frictional contact problems prone to Newton like solution methods".)
"""

import jax.numpy as jnp

from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.safe import divide, safe_sqrt
from jaxrb.math.vector import dot


def predicted(impulse: Vector, velocity: Vector, bias: Scalar, normal: Vector, stiffness: Scalar) -> Vector:
    """λ − (v − b n)/R (..., 3), with `stiffness` = 1/R [kg], zero where there is no contact."""
    return stack(
        *(
            old - stiffness * (v - bias * n)
            for old, v, n in zip(components(impulse), components(velocity), components(normal), strict=True)
        )
    )


def projected(wanted: Vector, normal: Vector, bound: Scalar | None) -> Vector:
    """The allowed impulse nearest to `wanted` (..., 3), its tangential part at most `bound` long (None: none)."""
    along = dot(wanted, normal)
    pressing = jnp.maximum(along, 0.0)
    if bound is None:
        return stack(*(pressing * n for n in components(normal)))
    scale, tangential = _cut(wanted, along, normal, bound)
    return stack(*(pressing * n + scale * t for n, t in zip(components(normal), tangential, strict=True)))


def curvature(wanted: Vector, normal: Vector, bound: Scalar | None, stiffness: Scalar) -> Array:
    """−∂λ/∂v of `projected(predicted(...))` at a fixed bound: a symmetric matrix as six numbers (..., 6)."""
    along = dot(wanted, normal)
    pressing = jnp.where(along > 0, stiffness, 0.0)
    n = components(normal)
    if bound is None:
        return stack(*(pressing * n[i] * n[j] for i, j in _SIX))
    scale, tangential = _cut(wanted, along, normal, bound)
    sticking = scale >= 1.0
    side = stiffness * scale
    length = safe_sqrt(sum(t * t for t in tangential))
    sliding = jnp.where(sticking, 0.0, side)
    t = [divide(part, length) for part in tangential]
    return stack(
        *(
            (pressing - side) * n[i] * n[j] - sliding * t[i] * t[j] + (side if i == j else 0.0)
            for i, j in _SIX
        )
    )


_SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _cut(wanted: Vector, along: Scalar, normal: Vector, bound: Scalar) -> tuple[Scalar, list[Scalar]]:
    """The factor that brings the tangential part within the disc, and that part."""
    tangential = [w - along * n for w, n in zip(components(wanted), components(normal), strict=True)]
    length = safe_sqrt(sum(t * t for t in tangential))
    outside = length > bound
    return jnp.where(outside, divide(bound, jnp.where(outside, length, 1.0)), 1.0), tangential
