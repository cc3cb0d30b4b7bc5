"""Values of torque-free rotation in closed form: the functions of time, and the angle about the momentum.

Everything here is one body in its principal axes and in natural units (largest moment and momentum near 1), by
components. The notation, used in `free_flight_tangent` too: moments I, J = 1/I, momentum L = Iω in the body frame,
g_i = J_k − J_j and L̇_i = g_i L_j L_k for (i, j, k) cyclic.

The three functions y_i = √(g_j g_k) L_i obey ẏ_i = y_j y_k, so y_i² + e_i is the same for all i, with constants
e_j − e_i = g_k (g_j L_i² − g_i L_j²). By the addition theorem of elliptic functions

    L_i(t) = (L_i C_j C_k + g_i L_j L_k S C_i) / D,    D = C_i² − g_j g_k L_i² S²,

where S : C_i are the quotients of Weierstrass's sigma functions of the time alone. They are entire in t and in the e,
so nothing is singular where moments are equal, at pure spin or at rest: there is no phase and no modulus in this form.
With b the axis of the middle moment, c the axis about which the momentum circulates and a the third, e_b ≤ e_a ≤ e_c
and S, C_a, C_b, C_c = sn(λt)/λ, dn, 1, cn with λ² = e_c − e_b, m λ² = e_a − e_b.
(Whittaker, "Analytical Dynamics", §69; DLMF 22.8, 23.2; Lawden, "Elliptic Functions and Applications", chapter 5.)
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Scalar, stack
from jaxrb.math.elliptic import Landen, carlson, landen, sine_cosine, smallest_complement
from jaxrb.math.quaternion import product

Triple = tuple[Scalar, Scalar, Scalar]
CYCLIC = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


class Axes(NamedTuple):
    """Indices of the roles a, b, c, and whether (a, b, c) is cyclic (+1) or not (−1)."""

    a: Scalar
    b: Scalar
    c: Scalar
    parity: Scalar


class Clock(NamedTuple):
    """The functions of time, for the time left after `halves` half periods of 2K/λ each.

    `sine` = S and `cosines` = (C_1, C_2, C_3) by body axis; `flip` is the sign of each axis after the half periods.
    `span` and `spread` are e_c − e_b and e_a − e_b, `m` their ratio and `complement` 1 − m. `beyond` is the time for
    which a body that is exactly on the separatrix has already come to rest at the middle axis.
    """

    span: Scalar
    spread: Scalar
    m: Scalar
    complement: Scalar
    rate: Scalar
    chain: Landen
    separatrix: Scalar
    halves: Scalar
    remainder: Scalar
    beyond: Scalar
    sine: Scalar
    sn: Scalar
    cn: Scalar
    dn: Scalar
    cosines: Triple
    flip: Triple


class Motion(NamedTuple):
    """A free rotation after its time: `wxyz` from the body's axes then to those at the start, and ω then."""

    wxyz: jax.Array
    omega: Triple
    momentum: Triple
    unflipped: Triple
    denominator: Scalar


def pick(index: Scalar, values: Triple) -> Scalar:
    """The value at an index that is known only when the program runs."""
    return jnp.where(index == 0, values[0], jnp.where(index == 1, values[1], values[2]))


def divided(numerator: Scalar, denominator: Scalar, otherwise: float = 0.0) -> Scalar:
    """numerator / denominator, and `otherwise` where the denominator is 0."""
    zero = denominator == 0
    return jnp.where(zero, otherwise, numerator / jnp.where(zero, 1.0, denominator))


def couplings(moments: Triple) -> Triple:
    """g_i = J_k − J_j, from the difference of the moments: J_k − J_j itself cancels for nearly equal ones."""
    g = [(moments[j] - moments[k]) / (moments[j] * moments[k]) for _, j, k in CYCLIC]
    return g[0], g[1], g[2]


def axes_of(moments: Triple, momentum: Triple, g: Triple) -> Axes:
    """Which axis is which. The sign that tells the axis of circulation is formed without the energy, whose
    difference from the separatrix's cancels."""
    x, y, z = moments
    low = jnp.where((x <= y) & (x <= z), 0, jnp.where(y <= z, 1, 2))
    high = jnp.where((z >= x) & (z >= y), 2, jnp.where(y >= x, 1, 0))
    middle = 3 - low - high
    about_high = jnp.abs(pick(low, g)) * pick(high, momentum) ** 2
    about_low = jnp.abs(pick(high, g)) * pick(low, momentum) ** 2
    top = about_high >= about_low
    a, c = jnp.where(top, low, high), jnp.where(top, high, low)
    return Axes(a, middle, c, jnp.where((middle - a) % 3 == 1, 1.0, -1.0).astype(x.dtype))


def clock_of(axes: Axes, momentum: Triple, g: Triple, time: Scalar) -> Clock:
    """The functions S, C of the time, its half periods removed."""
    a, b, c, _ = axes
    ga, gb, gc = (jnp.abs(pick(i, g)) for i in (a, b, c))
    aa, bb, cc = (pick(i, momentum) ** 2 for i in (a, b, c))
    # Sums of squares all; the one difference is the distance from the separatrix.
    span, spread, gap = ga * (gc * bb + gb * cc), gc * (ga * bb + gb * aa), gb * (ga * cc - gc * aa)
    least = smallest_complement(span.dtype)
    m = jnp.minimum(divided(spread, span), 1.0)
    complement = jnp.clip(divided(gap, span, 1.0), least, 1.0)
    rate = jnp.sqrt(span)
    chain = landen(complement)
    # Exactly on the separatrix the period is infinite. At half of the quarter period that stands for it, the momentum
    # is within √least of the middle axis, and stays.
    whole = rate * time
    separatrix = (gap <= 0) & (span > 0)
    limit = jnp.where(separatrix, 0.5 * chain.quarter, jnp.inf)
    argument = jnp.clip(whole, -limit, limit)
    phase = argument * chain.mean
    halves = jnp.round(phase / jnp.pi)
    phase = phase - jnp.pi * halves
    sn, cn = sine_cosine(chain, phase)
    dn = jnp.sqrt(complement + m * cn * cn)
    sine = jnp.where(rate == 0, time, divided(sn, rate))
    remainder = jnp.where(rate == 0, time, divided(phase, chain.mean * rate))
    odd = jnp.where(halves % 2 == 0, 1.0, -1.0).astype(span.dtype)
    cosines = [jnp.where(b == i, 1.0, jnp.where(c == i, cn, dn)) for i in range(3)]
    flip = [jnp.where(c == i, 1.0, odd) for i in range(3)]
    return Clock(
        span, spread, m, complement, rate, chain, separatrix, halves, remainder, divided(whole - argument, rate),
        sine, sn, cn, dn, (cosines[0], cosines[1], cosines[2]), (flip[0], flip[1], flip[2]),
    )  # fmt: skip


def momentum_then(axes: Axes, clock: Clock, momentum: Triple, g: Triple) -> tuple[Triple, Scalar]:
    """L(t) by the addition theorem, before the flip by half periods, and the denominator D."""
    a = axes.a
    products = tuple(g[j] * g[k] for _, j, k in CYCLIC)
    # Both terms are positive for the axes a and c, whose neighbours' g have opposite signs.
    denominator = clock.dn * clock.dn - pick(a, products) * (pick(a, momentum) * clock.sine) ** 2  # type: ignore[arg-type]
    s, cosine, inverse = clock.sine, clock.cosines, 1.0 / denominator
    new = [
        (momentum[i] * cosine[j] * cosine[k] + g[i] * momentum[j] * momentum[k] * s * cosine[i]) * inverse
        for i, j, k in CYCLIC
    ]
    return (new[0], new[1], new[2]), denominator
