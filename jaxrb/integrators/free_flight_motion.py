"""Values of torque-free rotation in closed form: the functions of time, and the angle about the momentum.

Everything here is one body, by components, in natural units (largest moment and momentum near 1) and in principal axes
a, b, c of its own (`Frame`): b is that of the middle moment, c the one about which the momentum circulates. The
notation, used in `free_flight_tangent` too: moments I, J = 1/I, momentum L = Iω in the body frame, g_i = J_k − J_j and
L̇_i = g_i L_j L_k for (i, j, k) cyclic.

The three functions y_i = √(g_j g_k) L_i obey ẏ_i = y_j y_k, so y_i² + e_i is the same for all i, with constants
e_j − e_i = g_k (g_j L_i² − g_i L_j²). By the addition theorem of elliptic functions

    L_i(t) = (L_i C_j C_k + g_i L_j L_k S C_i) / D,    D = C_i² − g_j g_k L_i² S²,

where S : C_i are the quotients of Weierstrass's sigma functions of the time alone. They are entire in t and in the e,
so nothing is singular where moments are equal, at pure spin or at rest: there is no phase and no modulus in this form.
Here e_b ≤ e_a ≤ e_c and S, C_a, C_b, C_c = sn(λt)/λ, dn, 1, cn with λ² = e_c − e_b and m λ² = e_a − e_b.
(Whittaker, "Analytical Dynamics", §69; DLMF 22.8, 23.2; Lawden, "Elliptic Functions and Applications", chapter 5.)
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Scalar, Vector, components
from jaxrb.math.elliptic import Landen, landen, sine_cosine, smallest_complement

Triple = tuple[Scalar, Scalar, Scalar]


class Frame(NamedTuple):
    """Right-handed axes a, ±b, ±c of the body: which of its axes each is, and the two signs. L_c ≥ 0 at the start."""

    a: jax.Array
    b: jax.Array
    c: jax.Array
    sign_b: Scalar
    sign_c: Scalar

    def seen(self, vector: Triple) -> Triple:
        """Components along a, ±b, ±c of those along the body's axes."""
        x, y, z = (_pick(index, vector) for index in (self.a, self.b, self.c))
        return x, self.sign_b * y, self.sign_c * z

    def seen_diagonal(self, moments: Triple) -> Triple:
        """The same for the diagonal of a tensor."""
        return _pick(self.a, moments), _pick(self.b, moments), _pick(self.c, moments)

    def seen_others(self, products: Triple) -> Triple:
        """The same for the entries yz, xz, xy of a symmetric tensor."""
        x, y, z = (_pick(index, products) for index in (self.a, self.b, self.c))
        return self.sign_b * self.sign_c * x, self.sign_c * y, self.sign_b * z

    def back(self, vector: Triple) -> Triple:
        """Components along the body's axes of those along a, ±b, ±c."""
        x, y, z = vector[0], self.sign_b * vector[1], self.sign_c * vector[2]
        return triple(lambda i, j, k: jnp.where(self.a == i, x, jnp.where(self.b == i, y, z)))


class Clock(NamedTuple):
    """The functions of time, for the time left after `halves` half periods of 2K/λ each.

    `sine` = S, and `cn`, `dn` are C_c, C_a; `odd` is −1 after an odd number of half periods, which turn the momentum by
    half a turn about c. `span` and `spread` are e_c − e_b and e_a − e_b, `m` their ratio and `complement` 1 − m.
    `beyond` is the time for which a body exactly on the separatrix has already been at rest at the middle axis.
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
    odd: Scalar

    @property
    def cosines(self) -> Triple:
        """C_a, C_b, C_c."""
        return self.dn, jnp.ones_like(self.dn), self.cn

    @property
    def flip(self) -> Triple:
        """The sign of each axis after the half periods."""
        return self.odd, self.odd, jnp.ones_like(self.odd)


class Motion(NamedTuple):
    """One body's rotation: at the start (`omega`, `momentum`) and after `time` (`omega_then`, `momentum_then`).

    `base` is the momentum then, before the flip by half periods, and `denominator` its D.
    """

    time: Scalar
    moments: Triple
    g: Triple
    omega: Triple
    momentum: Triple
    clock: Clock
    base: Triple
    denominator: Scalar
    momentum_then: Triple
    omega_then: Triple


def _pick(index: jax.Array, values: Triple) -> Scalar:
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


def frame_of(moments: Vector, omega: Vector) -> tuple[Frame, Triple, Triple]:
    """The frame, and moments and ω seen from it.

    The axis of circulation is told without the energy, whose difference from the separatrix's cancels. The moments are
    sorted by XLA's own sort, which no later computation is merged with: the program becomes half as long.
    """
    places = lax.broadcasted_iota(jnp.int32, (3,), 0)
    rows = lax.sort((moments, omega, places), dimension=0, num_keys=1)
    (low, b, high), (w_low, w_b, w_high), (i_low, i_b, i_high) = (components(row) for row in rows)
    top = (high - b) / (high * b) * (high * w_high) ** 2 >= (b - low) / (b * low) * (low * w_low) ** 2
    swapped = [
        (jnp.where(top, p, q), jnp.where(top, q, p))
        for p, q in ((low, high), (w_low, w_high), (i_low, i_high))
    ]
    (ia, ic), (wa, wc), (a, c) = swapped
    sign_c = jnp.where(wc >= 0, 1.0, -1.0).astype(ia.dtype)
    sign_b = jnp.where((i_b - a) % 3 == 1, sign_c, -sign_c)
    return Frame(a, i_b, c, sign_b, sign_c), (ia, b, ic), (wa, sign_b * w_b, sign_c * wc)


def clock_of(momentum: Triple, g: Triple, time: Scalar) -> Clock:
    """The functions S, C of the time, its half periods removed."""
    ga, gb, gc = (jnp.abs(x) for x in g)
    aa, bb, cc = (x * x for x in momentum)
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
    return Clock(
        span, spread, m, complement, rate, chain, separatrix, halves, remainder, divided(whole - argument, rate),
        sine, cn, dn, odd,
    )  # fmt: skip


def motion_of(moments: Triple, omega: Triple, time: Scalar) -> Motion:
    """L(t) and ω(t) by the addition theorem."""
    momentum = triple(lambda i, j, k: moments[i] * omega[i])
    g = couplings(moments)
    clock = clock_of(momentum, g, time)
    # Both terms are positive: g_b and g_c have opposite signs.
    denominator = clock.dn * clock.dn - g[1] * g[2] * (momentum[0] * clock.sine) ** 2
    s, c, inverse = clock.sine, clock.cosines, 1.0 / denominator
    base = triple(
        lambda i, j, k: (momentum[i] * c[j] * c[k] + g[i] * momentum[j] * momentum[k] * s * c[i]) * inverse
    )
    flip = clock.flip
    then = triple(lambda i, j, k: flip[i] * base[i])
    omega_then = triple(lambda i, j, k: then[i] / moments[i])
    return Motion(time, moments, g, omega, momentum, clock, base, denominator, then, omega_then)
