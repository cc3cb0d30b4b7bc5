"""Free rotation split into exact rotations about body axes."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxrb.body.inertia import FullSolver, InertiaSolver, PrincipalSolver, SphericalSolver
from jaxrb.integrators.splitting import STRANG, SUZUKI, Splitting
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.quaternion import Quaternion, product
from jaxrb.math.rational import half_turn_factors, turn


class ThreeAxisSplitting(Splitting):
    """The free rotation as exact rotations about three body axes, symmetrically; forces as half kicks. Order 2.

    Each rotation keeps the length of the momentum, and turns attitude and momentum by the same angle, so the angular
    momentum in the world stays to round-off, and the energy error is bounded for all times.

    The kinetic energy is split as |L|²/2I₂ + (1/I₁ − 1/I₂) L₁²/2 + (1/I₃ − 1/I₂) L₃²/2 with I₂ the middle moment. The
    first part, a rotation about the momentum itself, commutes with the others; what is left is smaller than in the
    splitting of L₁²/2I₁ + L₂²/2I₂ + L₃²/2I₃ (NO_SQUISH), and vanishes in part for symmetric bodies, which are exact.
    (McLachlan 1993, Phys. Rev. Lett. 71, 3043; Reich 1994, Fields Inst. Commun. 10; Miller et al. 2002, J. Chem. Phys.
    116, 8649; Fassò 2003, J. Comput. Phys. 189, 527.)
    """

    order: ClassVar[int] = 2
    weights: ClassVar[tuple[float, ...]] = STRANG
    free_weights: ClassVar[tuple[float, ...]] = STRANG

    def turn(self, inertia: InertiaSolver, omega: Vector, span: Scalar) -> tuple[Quaternion, Vector]:
        if isinstance(inertia, SphericalSolver):
            return Quaternion(turn(span * omega)), omega
        if isinstance(inertia, PrincipalSolver):
            return _principal(inertia, omega, span)
        raise NotImplementedError


class ThreeAxisSplitting4(ThreeAxisSplitting):
    """`ThreeAxisSplitting` composed of five substeps. Order 4."""

    order: ClassVar[int] = 4
    weights: ClassVar[tuple[float, ...]] = SUZUKI
    free_weights: ClassVar[tuple[float, ...]] = SUZUKI


def _principal(inertia: PrincipalSolver, omega: Vector, span: Scalar) -> tuple[Quaternion, Vector]:
    moments, first, second = (components(x) for x in (inertia.inertia.moments, omega, inertia.inverse))
    is_1, is_2 = _middle(second)
    roll = lambda x: _rolled(is_1, is_2, x)  # noqa: E731
    ia, ib, ic = roll(moments)
    ja, jb, jc = roll(second)
    a, b, c = (i * w for i, w in zip((ia, ib, ic), roll(first), strict=True))
    common = turn(span * stack(jc * a, jc * b, jc * c))
    half = 0.5 * span
    c1, s1, b, c = _turned(half * (ja - jc), a, b, c)
    a, b, c = components(stack(a, b, c))
    c2, s2, c, a = _turned(span * (jb - jc), b, c, a)
    a, b, c = components(stack(a, b, c))
    c3, s3, b, c = _turned(half * (ja - jc), a, b, c)
    split = stack(
        c2 * (c1 * c3 - s1 * s3), c2 * (c1 * s3 + s1 * c3), s2 * (c1 * c3 + s1 * s3), s2 * (s1 * c3 - c1 * s3)
    )
    w, x, y, z = components(product(common, split))
    back = lambda v: _rolled(is_2, is_1, v)  # noqa: E731
    return Quaternion(stack(w, *back((x, y, z)))), stack(*back((a / ia, b / ib, c / ic)))


def _middle(x: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    p, q, r = x
    middle = jnp.maximum(jnp.minimum(p, q), jnp.minimum(jnp.maximum(p, q), r))
    return middle == p, (middle == q) & (middle != p)


def _rolled(is_1, is_2, x):
    """x rolled so that the middle is the last."""
    p, q, r = x
    return [
        jnp.where(is_1, one, jnp.where(is_2, two, three))
        for one, two, three in ((q, r, p), (r, p, q), (p, q, r))
    ]


def _turned(rate: Scalar, axis: Scalar, b: Scalar, c: Scalar):
    angle = rate * axis
    cosine, factor = half_turn_factors(angle * angle)
    sine = factor * angle
    versine, full = 2.0 * sine * sine, 2.0 * sine * cosine
    return cosine, sine, b + (full * c - versine * b), c - (full * b + versine * c)
