"""The discrete Moser–Veselov algorithm for the free rotation, with preprocessed moments of inertia."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxrb.body.euler_equation import FullSolver, InertiaSolver, PrincipalSolver, SphericalSolver
from jaxrb.integrators.splitting import BLANES_MOAN_4, BLANES_MOAN_6, STRANG, Pairs, Splitting
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rational import turn
from jaxrb.math.vector import cross, dot, inverse_rows


class MoserVeselov(Splitting):
    """Half a kick, the discrete Moser–Veselov rotation, half a kick. Order 2; free rotation keeps energy and angular
    momentum, all of them exactly, and is symmetric in time.

    Over a step h the body turns by twice the angle whose tangent is |g|, about g, with

        m + g × m = (h/2) y (1 + |g|²),    m = Î g,

    where y is the angular momentum in the body frame: the midpoint rule but for the factor 1 + |g|². It is solved by
    `rounds` of Newton's method, which reach round-off for steps of up to 0.5 rad; what is left of the residual shows in
    the energy alone, since attitude and momentum turn by the same rotation. From 1 rad a step on there is no solution.

    Î = I gives order 2. The higher orders replace 1/I by (1 + s)/I + d with numbers s and d that depend on the two
    constants of motion, for which the discrete motion is the exact one to that order, at the same cost. They were
    derived anew from the modified Hamiltonian, which is a polynomial of the two constants (see `_clock`).
    (Moser and Veselov 1991, Commun. Math. Phys. 139, 217; McLachlan and Zanna 2005, Found. Comput. Math. 5, 87;
    Hairer and Vilmart 2006, J. Phys. A 39, 13225.)
    """

    order: ClassVar[int] = 2
    parts: ClassVar[Pairs] = STRANG

    rounds: int = eqx.field(static=True, default=4)

    def turn(
        self, inertia: InertiaSolver, omega: Vector, first: Scalar, second: Scalar
    ) -> tuple[Quaternion, Vector]:
        return self.turn_freely(inertia, omega, first + second)

    def turn_freely(self, inertia: InertiaSolver, omega: Vector, dt: Scalar) -> tuple[Quaternion, Vector]:
        if isinstance(inertia, SphericalSolver):
            return Quaternion(turn(dt * omega)), omega
        momentum = inertia.inertia.apply(omega)
        stretch, shift = _preprocessing(inertia, omega, momentum, dt, self.order)
        if isinstance(inertia, PrincipalSolver):
            tangent = _principal(inertia, momentum, dt, stretch, shift, self.rounds)
        else:
            assert isinstance(inertia, FullSolver)
            tangent = _full(inertia, momentum, dt, stretch, shift, self.rounds)
        increment = Quaternion.of_tangent(tangent)
        # ω + I⁻¹ (change of the momentum): one rounding a step, where I⁻¹ of the new momentum has a bias.
        return increment, omega + inertia.response(increment.unrotation_change(momentum))


class MoserVeselov4(MoserVeselov):
    """`MoserVeselov` with moments preprocessed to order 4; with forces, six substeps of Blanes and Moan. Order 4."""

    order: ClassVar[int] = 4
    parts: ClassVar[Pairs] = BLANES_MOAN_4


class MoserVeselov6(MoserVeselov):
    """`MoserVeselov` with moments preprocessed to order 6; with forces, ten substeps of Blanes and Moan. Order 6."""

    order: ClassVar[int] = 6
    parts: ClassVar[Pairs] = BLANES_MOAN_6


def _preprocessing(
    inertia: InertiaSolver, omega: Vector, momentum: Vector, dt: Scalar, order: int
) -> tuple[Scalar, Scalar]:
    """1 + s and d of the preprocessed inverse moments (1 + s)/I + d.

    The discrete motion of inverse moments Ĵ is the exact one of (1 + s̃)Ĵ + d̃, so 1 + s and d are found by setting that
    equal to J; each round of repetition gains a factor h².
    """
    one, zero = jnp.ones_like(omega[..., 0]), jnp.zeros_like(omega[..., 0])
    half_squared = 0.5 * dt * dt
    energy, casimir = half_squared * dot(omega, momentum), half_squared * dot(momentum, momentum)
    e1, e2, e3 = inertia.inverse_invariants()
    stretch, shift = one, zero
    for _ in range(order // 2 - 1):
        d1, d2 = stretch * shift, shift * shift
        stretched = stretch * stretch
        hatted = (
            stretch * e1 + 3.0 * shift,
            stretched * e2 + 2.0 * d1 * e1 + 3.0 * d2,
            stretch * stretched * e3 + stretch * d1 * e2 + d1 * shift * e1 + d2 * shift,
        )
        s, d = _clock(*hatted, stretch * energy + shift * casimir, casimir, order)
        stretch = 1.0 / (1.0 + s)
        # Together in one array: the compiler would form both anew for each of their uses.
        stretch, shift = components(stack(stretch, -d * stretch))
    return stretch, shift


def _clock(e1: Scalar, e2: Scalar, e3: Scalar, h: Scalar, c: Scalar, order: int) -> tuple[Scalar, Scalar]:
    """s̃ and d̃: the discrete motion is y × ((1 + s̃) J y + d̃ y), and the body turns at the rate in brackets.

    h and c are the kinetic energy and |y|²/2, both times the squared step, and e1, e2, e3 the symmetric polynomials of
    the inverse moments. As the discrete motion has the same constants as the exact one, its Hamiltonian is a function
    h + K₃ + K₅ + … of them, and 1 + s̃ and d̃ are its two derivatives. 6 K₃ = e1 h² − e2 hc + e3 c² and
    20 K₅ = (2e1² − e2) h³ + (2e3 − 3e1e2) h²c + (2e1e3 + e2²) hc² − e2e3 c³ follow from the rotation about a principal
    axis, of angle arcsin(ω dt), and from the precession of a symmetric body, both of which are elementary.
    """
    s, d = (2.0 * e1 * h - e2 * c) / 6.0, (2.0 * e3 * c - e2 * h) / 6.0
    if order > 4:
        first, second, third = 2.0 * e1 * e1 - e2, 2.0 * e3 - 3.0 * e1 * e2, 2.0 * e1 * e3 + e2 * e2
        s = s + (3.0 * first * h * h + 2.0 * second * h * c + third * c * c) / 20.0
        d = d + (second * h * h + 2.0 * third * h * c - 3.0 * e2 * e3 * c * c) / 20.0
    return s, d


def _principal(
    inertia: PrincipalSolver, momentum: Vector, dt: Scalar, stretch: Scalar, shift: Scalar, rounds: int
) -> Vector:
    """g with g₁ + κ₁ g₂g₃ = b₁ (1 + |g|²), κ₁ = Ĵ₁ (1/Ĵ₃ − 1/Ĵ₂), and so on round; b = (h/2) Ĵ y."""
    j1, j2, j3 = (stretch * j + shift for j in components(inertia.inverse))
    i1, i2, i3 = 1.0 / j1, 1.0 / j2, 1.0 / j3
    k1, k2, k3 = j1 * (i3 - i2), j2 * (i1 - i3), j3 * (i2 - i1)
    b1, b2, b3 = (0.5 * dt * j * y for j, y in zip((j1, j2, j3), components(momentum), strict=True))
    g1, g2, g3 = b1, b2, b3
    for _ in range(2):
        f = 1.0 + (g1 * g1 + g2 * g2 + g3 * g3)
        g1, g2, g3 = components(stack(b1 * f - k1 * g2 * g3, b2 * f - k2 * g3 * g1, b3 * f - k3 * g1 * g2))
    u1, u2, u3 = 2.0 * g1, 2.0 * g2, 2.0 * g3
    jacobian = (
        stack(1.0 - b1 * u1, k2 * g3 - b2 * u1, k3 * g2 - b3 * u1),
        stack(k1 * g3 - b1 * u2, 1.0 - b2 * u2, k3 * g1 - b3 * u2),
        stack(k1 * g2 - b1 * u3, k2 * g1 - b2 * u3, 1.0 - b3 * u3),
    )

    def residual(g: Vector) -> Vector:
        g1, g2, g3 = components(g)
        f = 1.0 + (g1 * g1 + g2 * g2 + g3 * g3)
        return stack(g1 + k1 * g2 * g3 - b1 * f, g2 + k2 * g3 * g1 - b2 * f, g3 + k3 * g1 * g2 - b3 * f)

    return _solved(residual, jacobian, stack(g1, g2, g3), rounds)


def _full(
    inertia: FullSolver, momentum: Vector, dt: Scalar, stretch: Scalar, shift: Scalar, rounds: int
) -> Vector:
    """The same for m = Î g, so that no inverse of Ĵ is needed: m + g × m = (h/2) y (1 + |g|²), g = Ĵ m."""
    xx, yy, zz, xy, xz, yz = components(inertia.inverse)
    xx, yy, zz = (stretch * x + shift for x in (xx, yy, zz))
    xy, xz, yz = stretch * xy, stretch * xz, stretch * yz
    columns = (stack(xx, xy, xz), stack(xy, yy, yz), stack(xz, yz, zz))
    a = 0.5 * dt * momentum
    one, zero = jnp.ones_like(xx), jnp.zeros_like(xx)
    units = (stack(one, zero, zero), stack(zero, one, zero), stack(zero, zero, one))

    def applied(m: Vector) -> Vector:
        return stack(*(dot(column, m) for column in columns))

    def right(g: Vector) -> Vector:
        return stack(*((1.0 + dot(g, g)) * x for x in components(a)))

    def residual(m: Vector) -> Vector:
        g = applied(m)
        return m + cross(g, m) - right(g)

    m = a
    for _ in range(2):
        m = m - residual(m)
    g = applied(m)
    jacobian = tuple(
        unit + cross(column, m) + cross(g, unit) - 2.0 * dot(g, column)[..., None] * a
        for unit, column in zip(units, columns, strict=True)
    )
    return applied(_solved(residual, jacobian, m, rounds))


def _solved(residual: Callable[[Vector], Vector], jacobian: Any, guess: Vector, rounds: int) -> Vector:
    """The zero of `residual` by Newton's method with the derivative (three columns) at the guess throughout."""
    rows = inverse_rows(jacobian)
    for _ in range(rounds):
        found = residual(guess)
        guess = guess - stack(*(dot(row, found) for row in rows))
    return guess
