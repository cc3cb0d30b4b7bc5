"""One contact problem: bodies as the step without contact leaves them, and the points where they touch."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxrb.body.inertia import symmetric_apply
from jaxrb.contact.block import Contacts
from jaxrb.contact.law import predicted, projected
from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.vector import dot


class Problem(eqx.Module):
    """Find the motion u (n, 6) = (v, ω) in W and impulses λ with M (u − free) = Jᵀ λ and the law at each point.

    `mass` (n,), `inertia` (n, 6) about the centre in W (xx, yy, zz, xy, xz, yz), and their inverses; `free` (n, 6) the
    motion without contact; `bias` (k, s) [m/s] the least normal velocity of each point; `tolerance` [1] of the answer,
    relative to the largest velocity that contact takes away.
    """

    contacts: Contacts
    bias: Scalar
    mass: Scalar
    inertia: Array
    inverse_mass: Scalar
    inverse_inertia: Array
    free: Array
    tolerance: Scalar

    def momentum(self, motion: Array) -> Array:
        """M u (n, 6)."""
        return _applied(self.mass, self.inertia, motion)

    def response(self, impulse: Array) -> Array:
        """M⁻¹ p (n, 6)."""
        return _applied(self.inverse_mass, self.inverse_inertia, impulse)

    def moved_by(self, impulse: Vector) -> Array:
        """The motion (n, 6) after impulses (k, s, 3)."""
        return self.free + self.response(self.contacts.impulse_on_bodies(impulse))

    def wanted(self, impulse: Vector, velocity: Vector, stiffness: Scalar) -> Vector:
        """The impulses that the law projects (k, s, 3)."""
        return predicted(impulse, velocity, self.bias, self.contacts.normal[:, None], stiffness)

    def bound(self, impulse: Vector) -> Scalar | None:
        """μ λₙ (k, s); None without friction."""
        if self.contacts.friction is None:
            return None
        pressing = jnp.maximum(dot(impulse, self.contacts.normal[:, None]), 0.0)
        return self.contacts.friction[:, None] * pressing

    def projected(self, wanted: Vector, bound: Scalar | None) -> Vector:
        """The impulses that the law allows."""
        return projected(wanted, self.contacts.normal[:, None], bound)

    def stiffness(self, compliance: float) -> Scalar:
        """1/R (k, s) [kg] of compliance R = `compliance` · effective inverse mass of the point; 0 where inactive."""
        c = self.contacts
        pushed, back = c.incidence.take(
            jnp.concatenate([self.inverse_mass[:, None], self.inverse_inertia], axis=1)
        )
        mobility = _mobility(pushed, c.lever)
        if back is not None and c.lever_back is not None:
            mobility = mobility.at[len(c.incidence.lone) :].add(_mobility(back, c.lever_back))
        return jnp.where(c.active, 1.0 / jnp.where(c.active, compliance * mobility, 1.0), 0.0)


def _applied(scale: Scalar, six: Array, motion: Array) -> Array:
    v1, v2, v3, w1, w2, w3 = components(motion)
    turned = components(symmetric_apply(six, stack(w1, w2, w3)))
    return stack(scale * v1, scale * v2, scale * v3, *turned)


def _mobility(inverse: Array, lever: Vector) -> Any:
    """A third of the trace of the inverse mass (k, s) that a point feels: 1/m + (tr(I⁻¹) r² − r · I⁻¹ r)/3."""
    mass, *six = (part[:, None] for part in components(inverse))
    r = components(lever)
    xx, yy, zz, xy, xz, yz = six
    squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    along = (
        xx * r[0] * r[0] + yy * r[1] * r[1] + zz * r[2] * r[2]
        + 2 * (xy * r[0] * r[1] + xz * r[0] * r[2] + yz * r[1] * r[2])
    )  # fmt: skip
    return mass + ((xx + yy + zz) * squared - along) / 3
