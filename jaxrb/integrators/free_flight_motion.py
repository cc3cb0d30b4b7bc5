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

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxrb.math.arrays import Scalar
from jaxrb.math.elliptic import Landen, landen, sine_cosine, smallest_complement

Triple = tuple[Scalar, Scalar, Scalar]


class Axes(NamedTuple):
    """Indices of the roles a, b, c, and whether (a, b, c) is cyclic (+1) or not (−1)."""

    a: jax.Array
    b: jax.Array
    c: jax.Array
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
    separatrix: jax.Array
    halves: Scalar
    remainder: Scalar
    beyond: Scalar
    sine: Scalar
    cn: Scalar
    dn: Scalar
    cosines: Triple
    flip: Triple


class Motion(NamedTuple):
    """One body's rotation: at the start (`omega`, `momentum`) and after `time` (`omega_then`, `momentum_then`).

    `base` is the momentum then, before the flip by half periods, and `denominator` its D.
    """

    time: Scalar
    moments: Triple
    g: Triple
    omega: Triple
    momentum: Triple
    axes: Axes
    clock: Clock
    base: Triple
    denominator: Scalar
    momentum_then: Triple
    omega_then: Triple


def pick(index: jax.Array, values: Triple) -> Scalar:
    """The value at an index that is known only when the program runs."""
    return jnp.where(index == 0, values[0], jnp.where(index == 1, values[1], values[2]))


def divided(numerator: Scalar, denominator: Scalar, otherwise: float = 0.0) -> Scalar:
    """numerator / denominator, and `otherwise` where the denominator is 0."""
    zero = denominator == 0
    return jnp.where(zero, otherwise, numerator / jnp.where(zero, 1.0, denominator))


def triple(function: Callable[[int, int, int], Scalar]) -> Triple:
    """(f(0, 1, 2), f(1, 2, 0), f(2, 0, 1)): one value for each axis, or for each pair by its third axis."""
    return function(0, 1, 2), function(1, 2, 0), function(2, 0, 1)


def couplings(moments: Triple) -> Triple:
    """g_i = J_k − J_j, from the difference of the moments: J_k − J_j itself cancels for nearly equal ones."""
    return triple(lambda i, j, k: (moments[j] - moments[k]) / (moments[j] * moments[k]))


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
    # |S| ≤ |t|: the bound keeps its cube finite, and is beyond the time after which the phase is all round-off.
    bound = float(jnp.finfo(span.dtype).max) ** 0.25
    time = jnp.clip(time, -bound, bound)
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
    cosines = triple(lambda i, j, k: jnp.where(b == i, 1.0, jnp.where(c == i, cn, dn)))
    flip = triple(lambda i, j, k: jnp.where(c == i, 1.0, odd))
    return Clock(
        span, spread, m, complement, rate, chain, separatrix, halves, remainder, divided(whole - argument, rate),
        sine, cn, dn, cosines, flip,
    )  # fmt: skip


def motion_of(moments: Triple, omega: Triple, time: Scalar) -> Motion:
    """L(t) and ω(t) by the addition theorem."""
    momentum = triple(lambda i, j, k: moments[i] * omega[i])
    g = couplings(moments)
    axes = axes_of(moments, momentum, g)
    clock = clock_of(axes, momentum, g, time)
    products = triple(lambda i, j, k: g[j] * g[k])
    # Both terms are positive for the axes a and c, whose neighbours' g have opposite signs.
    denominator = clock.dn * clock.dn - pick(axes.a, products) * (pick(axes.a, momentum) * clock.sine) ** 2
    s, c, inverse = clock.sine, clock.cosines, 1.0 / denominator
    base = triple(
        lambda i, j, k: (momentum[i] * c[j] * c[k] + g[i] * momentum[j] * momentum[k] * s * c[i]) * inverse
    )
    then = triple(lambda i, j, k: clock.flip[i] * base[i])
    omega_then = triple(lambda i, j, k: then[i] / moments[i])
    return Motion(time, moments, g, omega, momentum, axes, clock, base, denominator, then, omega_then)
