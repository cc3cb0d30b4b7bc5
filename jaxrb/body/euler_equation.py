"""Euler's equation of each kind of inertia, made ready for a run: inverses and couplings are formed once."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from jaxrb.body.inertia import FullInertia, Inertia, PrincipalInertia, SphericalInertia, symmetric_apply
from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.vector import cross, solve


def solver(inertia: Inertia) -> "InertiaSolver":
    """The inertia made ready for a run: what does not change from step to step is computed here, once."""
    if isinstance(inertia, SphericalInertia):
        return SphericalSolver(inertia, 1.0 / jnp.asarray(inertia.moment))
    if isinstance(inertia, PrincipalInertia):
        i1, i2, i3 = components(inertia.moments)
        inverse = stack(1.0 / i1, 1.0 / i2, 1.0 / i3)
        return PrincipalSolver(inertia, inverse, stack((i2 - i3) / i1, (i3 - i1) / i2, (i1 - i2) / i3))
    inertia = FullInertia(inertia.six())
    # In units of its trace: in float32 the cube of 1e-13 kg m², which a determinant is, would be no number.
    trace = inertia.trace()
    xx, yy, zz, xy, xz, yz = (part / trace for part in components(inertia.components))
    cofactor = [yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy]
    off = [xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz]
    reciprocal = 1.0 / (trace * (xx * cofactor[0] + xy * off[0] + xz * off[1]))
    return FullSolver(inertia, stack(*(c * reciprocal for c in cofactor + off)))


class InertiaSolver(eqx.Module):
    """An inertia with its inverse. `acceleration(ω, τ)` is Euler's equation I ω̇ = τ − ω × Iω in the body frame."""

    inertia: eqx.AbstractVar[Inertia]

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector | None:
        """ω̇ [rad/s²]; None stands for a torque, or an acceleration, that is zero by type."""
        raise NotImplementedError

    def inverted(self) -> Inertia:
        """I⁻¹ [1/(kg m²)] as the same kind of tensor."""
        raise NotImplementedError

    def inverse_invariants(self) -> tuple[Scalar, Scalar, Scalar]:
        """Trace, sum of principal minors and determinant of I⁻¹."""
        raise NotImplementedError

    def response(self, torque: Vector) -> Vector:
        """I⁻¹ τ [rad/s²]: the acceleration that a torque alone would give."""
        raise NotImplementedError

    def implicit_velocity(
        self, start: Vector, guess: Vector, torque: Vector | None, span: Scalar, sweeps: int
    ) -> Vector:
        """Solve ω = start + span · ω̇(ω, τ) by `sweeps` Newton steps from `guess`."""
        omega = guess
        # Measured in a power of two near the moments, which changes no bit: in float32 the determinant of 1e-13 kg m²
        # is zero.
        six = self.inertia.six()
        size = lax.stop_gradient(six[..., 0] + six[..., 1] + six[..., 2])
        unit = jnp.ldexp(jnp.ones_like(size), -jnp.frexp(size)[1])[..., None]
        inertia = FullInertia(unit * six)
        torque = None if torque is None else unit * torque
        for _ in range(sweeps):
            momentum = inertia.apply(omega)
            net = cross(momentum, omega) if torque is None else cross(momentum, omega) + torque
            residual = inertia.apply(omega - start) - span * net
            omega = omega - _solve_linearised(inertia, omega, momentum, residual, span)
        return omega


def _solve_linearised(
    inertia: Inertia, omega: Vector, momentum: Vector, residual: Vector, span: Scalar
) -> Vector:
    """(I + span (ω* I − (Iω)*))⁻¹ residual by Cramer's rule."""
    xx, yy, zz, xy, xz, yz = components(inertia.six())
    columns = (stack(xx, xy, xz), stack(xy, yy, yz), stack(xz, yz, zz))
    zero = jnp.zeros_like(xx)
    one = jnp.ones_like(xx)
    units = (stack(one, zero, zero), stack(zero, one, zero), stack(zero, zero, one))
    jacobian = [
        column + span * (cross(omega, column) - cross(momentum, unit))
        for column, unit in zip(columns, units, strict=True)
    ]
    return solve(tuple(jacobian), residual)


class SphericalSolver(InertiaSolver):
    """No gyroscopic term: ω × Iω vanishes by type."""

    inertia: SphericalInertia
    inverse: Scalar

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector | None:
        return None if torque is None else self.response(torque)

    def inverted(self) -> Inertia:
        return SphericalInertia(self.inverse)

    def response(self, torque: Vector) -> Vector:
        return stack(*(self.inverse * t for t in components(torque)))

    def implicit_velocity(self, start, guess, torque, span, sweeps):
        if torque is None:
            return start
        return start + span * self.acceleration(start, torque)


class PrincipalSolver(InertiaSolver):
    """ω̇₁ = k₁ ω₂ω₃ + τ₁/I₁ with k₁ = (I₂ − I₃)/I₁, and so on round: six products for a free body."""

    inertia: PrincipalInertia
    inverse: Vector
    coupling: Vector

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector:
        k1, k2, k3 = components(self.coupling)
        w1, w2, w3 = components(angular_velocity)
        free = (k1 * (w2 * w3), k2 * (w3 * w1), k3 * (w1 * w2))
        if torque is None:
            return stack(*free)
        return stack(
            *(f + i * t for f, i, t in zip(free, components(self.inverse), components(torque), strict=True))
        )

    def inverted(self) -> Inertia:
        return PrincipalInertia(self.inverse)

    def response(self, torque: Vector) -> Vector:
        return stack(*(i * t for i, t in zip(components(self.inverse), components(torque), strict=True)))

    def inverse_invariants(self) -> tuple[Scalar, Scalar, Scalar]:
        p, q, r = components(self.inverse)
        return p + q + r, p * q + q * r + r * p, p * q * r

    def implicit_velocity(self, start, guess, torque, span, sweeps):
        # The same Newton steps without the products by zero of the general matrix: a third of the time.
        k1, k2, k3 = (span * k for k in components(self.coupling))
        base = start if torque is None else start + span * self.inverse * torque
        b1, b2, b3 = components(base)
        omega = guess
        for _ in range(sweeps):
            w1, w2, w3 = components(omega)
            residual = stack(w1 - b1 - k1 * w2 * w3, w2 - b2 - k2 * w3 * w1, w3 - b3 - k3 * w1 * w2)
            one = jnp.ones_like(w1)
            columns = (
                stack(one, -k2 * w3, -k3 * w2),
                stack(-k1 * w3, one, -k3 * w1),
                stack(-k1 * w2, -k2 * w1, one),
            )
            omega = omega - solve(columns, residual)
        return omega


class FullSolver(InertiaSolver):
    """ω̇ = I⁻¹ (Iω × ω + τ); the inverse is formed once: solving at each stage costs 129 ns a body-step, not 36."""

    inertia: FullInertia
    inverse: Array

    def acceleration(self, angular_velocity: Vector, torque: Vector | None) -> Vector:
        net = cross(self.inertia.apply(angular_velocity), angular_velocity)
        return self.response(net if torque is None else net + torque)

    def inverted(self) -> Inertia:
        return FullInertia(self.inverse)

    def response(self, torque: Vector) -> Vector:
        return symmetric_apply(self.inverse, torque)

    def inverse_invariants(self) -> tuple[Scalar, Scalar, Scalar]:
        xx, yy, zz, xy, xz, yz = components(self.inverse)
        minor = yy * zz - yz * yz
        others = xx * yy - xy * xy + (xx * zz - xz * xz)
        return xx + yy + zz, minor + others, xx * minor - xy * (xy * zz - xz * yz) + xz * (xy * yz - xz * yy)
