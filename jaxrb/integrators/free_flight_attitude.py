"""The attitude of torque-free rotation: the angle about the momentum, by Carlson's integral of the third kind.

Notation and units as in `free_flight_motion`. With n = L/|L|, e the end of the axis of circulation near which n stays,
and p(n) the smallest rotation that takes n to e, the rotation from the body's axes at time t to those at the start is
p(n₀)⁻¹ · Rot(e, ψ) · p(n), and ψ̇ = (2T + L ω_e)/(L + L_e) > 0.

ψ splits into a rate, an integral J = ∫ sn²/(1 + ν sn²) du and an angle of the position on the orbit. There are two such
splittings, with ν and with ν' = m/ν, linked by the transformation of R_J (DLMF 19.21.12). The smaller of the two keeps
the argument p of R_J within [1, 2], where it is accurate to the last digits for every modulus and every shape of body;
with the other one p reaches 1e12 for slender bodies.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.integrators.free_flight_motion import Clock, Motion, Triple, divided, pick, triple
from jaxrb.math.arrays import Scalar, stack
from jaxrb.math.elliptic import carlson
from jaxrb.math.quaternion import product


class Lanes(NamedTuple):
    """Arguments of Carlson's integrals, evaluated together: one loop in the program, whatever their number."""

    x: list[Scalar]
    y: list[Scalar]
    z: list[Scalar]
    p: list[Scalar]

    def evaluated(self) -> tuple[list[jax.Array], list[jax.Array]]:
        """R_F and R_J of every lane."""
        first, third = carlson(*(jnp.stack(list(row)) for row in self))
        return list(first), list(third)


def joined(groups: list[Lanes]) -> Lanes:
    """All lanes of all groups, in order."""
    columns = [[lane for group in groups for lane in group[row]] for row in range(4)]
    return Lanes(*columns)


class Orbit(NamedTuple):
    """Two positions on one orbit, as sine and cosine of the amplitude, and which splitting of ψ serves it."""

    sines: tuple[Scalar, Scalar]
    cosines: tuple[Scalar, Scalar]
    inner: Scalar
    nu: Scalar
    weight: Scalar
    amplitude_a: Scalar
    amplitude_b: Scalar
    stretch: Scalar
    sign: Scalar


def orbit_of(motion: Motion) -> Orbit:
    """Where the motion starts and ends on its orbit."""
    a, b, c, parity = motion.axes
    ia, ib, ic = (pick(i, motion.moments) for i in (a, b, c))
    # sin and cos of the amplitude are ω_b and ω_a over their largest values. The sign makes the amplitude grow in time.
    ca, cb = ia * jnp.abs(ic - ia), ib * jnp.abs(ic - ib)
    wa, wb, wc = (pick(i, motion.omega) for i in (a, b, c))
    sign = jnp.where(ic >= ia, 1.0, -1.0).astype(ia.dtype)
    forward = parity * sign * jnp.where(wc >= 0, 1.0, -1.0)
    ends = [
        _amplitude(jnp.sqrt(ca) * x, forward * jnp.sqrt(cb) * y)
        for x, y in ((wa, wb), (pick(a, motion.omega_then), pick(b, motion.omega_then)))
    ]
    ka, kb = ia * jnp.abs(ic - ib), ib * jnp.abs(ic - ia)
    d, e = ca * wa * wa + cb * wb * wb, ib * jnp.abs(ib - ia) * wb * wb + ic * jnp.abs(ic - ia) * wc * wc
    outer, inner = divided(ic * jnp.abs(ib - ia), ka), divided(d * ia, e * ic)
    # ν' ≤ ν without the divisions: e = 0 is ν' = ∞, ka = 0 is ν = ∞.
    small = d * ia * ka <= e * ic * (ic * jnp.abs(ib - ia))
    nu = jnp.where(small, inner, outer)
    root = jnp.sqrt(divided(kb, ka, 1.0) * (1.0 + inner))
    return Orbit(
        (ends[0][0], ends[1][0]), (ends[0][1], ends[1][1]), small, nu, jnp.where(nu == 0, 0.0, nu * root),
        jnp.sqrt(ka), jnp.sqrt(kb), jnp.sqrt(1.0 + inner), sign,
    )  # fmt: skip


def _amplitude(x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """(sin, cos) of the angle of (x, y), turned by π where that makes the cosine positive; (0, 1) at the centre."""
    squared = x * x + y * y
    centre = squared == 0
    inverse = jnp.where(x < 0, -1.0, 1.0) / jnp.sqrt(jnp.where(centre, 1.0, squared))
    return jnp.where(centre, 0.0, y * inverse), jnp.where(centre, 1.0, x * inverse)


def angle_lanes(orbit: Orbit, clock: Clock) -> Lanes:
    """The integrals of `angle`: at the start, at the end and over a quarter period."""
    one = jnp.ones_like(clock.m)
    squares = [c * c for c in orbit.cosines]
    complement = _complement(clock)
    widths = [complement + clock.m * square for square in squares]
    arguments = [one + orbit.nu * s * s for s in orbit.sines]
    return Lanes(
        [*squares, jnp.zeros_like(one)], [*widths, complement], [one] * 3, [*arguments, one + orbit.nu]
    )


def _complement(clock: Clock) -> Scalar:
    """1 − m; exactly on the separatrix, where the clock's stands for 0, one that is nearer 1 and changes no digit of J
    less its linear part: the quarter period is then 38, not 335, and so is the round-off."""
    return jnp.where(clock.separatrix, jnp.finfo(clock.m.dtype).eps ** 2, clock.complement)


def angle(motion: Motion, orbit: Orbit, first: list[Scalar], third: list[Scalar]) -> Scalar:
    """ψ(t), from R_F and R_J of the lanes above."""
    clock, (s0, s1), (c0, c1) = motion.clock, orbit.sines, orbit.cosines
    u0, u1 = s0 * first[0], s1 * first[1]
    j0, j1, quarter = (s * s * s * third[i] / 3.0 for i, s in enumerate((s0, s1, jnp.ones_like(s0))))
    period = 2.0 * clock.chain.quarter
    passed = clock.rate * clock.remainder + (u0 - u1)
    extra = jnp.round(passed / period)
    turns = clock.halves + extra
    # Near the middle axis the position no longer tells the time, and J grows with the time: that part is taken from it.
    late = passed - period * extra + clock.rate * clock.beyond
    integral = j1 - j0 + 2.0 * turns * quarter + late / (1.0 + orbit.nu)
    angle0, angle1 = (_position_angle(orbit, clock, s, c) for s, c in ((s0, c0), (s1, c1)))
    ia, ic = pick(motion.axes.a, motion.moments), pick(motion.axes.c, motion.moments)
    winding = jnp.where(orbit.inner, 0.0, np.pi * turns)
    sign = jnp.where(orbit.inner, orbit.sign, -orbit.sign)
    rate = _length(motion.momentum) / jnp.where(orbit.inner, ic, ia)
    return rate * motion.time + sign * (orbit.weight * integral + (angle1 - angle0) + winding)


def _position_angle(orbit: Orbit, clock: Clock, s: Scalar, c: Scalar) -> Scalar:
    """The part of ψ that is a function of the position: with ν' the difference of two amplitudes, which never winds."""
    ka, kb, stretch = orbit.amplitude_a, orbit.amplitude_b, orbit.stretch
    width = jnp.sqrt(clock.complement + clock.m * c * c)
    difference = ka * kb * s * c * (stretch * stretch - 1.0 + clock.m * s * s) / (stretch + width)
    y = jnp.where(orbit.inner, difference, kb * s)
    x = jnp.where(orbit.inner, ka * ka * c * c * width + kb * kb * stretch * s * s, ka * c)
    return jnp.arctan2(y, x)


def attitude(motion: Motion, psi: Scalar) -> jax.Array:
    """The rotation p(n₀)⁻¹ · Rot(e, ψ) · p(n) as wxyz (4,)."""
    end = motion.axes.c
    sign = jnp.where(pick(end, motion.momentum) >= 0, 1.0, -1.0).astype(psi.dtype)
    e = triple(lambda i, j, k: jnp.where(end == i, sign, 0.0))
    w, x, y, z = _to_end(motion.momentum, e)
    half = 0.5 * psi
    s = jnp.sin(half)
    turn = stack(jnp.cos(half), *(s * component for component in e))
    return product(product(stack(w, -x, -y, -z), turn), stack(*_to_end(motion.momentum_then, e)))


def _length(v: Triple) -> Scalar:
    return jnp.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def _to_end(momentum: Triple, e: Triple) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Smallest rotation that takes the direction of the momentum to the unit vector e, which is less than π away."""
    x, y, z = momentum
    w = _length(momentum) + (x * e[0] + y * e[1] + z * e[2])
    v = (y * e[2] - z * e[1], z * e[0] - x * e[2], x * e[1] - y * e[0])
    squared = w * w + v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    rest = squared == 0
    inverse = 1.0 / jnp.sqrt(jnp.where(rest, 1.0, squared))
    return jnp.where(rest, 1.0, w * inverse), v[0] * inverse, v[1] * inverse, v[2] * inverse
