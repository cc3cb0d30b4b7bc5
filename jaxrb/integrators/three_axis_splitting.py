"""Free rotation split into exact rotations about body axes."""

import functools
import operator
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.euler_equation import FullSolver, InertiaSolver, PrincipalSolver, SphericalSolver
from jaxrb.integrators.splitting import BLANES_MOAN_4, STRANG, Pairs, Splitting
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rational import half_turn_factors, turn
from jaxrb.math.vector import dot


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
    parts: ClassVar[Pairs] = STRANG

    def turn(
        self, inertia: InertiaSolver, omega: Vector, first: Scalar, second: Scalar
    ) -> tuple[Quaternion, Vector]:
        if isinstance(inertia, SphericalSolver):
            return Quaternion(turn((first + second) * omega)), omega
        return _split(inertia, omega, [(first, second)])

    def turn_freely(self, inertia: InertiaSolver, omega: Vector, dt: Scalar) -> tuple[Quaternion, Vector]:
        if isinstance(inertia, SphericalSolver):
            return Quaternion(turn(dt * omega)), omega
        return _split(inertia, omega, [(dt * first, dt * second) for first, second in self.parts])


class ThreeAxisSplitting4(ThreeAxisSplitting):
    """`ThreeAxisSplitting` in six substeps with the coefficients of Blanes and Moan. Order 4."""

    order: ClassVar[int] = 4
    parts: ClassVar[Pairs] = BLANES_MOAN_4


def _split(inertia: InertiaSolver, omega: Vector, pairs: list) -> tuple[Quaternion, Vector]:
    if isinstance(inertia, PrincipalSolver):
        return _principal(inertia, omega, pairs)
    assert isinstance(inertia, FullSolver)
    return _full(inertia, omega, pairs)


def _principal(inertia: PrincipalSolver, omega: Vector, pairs: list) -> tuple[Quaternion, Vector]:
    """Rotations about two principal axes a and b in turn, and about the momentum for what all three have in common."""
    inverse = components(inertia.inverse)
    first, second = _middle(inverse)

    def rolled(x: Any) -> list[jax.Array]:
        return _rolled(first, second, x)

    def back(x: Any) -> list[jax.Array]:
        return _rolled(second, first, x)

    (ja, jb, jc), spin = rolled(inverse), components(omega)
    momentum = [i * w for i, w in zip(rolled(components(inertia.inertia.moments)), rolled(spin), strict=True)]
    total = functools.reduce(operator.add, [part for pair in pairs for part in pair])
    turned = components(turn(stack(*(total * jc * m for m in momentum))))
    change = [jnp.zeros_like(m) for m in momentum]
    rate_a, rate_b = ja - jc, jb - jc
    waiting = None
    for one, two in pairs:
        span = one if waiting is None else one + waiting
        turned, change = _about(0, span * rate_a, turned, momentum, change)
        turned, change = _about(1, (one + two) * rate_b, turned, momentum, change)
        waiting = two
    assert waiting is not None
    (w, x, y, z), change = _about(0, waiting * rate_a, turned, momentum, change)
    # ω + I⁻¹ (change of the momentum): one rounding a step, where I⁻¹ of the new momentum has a bias.
    gain = back([j * c for j, c in zip((ja, jb, jc), change, strict=True)])
    later = stack(*(w + g for w, g in zip(spin, gain, strict=True)))
    return Quaternion(stack(w, *back((x, y, z)))), later


def _about(
    axis: int, rate: Scalar, turned: list[jax.Array], start: list[jax.Array], change: list[jax.Array]
) -> tuple[list[jax.Array], list[jax.Array]]:
    """Turn, and change of the momentum since the start, after a rotation about one axis by rate · momentum about it."""
    i, j, k = axis, (axis + 1) % 3, (axis + 2) % 3
    angle = rate * (start[i] + change[i])
    along_j, along_k = start[j] + change[j], start[k] + change[k]
    cosine, factor = half_turn_factors(angle * angle)
    sine = factor * angle
    versine, full = 2.0 * sine * sine, 2.0 * sine * cosine
    new = list(change)
    new[j] = change[j] + (full * along_k - versine * along_j)
    new[k] = change[k] - (full * along_j + versine * along_k)
    w, x, y, z = turned[0], turned[1 + i], turned[1 + j], turned[1 + k]
    q = list(turned)
    q[0], q[1 + i] = cosine * w - sine * x, cosine * x + sine * w
    q[1 + j], q[1 + k] = cosine * y + sine * z, cosine * z - sine * y
    # Together in one array: the compiler would form every number anew for each of its uses, down the whole chain.
    parts = components(stack(*q, *new))
    return parts[:4], parts[4:]


def _middle(x: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Whether the first, and whether the second, of three numbers is the middle one; of equal ones any serves."""
    p, q, r = x
    middle = jnp.maximum(jnp.minimum(p, q), jnp.minimum(jnp.maximum(p, q), r))
    return middle == p, (middle == q) & (middle != p)


def _rolled(first: jax.Array, second: jax.Array, x: Any) -> list[jax.Array]:
    """x rolled in a circle by one place where `first`, by two where `second`: the first (second) becomes the last."""
    p, q, r = x
    return [
        jnp.where(first, one, jnp.where(second, two, three))
        for one, two, three in ((q, r, p), (r, p, q), (p, q, r))
    ]


def _full(inertia: FullSolver, omega: Vector, pairs: list) -> tuple[Quaternion, Vector]:
    """Rotations about three fixed axes u with I⁻¹ = σ 1 + Σ d u uᵀ, and about the momentum for σ.

    The axes are those of the Cholesky factors, which have derivatives at equal moments where principal axes have none.
    """
    axes, common = _axes(inertia)
    momentum = inertia.inertia.apply(omega)
    total = functools.reduce(operator.add, [part for pair in pairs for part in pair])
    turned = Quaternion(turn(total * common[..., None] * momentum))

    def substep(carry: tuple[Quaternion, Vector], pair: Any) -> tuple[tuple[Quaternion, Vector], None]:
        first, second = pair
        spans = (first, first, first + second, second, second)
        for (axis, rate), span in zip((*axes, *axes[1::-1]), spans, strict=True):
            carry = _about_axis(axis, span * rate, momentum, *carry)
        return carry, None

    carry = (turned, jnp.zeros_like(momentum))
    if len(pairs) == 1:
        carry, _ = substep(carry, pairs[0])
    else:
        carry, _ = lax.scan(substep, carry, jnp.stack([jnp.stack(pair) for pair in pairs]))
    turned, change = carry
    return turned, omega + inertia.response(change)


def _axes(inertia: FullSolver) -> tuple[list[tuple[Vector, Scalar]], Scalar]:
    """Three pairs (u, d), and σ. With σ = 3/2 over the trace of I every d is positive for every rigid body, since no
    moment exceeds half the trace; it takes out what a compact body has of a sphere."""
    common = 1.5 / inertia.inertia.trace()
    xx, yy, zz, xy, xz, yz = components(inertia.inverse)
    first = xx - common
    one, zero = jnp.ones_like(xx), jnp.zeros_like(xx)
    down, across = xy / first, xz / first
    second = yy - common - down * xy
    last = (yz - down * xz) / second
    third = zz - common - across * xz - last * (yz - down * xz)
    axes = [stack(one, down, across), stack(zero, one, last), stack(zero, zero, one)]
    return list(zip(axes, (first, second, third), strict=True)), common


def _about_axis(
    axis: Vector, rate: Scalar, start: Vector, turned: Quaternion, change: Vector
) -> tuple[Quaternion, Vector]:
    """As `_about`, for a fixed axis of any direction and length."""
    momentum = start + change
    angle = rate * dot(axis, momentum)
    step = Quaternion(turn(stack(*(angle * x for x in components(axis)))))
    return turned @ step, change + step.unrotation_change(momentum)
