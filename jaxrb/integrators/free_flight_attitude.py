"""The attitude of torque-free rotation: the angle about the momentum, by Carlson's integral of the third kind.

Notation and units as in `free_flight_motion`. With n = L/|L|, e the axis c, near which n stays,
and p(n) the smallest rotation that takes n to e, the rotation from the body's axes at time t to those at the start is
p(n₀)⁻¹ · Rot(e, ψ) · p(n), and ψ̇ = (2T + L ω_e)/(L + L_e) > 0.

ψ splits into a rate, an integral J = ∫ sn²/(1 + ν sn²) du and an angle α that is a function of the position on the
orbit. There are two such splittings, with ν and with ν' = m/ν, linked by the transformation of R_J (DLMF 19.21.12). The
smaller of the two keeps the argument p of R_J within [1, 2], where it is accurate to the last digits for every modulus
and every shape of body; with the other one p reaches 1e12 for slender bodies.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.integrators.free_flight_motion import Clock, Motion, divided
from jaxrb.math.arrays import Scalar, stack
from jaxrb.math.quaternion import product


class Lanes(NamedTuple):
    """Arguments (k,) of Carlson's integrals, evaluated together: one loop in the program, whatever their number."""

    x: jax.Array
    y: jax.Array
    z: jax.Array
    p: jax.Array

    def with_more(self, more: "Lanes") -> "Lanes":
        """These and then the others."""
        return Lanes(*(jnp.concatenate(pair) for pair in zip(self, more, strict=True)))


class Orbit(NamedTuple):
    """The start and the end of the motion on its orbit, arrays (2,), and the splitting of ψ that serves it.

    `sine` and `cosine` are of the amplitude, turned by π where that
    makes the cosine positive. `inner` tells whether the splitting is the one with ν'.
    """

    momentum: tuple[jax.Array, jax.Array, jax.Array]
    sine: jax.Array
    cosine: jax.Array
    inner: jax.Array
    nu: Scalar
    weight: Scalar
    turn: tuple[jax.Array, jax.Array]
    sense: Scalar


def orbit_of(motion: Motion) -> Orbit:
    """Where the motion starts and ends on its orbit."""
    clock, (ia, ib, ic), first = motion.clock, motion.moments, motion.momentum
    sense = jnp.where(ic >= ia, 1.0, -1.0).astype(ia.dtype)
    x, y, z = (stack(*pair) for pair in zip(first, motion.momentum_then, strict=True))
    # The amplitude: ω_b and ω_a over their largest values, with the sign that makes it grow in time.
    ab, bc, ac = jnp.abs(ib - ia), jnp.abs(ic - ib), jnp.abs(ic - ia)
    cosine, sine = jnp.sqrt(ac * ib) * x, sense * (jnp.sqrt(bc * ia) * y)
    squared = cosine * cosine + sine * sine
    centre = squared == 0
    inverse = jnp.where(cosine < 0, -1.0, 1.0) / jnp.sqrt(jnp.where(centre, 1.0, squared))
    cosine, sine = jnp.where(centre, 1.0, cosine * inverse), jnp.where(centre, 0.0, sine * inverse)
    # L² − 2T I_a and 2T I_c − L² up to sign, as sums.
    d = divided(ac * first[0] ** 2, ia) + divided(bc * first[1] ** 2, ib)
    e = divided(ab * first[1] ** 2, ib) + divided(ac * first[2] ** 2, ic)
    outer, lesser = divided(ic * ab, ia * bc), divided(d * ia, e * ic)
    # ν' ≤ ν without the divisions: e = 0 is ν' = ∞, and I_b = I_c is ν = ∞.
    inner = d * (ia * ia) * bc <= e * (ic * ic) * ab
    nu = jnp.where(inner, lesser, outer)
    weight = jnp.where(nu == 0, 0.0, nu * jnp.sqrt(divided(ib * ac, ia * bc, 1.0) * (1.0 + lesser)))
    turn = _position_angle(clock, sine, cosine, inner, nu, jnp.sqrt(ia * bc), jnp.sqrt(ib * ac))
    return Orbit((x, y, z), sine, cosine, inner, nu, weight, turn, jnp.where(inner, sense, -sense))


def _position_angle(
    clock: Clock, s: jax.Array, c: jax.Array, inner: jax.Array, nu: Scalar, ka: Scalar, kb: Scalar
) -> tuple[jax.Array, jax.Array]:
    """cos α/2 and sin α/2, with α in [−π/2, π/2]: for ν' the difference of two amplitudes, for ν an amplitude."""
    stretch, width = jnp.sqrt(1.0 + nu), jnp.sqrt(clock.complement + clock.m * c * c)
    difference = ka * kb * s * c * (nu + clock.m * s * s) / (stretch + width)
    y = jnp.where(inner, difference, kb * s)
    x = jnp.where(inner, ka * ka * c * c * width + kb * kb * stretch * s * s, ka * c)
    return _half(x, y)


def _half(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Cosine and sine of half the angle of (x, y), for x ≥ 0; the angle of (0, 0) is 0."""
    shifted = x + jnp.sqrt(x * x + y * y)
    squared = shifted * shifted + y * y
    nowhere = squared == 0
    inverse = 1.0 / jnp.sqrt(jnp.where(nowhere, 1.0, squared))
    return jnp.where(nowhere, 1.0, shifted * inverse), y * inverse


def angle_lanes(orbit: Orbit, clock: Clock) -> Lanes:
    """The integrals of `angle`: at the start, at the end and over a quarter period."""
    one = jnp.ones((1,), clock.m.dtype)
    sine, cosine = jnp.concatenate([orbit.sine, one]), jnp.concatenate([orbit.cosine, 0.0 * one])
    # Exactly on the separatrix, where the clock's 1 − m stands for 0, one that is nearer 1 and changes no digit of J
    # less its linear part: the quarter period is then 38, not 335, and so is the round-off.
    complement = jnp.where(clock.separatrix, jnp.finfo(clock.m.dtype).eps ** 2, clock.complement)
    square = cosine * cosine
    ones = jnp.ones_like(square)
    return Lanes(square, complement + clock.m * square, ones, ones + orbit.nu * sine * sine)


def angle(motion: Motion, orbit: Orbit, first: jax.Array, third: jax.Array) -> Scalar:
    """ψ(t) less the change of α, from R_F and R_J of the lanes above."""
    clock, s = motion.clock, orbit.sine
    u = s * first[:2]
    j = s * s * s * third[:2] / 3.0
    period = 2.0 * clock.chain.quarter
    passed = clock.rate * clock.remainder + (u[0] - u[1])
    extra = jnp.round(passed / period)
    turns = clock.halves + extra
    # Near the middle axis the position no longer tells the time, and J grows with the time: that part is taken from it.
    late = passed - period * extra + clock.rate * clock.beyond
    integral = j[1] - j[0] + turns * (third[2] / 1.5) + late / (1.0 + orbit.nu)
    winding = jnp.where(orbit.inner, 0.0, np.pi * turns)
    moment = jnp.where(orbit.inner, motion.moments[2], motion.moments[0])
    x, y, z = motion.momentum
    rate = jnp.sqrt(x * x + y * y + z * z) / moment
    return rate * motion.time + orbit.sense * (orbit.weight * integral + winding)


def attitude(motion: Motion, orbit: Orbit, psi: Scalar) -> jax.Array:
    """The rotation b₀⁻¹ · b₁ as wxyz (4,), where b₀ = Rot(e, ±α₀) · p(n₀) and b₁ = Rot(e, ψ ± α₁) · p(n)."""
    c, s = orbit.turn[0], orbit.sense * orbit.turn[1]
    half = stack(jnp.zeros_like(psi), 0.5 * psi)
    cosine, sine = jnp.cos(half), jnp.sin(half)
    c, s = cosine * c - sine * s, sine * c + cosine * s
    # p(n) = [|L| + L_e, L × e] over its length; at rest, or where L² is no normal number, no rotation at all.
    x, y, z = orbit.momentum
    squared = x * x + y * y + z * z
    kind = jnp.finfo(psi.dtype)
    rest = squared < kind.tiny / kind.eps
    w = jnp.where(rest, 1.0, jnp.sqrt(squared) + z)
    x, y = jnp.where(rest, 0.0, x), jnp.where(rest, 0.0, y)
    inverse = 1.0 / jnp.sqrt(w * w + x * x + y * y)
    w, x, y = inverse * w, inverse * x, inverse * y
    ends = stack(c * w, c * y + s * x, s * y - c * x, s * w)
    return product(ends[0] * np.array([1.0, -1.0, -1.0, -1.0], psi.dtype), ends[1])
