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
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxrb.integrators.free_flight_attitude import Lanes
from jaxrb.integrators.free_flight_motion import CYCLIC, Axes, Clock, Triple, divided, pick
from jaxrb.math.arrays import Scalar

# Pairs (i, j) of axes by the third one k: products of inertia and off-diagonal variations are listed by it.
ROUND = ((1, 2, 0), (2, 0, 1), (0, 1, 2))


class Body(NamedTuple):
    """Moments and momentum at the start, and what follows from them."""

    moments: Triple
    inverse: Triple
    g: Triple
    h: Triple
    omega: Triple
    momentum: Triple


class Variation(NamedTuple):
    """Variations of J (three diagonal entries, three others by third axis), momentum and ω at the start, energy."""

    diagonal: Triple
    others: Triple
    momentum: Triple
    omega: Triple
    energy: Scalar


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


def triple(function) -> Triple:
    """(f(i, j, k)) for the three cyclic triples of axes, listed by i."""
    return tuple(function(i, j, k) for i, j, k in CYCLIC)  # type: ignore[return-value]


def body_of(moments: Triple, omega: Triple, g: Triple) -> Body:
    """h_k = L² J_k − 2T is a sum over the two other axes; formed as a difference it would cancel."""
    momentum = triple(lambda i, j, k: moments[i] * omega[i])
    h = triple(lambda k, i, j: g[i] * momentum[j] ** 2 - g[j] * momentum[i] ** 2)
    return Body(moments, triple(lambda i, j, k: 1.0 / moments[i]), g, h, omega, momentum)


def variation_of(body: Body, omega: Triple, moments: Triple, products: Triple) -> Variation:
    """From variations of ω, of the moments and of the products of inertia (matrix entries, by third axis)."""
    inverse, w = body.inverse, body.omega
    turned = triple(lambda i, j, k: moments[i] * w[i] + products[k] * w[j] + products[j] * w[k])
    momentum = triple(lambda i, j, k: body.moments[i] * omega[i] + turned[i])
    energy = sum((w[i] * (momentum[i] - 0.5 * turned[i]) for i in range(3)), jnp.zeros_like(w[0]))
    return Variation(
        triple(lambda i, j, k: -moments[i] * inverse[i] ** 2),
        triple(lambda k, i, j: -products[k] * inverse[i] * inverse[j]),
        momentum,
        omega,
        energy,
    )


def integral_lanes(clock: Clock) -> Lanes:
    """Arguments of Carlson's R_D for `integrals`."""
    one, c2, d2 = jnp.ones_like(clock.m), clock.cn * clock.cn, clock.dn * clock.dn
    m1 = clock.complement
    return Lanes([c2, c2, jnp.zeros_like(one)], [d2, one, one], [one, d2, m1], [one, d2, m1])


def integrals_of(clock: Clock, third: list) -> Integrals:
    """From R_D of the lanes above."""
    cube = clock.sine * clock.sine * clock.sine / 3.0
    return Integrals(cube * third[0], cube * third[1], third[2] / 3.0)


def clock_variation(axes: Axes, clock: Clock, body: Body, v: Variation, integrals: Integrals) -> ClockVariation:
    """From the variations of e_c − e_b and e_a − e_b; ∂ am/∂m at fixed u is −½ Δ ∫ sin²/Δ³ dφ."""
    g, h, momentum, j_ = body.g, body.h, body.momentum, v.diagonal
    mixed = 2.0 * sum(v.others[k] * momentum[i] * momentum[j] for k, i, j in CYCLIC)
    dg = triple(lambda i, j, k: j_[k] - j_[j])
    dh = triple(
        lambda k, i, j: 2.0 * (g[i] * momentum[j] * v.momentum[j] - g[j] * momentum[i] * v.momentum[i])
        + (dg[i] * momentum[j] ** 2 - dg[j] * momentum[i] ** 2)
        - mixed
    )
    change = triple(lambda k, i, j: -(dg[k] * h[k] + g[k] * dh[k]))  # of e_j − e_i
    span, spread = axes.parity * pick(axes.a, change), -axes.parity * pick(axes.c, change)
    # e_c − e_a and its variation are small near the separatrix; as differences of the two others they would be lost.
    narrow = clock.complement * span + axes.parity * pick(axes.b, change)
    s, c, d, time = clock.sine, clock.cn, clock.dn, clock.remainder
    along = 0.5 * (time * span - clock.span * narrow * integrals.over_a)  # λ δam / Δ
    # Below an eighth of a turn by the integral ∫ (S/C_c)² ds, beyond, where that one diverges, by the change of scale.
    early = c * c > 0.5
    over_c = (s * s * time - integrals.plain - d * d * integrals.over_a) / jnp.where(early, c * c, 1.0)
    ds = jnp.where(
        early,
        -0.5 * c * d * (over_c * span + integrals.over_a * spread),
        divided(c * d * along - 0.5 * s * span, jnp.where(early, 1.0, clock.span)),
    )
    dc = -s * d * along
    dd = -0.5 * s * s * narrow / d - clock.m * s * c * along
    cosines = [jnp.where(axes.b == i, 0.0, jnp.where(axes.c == i, dc, dd)) for i in range(3)]
    period = integrals.quarter * narrow - clock.chain.quarter * span
    return ClockVariation(
        ds, (cosines[0], cosines[1], cosines[2]), divided(period, clock.rate * clock.span)
    )


def momentum_variation(
    axes: Axes, clock: Clock, body: Body, v: Variation, dclock: ClockVariation, base: Triple, denominator: Scalar
) -> Triple:
    """δL of the addition theorem at fixed time left, before the flip; `base` is its value."""
    momentum, g, inverse, w, dm = body.momentum, body.g, body.inverse, body.omega, v.momentum
    s, c, ds, dc = clock.sine, clock.cosines, dclock.sine, dclock.cosines
    dw = triple(
        lambda i, j, k: inverse[i] * dm[i]
        + v.diagonal[i] * momentum[i]
        + v.others[k] * momentum[j]
        + v.others[j] * momentum[k]
    )
    rate = triple(lambda i, j, k: g[i] * momentum[j] * momentum[k])  # L × JL
    drate = triple(
        lambda i, j, k: (dm[j] * w[k] - dm[k] * w[j]) + (momentum[j] * dw[k] - momentum[k] * dw[j])
    )
    # Off-diagonal entries of the matrices C and cof C, by third axis.
    mixed_c = triple(lambda k, i, j: divided(s * s * body.h[k] * v.others[k], c[i] + c[j]))
    mixed_x = triple(lambda k, i, j: -c[k] * mixed_c[k])
    numerator = triple(
        lambda i, j, k: c[j] * c[k] * dm[i]
        + (c[j] * dc[k] + c[k] * dc[j]) * momentum[i]
        + mixed_x[k] * momentum[j]
        + mixed_x[j] * momentum[k]
        + s * (dc[i] * rate[i] + mixed_c[k] * rate[j] + mixed_c[j] * rate[k] + c[i] * drate[i])
        + ds * c[i] * rate[i]
    )
    dg = triple(lambda i, j, k: v.diagonal[k] - v.diagonal[j])
    square = triple(lambda i, j, k: g[j] * g[k] * momentum[i] ** 2)
    dsquare = triple(
        lambda i, j, k: (dg[j] * g[k] + g[j] * dg[k]) * momentum[i] ** 2
        + 2.0 * momentum[i] * (g[j] * g[k] * dm[i] + g[k] * momentum[k] * v.others[j] - g[j] * momentum[j] * v.others[k])
    )
    a = axes.a
    dd = pick(a, dc)
    change = 2.0 * (clock.dn * dd - pick(a, square) * s * ds) - pick(a, dsquare) * s * s
    inverse_denominator = 1.0 / denominator
    return triple(lambda i, j, k: (numerator[i] - base[i] * change) * inverse_denominator)


def flipped(
    axes: Axes, clock: Clock, body: Body, v: Variation, dclock: ClockVariation, base: Triple, dbase: Triple, rate: Triple
) -> Triple:
    """δL after the half periods: the sign flip, the tilt of its axis, and the change of the time left."""
    late = -clock.halves * jnp.where(clock.halves == 0, 0.0, dclock.half_period)
    odd = clock.flip
    # The flip is 2cᵀc − 1; δc along axis x is δJ_xc/(J_c − J_x).
    tilt = triple(
        lambda k, i, j: jnp.where(
            odd[i] != odd[j],
            2.0 * v.others[k] * divided(jnp.ones_like(late), jnp.where(axes.c == j, 1.0, -1.0) * body.g[k]),
            0.0,
        )
    )
    return triple(
        lambda i, j, k: odd[i] * dbase[i] + tilt[k] * base[j] + tilt[j] * base[k] + rate[i] * late
    )


def action(
    axes: Axes, clock: Clock, body: Body, v: Variation, integrals: Integrals, base: Triple, denominator: Scalar, time: Scalar
) -> Scalar:
    """½ ∫ L·δJ L ds over the whole time: all six ∫ L_i L_j ds."""
    momentum, g, h, c, s, flip = body.momentum, body.g, body.h, clock.cosines, clock.sine, clock.flip
    b = axes.b
    scale = jnp.abs(pick(axes.a, h) * pick(axes.c, h))
    whole = divided(2.0 * (clock.chain.quarter - clock.complement * integrals.quarter), clock.span * clock.rate)
    middle = scale * (integrals.plain + clock.halves * jnp.where(clock.halves == 0, 0.0, whole))
    middle = middle + s * pick(b, momentum) * pick(b, base)
    excess = middle - pick(b, momentum) ** 2 * time
    squares = triple(lambda i, j, k: momentum[i] ** 2 * time + divided(g[i], pick(b, g)) * excess)
    mixed = triple(
        lambda k, i, j: (
            momentum[i] * momentum[j] * s * c[k]
            + momentum[k]
            * s
            * s
            * divided(c[i] * g[i] * momentum[j] ** 2 + c[j] * g[j] * momentum[i] ** 2, c[i] + c[j])
        )
        / denominator
    )
    total = triple(
        lambda k, i, j: flip[k] * mixed[k] + (flip[k] - 1.0) * divided(momentum[k], g[k])
    )
    return sum((0.5 * v.diagonal[i] * squares[i] + v.others[i] * total[i] for i in range(3)), jnp.zeros_like(time))
