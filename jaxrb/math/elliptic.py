"""Elliptic integrals and functions of real argument: Carlson's symmetric integrals and Landen's transformation.

Arrays only, elementwise, any shape. The loops have fixed lengths, long enough for every modulus down to
`smallest_complement`, so that no batch waits for its worst member and the programs stay small.

None of these functions is differentiated by JAX: where they are used, a derivative is written down in closed form
(`jaxrb.integrators.free_flight_tangent`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.math.arrays import Scalar


class Landen(NamedTuple):
    """Landen's descending chain from one parameter m: `quarter` = K(m), `mean` = π/2K, and per level the modulus k and
    the complementary parameter 1 − k², (levels, ...)."""

    quarter: Scalar
    mean: Scalar
    moduli: jax.Array
    complements: jax.Array


def smallest_complement(dtype) -> float:
    """The smallest 1 − m that the loops are made for. K is then 42 in float32 and 335 in float64."""
    return 1e-36 if np.finfo(dtype).bits == 32 else 1e-290


def _double(dtype) -> bool:
    return np.finfo(dtype).bits > 32


def landen(complement: Scalar) -> Landen:
    """The chain that starts at the parameter m = 1 − `complement`, for complements in [smallest_complement, 1].

    Each level replaces (a, b) by its arithmetic and geometric mean, which starts at (1, √complement); the complement
    is taken as given, since 1 − m has lost it near m = 1. (DLMF 19.8, 22.7; Bulirsch 1965, Numer. Math. 7, 78.)
    """

    def level(means, _):
        a, b = means
        total = a + b
        k = (a - b) / total
        # Two forms of one number, each where it is exact: the later levels must not round at all.
        rest = jnp.where(k < 0.5, 1.0 - k * k, 4.0 * a * b / (total * total))
        return (0.5 * total, jnp.sqrt(a * b)), (k, rest)

    start = (jnp.ones_like(complement), jnp.sqrt(complement))
    (mean, _), (moduli, complements) = lax.scan(
        level, start, None, length=13 if _double(complement.dtype) else 9
    )
    return Landen(0.5 * np.pi / mean, mean, moduli, complements)


def sine_cosine(chain: Landen, phase: Scalar) -> tuple[Scalar, Scalar]:
    """sn(u), cn(u) for u = `phase` / `mean` with |phase| ≤ π/2, that is |u| ≤ K. (DLMF 22.7(i), read upwards.)"""

    def level(pair, kc):
        s, c = pair
        k, complement = kc
        # dn of this level; no difference is formed, so cn keeps its relative accuracy near u = K.
        d = jnp.sqrt(complement + (k * c) * (k * c))
        inverse = 1.0 / (1.0 + k * (s * s))
        return ((1.0 + k) * s * inverse, c * d * inverse), None

    start = (jnp.sin(phase), jnp.cos(phase))
    (s, c), _ = lax.scan(level, start, (chain.moduli, chain.complements), reverse=True)
    # The levels let s² + c² drift from 1 by their round-off.
    inverse = 1.0 / jnp.sqrt(s * s + c * c)
    return s * inverse, c * inverse


# arctan(√e)/√e as a polynomial in e, lowest power first: Chebyshev's on [0, 0.1716], where it errs by 1.3e-18.
_ARCTANGENT = (
    1.0,
    -0.3333333333333312,
    0.19999999999940807,
    -0.142857142792419,
    0.11111110744504495,
    -0.09090896797060963,
    0.07692045115329452,
    -0.0666294933513016,
    0.058468600441315986,
    -0.05035019199400293,
    0.037963116386953384,
    -0.017803024570372427,
)


def carlson(x: Scalar, y: Scalar, z: Scalar, p: Scalar) -> tuple[Scalar, Scalar]:
    """Carlson's R_F(x, y, z) and R_J(x, y, z, p); R_D(x, y, z) is R_J(x, y, z, z).

    For 0 ≤ x, y ≤ p, of which one may be 0, and 0 < z ≤ p ≤ 2z. (Carlson 1995, Numer. Algorithms 10, 13.) The sum in
    R_J is taken with R_C(1, 1 + e) = arctan(√e)/√e in full in every term, as in Carlson 1979, Numer. Math. 33, 1: for
    small x and y its argument stays as it is for several rounds. With p ≤ 2z e is at most (√2 − 1)/(√2 + 1), and a
    polynomial serves; XLA's arctangent would be three quarters of the whole cost.
    """
    product = (p - x) * (p - y) * (p - z)

    def duplicate(_, carry):
        x, y, z, p, total, scale = carry
        sx, sy, sz, sp = jnp.sqrt(x), jnp.sqrt(y), jnp.sqrt(z), jnp.sqrt(p)
        shift = sx * sy + sy * sz + sz * sx
        part = scale / ((sp + sx) * (sp + sy) * (sp + sz))
        excess = product * scale * part * part
        circular = jnp.full_like(excess, _ARCTANGENT[-1])
        for coefficient in reversed(_ARCTANGENT[:-1]):
            circular = circular * excess + coefficient
        return (*(0.25 * (v + shift) for v in (x, y, z, p)), total + part * circular, 0.25 * scale)

    start = (x, y, z, p, jnp.zeros_like(x), jnp.ones((), x.dtype))
    end_x, end_y, end_z, end_p, total, scale = lax.fori_loop(
        0, 14 if _double(x.dtype) else 10, duplicate, start
    )
    first = _first_kind(x, y, (x + y + z) / 3.0, (end_x + end_y + end_z) / 3.0, scale)
    last = (end_x + end_y + end_z + 2.0 * end_p) / 5.0
    return first, _third_kind(x, y, z, (x + y + z + 2.0 * p) / 5.0, last, scale) + 6.0 * total


def _first_kind(x, y, mean, last, scale):
    """Taylor's series of R_F about equal arguments, after the duplications."""
    ratio = scale / last
    a, b = (mean - x) * ratio, (mean - y) * ratio
    c = -a - b
    e2, e3 = a * b - c * c, a * b * c
    return (1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0) / jnp.sqrt(last)


def _third_kind(x, y, z, mean, last, scale):
    """Taylor's series of R_J about equal arguments, after the duplications."""
    ratio = scale / last
    a, b, c = (mean - x) * ratio, (mean - y) * ratio, (mean - z) * ratio
    p = -0.5 * (a + b + c)
    pp = p * p
    e2 = a * b + a * c + b * c - 3.0 * pp
    e3 = a * b * c + 2.0 * e2 * p + 4.0 * p * pp
    e4 = (2.0 * a * b * c + e2 * p + 3.0 * p * pp) * p
    e5 = a * b * c * pp
    series = 1.0 - 3.0 * e2 / 14.0 + e3 / 6.0 + 9.0 * e2 * e2 / 88.0 - 3.0 * e4 / 22.0
    series = series - 9.0 * e2 * e3 / 52.0 + 3.0 * e5 / 26.0
    return scale * series / (last * jnp.sqrt(last))
