"""The derivative of torque-free rotation in closed form: no algorithmic differentiation of elliptic functions.

Notation and units as in `free_flight_motion`. The variation δθ of the attitude (in the body frame then) and δL of the
momentum obey two conservation laws. That of the momentum in the world, P(δθ × L) + P δL = δL₀, gives δθ across L; that
of the energy gives it along L, because d/dt (δθ · L) = δω · L = δT + ½ L·δJ L:

    δθ · L = t δT + ½ ∫ L·δJ L ds.

So besides δL, which is the variation of an algebraic formula in the functions of time, only ∫ L_i L_j ds is needed. All
of it is a polynomial in L and g times S, C_i and two integrals over time, ∫ S² ds and ∫ (S/C_a)² ds: nothing is divided
by a difference of moments, by the modulus or by an amplitude. The products of inertia are varied too, so that a full
tensor needs no derivative of its principal axes: the formula for L(t) is a function of the matrix J, and its divided
differences (C_i − C_j)/(e_i − e_j) are −S²/(C_i + C_j).

Off-diagonal entries, and every quantity of a pair of axes (i, j), are listed by the third axis k.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxrb.integrators.free_flight_attitude import Lanes
from jaxrb.integrators.free_flight_motion import Clock, Motion, Triple, divided, triple
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.quaternion import Quaternion, product
from jaxrb.math.vector import cross, dot


class Variation(NamedTuple):
    """What is varied: J (`diagonal` and `others`), momentum and ω at the start, and with them the energy T.

    `inverse` is J itself and h_k = L² J_k − 2T, so that e_j − e_i = −g_k h_k; `dg` the variation of g.
    """

    diagonal: Triple
    others: Triple
    momentum: Triple
    omega: Triple
    energy: Scalar
    inverse: Triple
    h: Triple
    dg: Triple


class Integrals(NamedTuple):
    """∫ S² ds and ∫ (S/C_a)² ds over the time left, and ∫ sin²/Δ³ dφ over a quarter period."""

    plain: Scalar
    over_a: Scalar
    quarter: Scalar


class ClockVariation(NamedTuple):
    """Variations of S and the C_i at fixed time left, and of the half period."""

    sine: Scalar
    cosines: Triple
    half_period: Scalar


def integral_lanes(clock: Clock) -> Lanes:
    """Arguments of Carlson's R_D for `Integrals`."""
    one, c2, d2, m1 = jnp.ones_like(clock.m), clock.cn * clock.cn, clock.dn * clock.dn, clock.complement
    last = stack(one, d2, m1)
    return Lanes(stack(c2, c2, jnp.zeros_like(one)), stack(d2, one, one), last, last)


def tangent_of(
    motion: Motion,
    wxyz: jax.Array,
    third: jax.Array,
    omega: Triple,
    moments: Triple,
    products: Triple,
    time: Scalar,
) -> tuple[jax.Array, Vector]:
    """Variations of the rotation wxyz (4,) and of ω then (3,), from those of ω, moments, products of inertia and time.

    All seen from the motion's own frame.

    `third` is R_D (3,) of the lanes above.
    """
    cube = motion.clock.sine**3 / 3.0
    integrals = Integrals(cube * third[0], cube * third[1], third[2] / 3.0)
    v = _variation(motion, omega, moments, products)
    clock = _clock_variation(motion, v, integrals)
    rate = cross(stack(*motion.momentum_then), stack(*motion.omega_then))
    dmomentum = stack(*_flipped(motion, v, clock, _momentum_variation(motion, v, clock), components(rate)))
    domega = stack(*v.inverse) * dmomentum + _varied_j(v, motion.momentum_then)
    along = motion.time * v.energy + _action(motion, v, integrals)
    turn = _turn(motion, v, Quaternion(wxyz), dmomentum, domega, along) + stack(*motion.omega_then) * time
    change = product(wxyz, stack(jnp.zeros_like(time), *(0.5 * c for c in components(turn))))
    return change, domega + stack(*v.inverse) * rate * time


def _variation(motion: Motion, omega: Triple, moments: Triple, products: Triple) -> Variation:
    inverse, w, L = triple(lambda i, j, k: 1.0 / motion.moments[i]), motion.omega, motion.momentum
    turned = triple(lambda i, j, k: moments[i] * w[i] + products[k] * w[j] + products[j] * w[k])
    momentum = triple(lambda i, j, k: motion.moments[i] * omega[i] + turned[i])
    energy = triple(lambda i, j, k: w[i] * (momentum[i] - 0.5 * turned[i]))
    diagonal = triple(lambda i, j, k: -moments[i] * inverse[i] ** 2)
    return Variation(
        diagonal,
        triple(lambda k, i, j: -products[k] * inverse[i] * inverse[j]),
        momentum,
        omega,
        energy[0] + energy[1] + energy[2],
        inverse,
        # As the difference L² J_k − 2T it would cancel.
        triple(lambda k, i, j: motion.g[i] * L[j] ** 2 - motion.g[j] * L[i] ** 2),
        triple(lambda i, j, k: diagonal[k] - diagonal[j]),
    )


def _varied_j(v: Variation, x: Triple) -> Vector:
    """δJ x (3,)."""
    return stack(*triple(lambda i, j, k: v.diagonal[i] * x[i] + v.others[k] * x[j] + v.others[j] * x[k]))


def _clock_variation(motion: Motion, v: Variation, integrals: Integrals) -> ClockVariation:
    """From the variations of e_c − e_b and e_a − e_b; δam = −½ Δ δm ∫ sin²/Δ³ dφ at fixed u."""
    g, L, dL, dg, h, clock = motion.g, motion.momentum, v.momentum, v.dg, v.h, motion.clock
    pairs = triple(lambda k, i, j: v.others[k] * L[i] * L[j])
    mixed = 2.0 * (pairs[0] + pairs[1] + pairs[2])
    dh = triple(
        lambda k, i, j: (
            2.0 * (g[i] * L[j] * dL[j] - g[j] * L[i] * dL[i]) + dg[i] * L[j] ** 2 - dg[j] * L[i] ** 2 - mixed
        )
    )
    change = triple(lambda k, i, j: -(dg[k] * h[k] + g[k] * dh[k]))
    span, spread = change[0], -change[2]
    # e_c − e_a and its variation are small near the separatrix, and would be lost in the difference of the two others.
    narrow = clock.complement * span + change[1]
    s, c, d, time = clock.sine, clock.cn, clock.dn, clock.remainder
    along = 0.5 * (time * span - clock.span * narrow * integrals.over_a)  # λ δam / Δ
    # Below an eighth of a turn by the integral ∫ (S/C_c)² ds; beyond, where that one diverges, by the change of scale.
    early = c * c > 0.5
    over_c = (s * s * time - integrals.plain - d * d * integrals.over_a) / jnp.where(early, c * c, 1.0)
    scaled = divided(c * d * along - 0.5 * s * span, jnp.where(early, 1.0, clock.span))
    ds = jnp.where(early, -0.5 * c * d * (over_c * span + integrals.over_a * spread), scaled)
    dc = -s * d * along
    dd = -0.5 * s * s * narrow / d - clock.m * s * c * along
    period = integrals.quarter * narrow - clock.chain.quarter * span
    return ClockVariation(
        ds,
        (dd, jnp.zeros_like(dd), dc),
        divided(period, clock.rate * clock.span),
    )


def _momentum_variation(motion: Motion, v: Variation, varied: ClockVariation) -> Triple:
    """δL of the addition theorem at fixed time left, before the flip."""
    g, w, L, dL, clock = motion.g, motion.omega, motion.momentum, v.momentum, motion.clock
    s, c, ds, dc = clock.sine, clock.cosines, varied.sine, varied.cosines
    tilted = components(_varied_j(v, L))
    dw = triple(lambda i, j, k: v.inverse[i] * dL[i] + tilted[i])
    rate = triple(lambda i, j, k: g[i] * L[j] * L[k])  # L × JL
    drate = triple(lambda i, j, k: (dL[j] * w[k] - dL[k] * w[j]) + (L[j] * dw[k] - L[k] * dw[j]))
    # Off-diagonal entries of the matrices C and cof C.
    mixed_c = triple(lambda k, i, j: divided(s * s * v.h[k] * v.others[k], c[i] + c[j]))
    mixed_x = triple(lambda k, i, j: -c[k] * mixed_c[k])
    numerator = triple(
        lambda i, j, k: (
            c[j] * c[k] * dL[i]
            + (c[j] * dc[k] + c[k] * dc[j]) * L[i]
            + (mixed_x[k] * L[j] + mixed_x[j] * L[k])
            + s * (dc[i] * rate[i] + mixed_c[k] * rate[j] + mixed_c[j] * rate[k] + c[i] * drate[i])
            + ds * c[i] * rate[i]
        )
    )
    # D = C_a² − y_a² S² with y_a² = g_b g_c L_a².
    square = g[1] * g[2] * L[0] ** 2
    dsquare = (v.dg[1] * g[2] + g[1] * v.dg[2]) * L[0] ** 2 + 2.0 * L[0] * (
        g[1] * g[2] * dL[0] + g[2] * L[2] * v.others[1] - g[1] * L[1] * v.others[2]
    )
    change = 2.0 * (clock.dn * dc[0] - square * s * ds) - dsquare * s * s
    inverse = 1.0 / motion.denominator
    return triple(lambda i, j, k: (numerator[i] - motion.base[i] * change) * inverse)


def _flipped(
    motion: Motion, v: Variation, varied: ClockVariation, dbase: Triple, rate: list[Scalar]
) -> Triple:
    """δL after the half periods: the sign flip, the tilt of its axis, and the change of the time left."""
    clock, base, flip = motion.clock, motion.base, motion.clock.flip
    late = -clock.halves * jnp.where(clock.halves == 0, 0.0, varied.half_period)
    # The flip is 2 c cᵀ − 1, and δc along another axis x is δJ_xc/(J_c − J_x).
    tilt_b, tilt_a = (
        jnp.where(clock.odd < 0, 2.0 * divided(other, gap), 0.0)
        for other, gap in ((v.others[0], motion.g[0]), (v.others[1], -motion.g[1]))
    )
    tilted = (tilt_a * base[2], tilt_b * base[2], tilt_a * base[0] + tilt_b * base[1])
    return triple(lambda i, j, k: flip[i] * dbase[i] + tilted[i] + rate[i] * late)


def _action(motion: Motion, v: Variation, integrals: Integrals) -> Scalar:
    """½ ∫ L·δJ L ds over the whole time, from the six ∫ L_i L_j ds."""
    L, g, clock = motion.momentum, motion.g, motion.clock
    c, s, flip = clock.cosines, clock.sine, clock.flip
    # ∫ L_b² ds by the addition theorem of the integral of the second kind; the two other squares by the invariants.
    half = divided(
        2.0 * (clock.chain.quarter - clock.complement * integrals.quarter), clock.span * clock.rate
    )
    passed = integrals.plain + clock.halves * jnp.where(clock.halves == 0, 0.0, half)
    middle = jnp.abs(v.h[0] * v.h[2]) * passed + s * L[1] * motion.base[1]
    excess = divided(middle - L[1] ** 2 * motion.time, g[1])
    squares = triple(lambda i, j, k: L[i] ** 2 * motion.time + g[i] * excess)

    def mixed(k: int, i: int, j: int) -> Scalar:
        # (L_k(t) − L_k)/g_k, divided out.
        ratio = divided(c[i] * g[i] * L[j] ** 2 + c[j] * g[j] * L[i] ** 2, c[i] + c[j])
        left = (L[i] * L[j] * s * c[k] + L[k] * s * s * ratio) / motion.denominator
        return flip[k] * left + (flip[k] - 1.0) * divided(L[k], g[k])

    terms = triple(lambda k, i, j: 0.5 * v.diagonal[k] * squares[k] + v.others[k] * mixed(k, i, j))
    return terms[0] + terms[1] + terms[2]


def _turn(
    motion: Motion, v: Variation, turned: Quaternion, dmomentum: Vector, domega: Vector, along: Scalar
) -> Vector:
    """δθ (3,) at fixed time, from the two conservation laws.

    Over a short time these give it as a difference, and at rest as 0/0. There it is ∫ Pδω ds by the trapezium with
    corrected ends, whose error is (ωt)⁴/720 of it.
    """
    size = motion.time * motion.time * dot(stack(*motion.omega), stack(*motion.omega))
    short = size < jnp.finfo(size.dtype).eps ** 0.4
    start, then = stack(*motion.momentum), stack(*motion.momentum_then)
    inverse = 1.0 / jnp.where(short, 1.0, dot(then, then))
    across = cross(then, turned.unrotate(stack(*v.momentum)) - dmomentum)
    long = stack(
        *(inverse * (along * x + y) for x, y in zip(components(then), components(across), strict=True))
    )

    def slope(momentum: Vector, omega: Vector, dmomentum: Vector, domega: Vector) -> Vector:
        """d(Pδω)/dt seen from the body: ω × δω + δω̇."""
        torque = cross(dmomentum, omega) + cross(momentum, domega)
        tilted = _varied_j(v, _triple(cross(momentum, omega)))
        return cross(omega, domega) + stack(*v.inverse) * torque + tilted

    first = slope(start, stack(*motion.omega), stack(*v.momentum), stack(*v.omega))
    last = slope(then, stack(*motion.omega_then), dmomentum, domega)
    t = motion.time
    brief = 0.5 * t * (turned.unrotate(stack(*v.omega)) + domega) + t * t / 12.0 * (
        turned.unrotate(first) - last
    )
    return jnp.where(short, brief, long)


def _triple(array: Vector) -> Triple:
    x, y, z = components(array)
    return x, y, z
