"""One contact problem: bodies as the step without contact leaves them, and the points where they touch."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxrb.body.state import State
from jaxrb.contact.block import Contacts
from jaxrb.contact.law import Bounds, predicted, projected
from jaxrb.contact.linear import multiplied
from jaxrb.contact.resistance import with_last
from jaxrb.math.arrays import Array, Scalar, Vector, components, stack
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.rotation import Rotation
from jaxrb.math.vector import matvec


class Problem(eqx.Module):
    """Find the motion u (n, 6) = (v, ω) in W and impulses λ with M (u − free) = Jᵀ λ and the law at each point.

    `mass` (n,), `inertia` (n, 3, 3) about the centre in W, and their inverses; `free` (n, 6) the motion without
    contact; `bias` (k, s) [m/s] the least normal velocity of each point; `tolerance` [1] of the answer, relative to the
    largest velocity that contact takes away. With `joints` M⁻¹ is that of bodies that hang together, and u changes only
    as the joints let it. Of bodies that are not free `allowed` (n, 6, 6) projects on what they can do; only that is in
    the inverses.
    """

    contacts: Contacts
    bias: Scalar
    mass: Scalar
    inertia: Array
    inverse_mass: Scalar
    inverse_inertia: Array
    free: Array
    tolerance: Scalar
    joints: Any = None  # `JointReactions`, which only scenes with joints load
    allowed: Any = None  # `contact/held.py`; None where every body is free

    def momentum(self, motion: Array) -> Array:
        """M u (n, 6)."""
        return _applied(self.mass, self.inertia, motion)

    def response(self, impulse: Array) -> Array:
        """M⁻¹ p (n, 6)."""
        return _applied(self.inverse_mass, self.inverse_inertia, self.borne(impulse))

    def borne(self, impulse: Array) -> Array:
        """What the bodies feel (n, 6) of impulses on them: with what guides and joints make of them."""
        impulse = self.kept(impulse)
        return impulse if self.joints is None else self.joints.borne(impulse)

    def kept(self, impulse: Array) -> Array:
        """What guides leave (n, 6) of impulses on the bodies."""
        return impulse if self.allowed is None else multiplied(self.allowed, impulse)

    def on_bodies(self, impulse: Vector) -> Array:
        """What guides leave (n, 6) of impulses (k, s, 3) at the points."""
        return self.kept(self.contacts.impulse_on_bodies(impulse))

    def blocks(self, bend: Array) -> Array:
        """Each body's own part (n, 6, 6) of M + Jᵀ G J, with G (k, s, 3, 3)."""
        pushed = self.contacts.blocks(bend)
        if self.allowed is not None:
            pushed = self.allowed @ pushed @ self.allowed
        return of_masses(self.mass, self.inertia) + pushed

    def felt(self, impulse: Array) -> Scalar:
        """The largest velocity [m/s] that impulses on the bodies (n, 6) give to a body's centre or to a point."""
        given = self.response(impulse)
        at_points = jnp.sum(self.contacts.relative_velocity(given) ** 2, axis=-1)
        at_centers = jnp.sum(given[:, :3] ** 2, axis=-1)
        most = jnp.max(jnp.where(self.contacts.active, at_points, 0.0), initial=0.0)
        return jnp.sqrt(jnp.maximum(most, jnp.max(at_centers, initial=0.0)))

    def moved_by(self, impulse: Vector) -> Array:
        """The motion (n, 6) after impulses (k, s, 3)."""
        return self.free + self.response(self.contacts.impulse_on_bodies(impulse))

    def wanted(self, impulse: Vector, velocity: Vector, stiffness: Scalar) -> Vector:
        """The impulses that the law projects (k, s, 3)."""
        return predicted(impulse, velocity, self.bias, self.contacts.normal[:, None], stiffness)

    def bounds(self, impulse: Vector) -> Bounds:
        """Of impulses (k, s, 3), by how hard `impulse` presses."""
        c = self.contacts
        if c.friction is None and c.resistance is None:
            return Bounds(None)
        pressing = jnp.maximum(jnp.sum(impulse * c.normal[:, None], axis=-1), 0.0)
        across = None if c.friction is None else c.friction[:, None] * pressing
        if c.resistance is None:
            return Bounds(across)
        rolling, spinning = c.resistance.bounds(jnp.sum(pressing[:, :-1], axis=1))
        none = jnp.zeros_like(pressing)
        return Bounds(
            with_last(none if across is None else across, rolling),
            with_last(none, -spinning),
            with_last(jnp.full_like(pressing, jnp.inf), spinning),
        )

    def projected(self, wanted: Vector, bounds: Bounds) -> Vector:
        """The impulses that the law allows."""
        return projected(wanted, self.contacts.normal[:, None], bounds)

    def stiffness(self, compliance: float) -> Scalar:
        """1/R (k, s) [kg] of compliance R = `compliance` · effective inverse mass of the point; 0 where inactive."""
        c = self.contacts
        six = jnp.concatenate([self.inverse_mass[:, None], self.inverse_inertia.reshape(-1, 9)], axis=1)
        pushed, back = c.incidence.take(six)
        mobility = _mobility(pushed, c.lever)
        if back is not None and c.lever_back is not None:
            mobility = mobility.at[c.lone :].add(_mobility(back, c.lever_back))
        if c.resistance is not None:
            mobility = with_last(mobility, self._turned(pushed, back))
        return jnp.where(c.active, 1.0 / jnp.where(c.active, compliance * mobility, 1.0), 0.0)

    def _turned(self, pushed: Array, back: Array | None) -> Scalar:
        """`_mobility` of the couples (k,)."""
        c = self.contacts
        answer = jnp.trace(pushed[:, 1:].reshape(-1, 3, 3), axis1=1, axis2=2)
        if back is not None:
            answer = answer.at[c.lone :].add(jnp.trace(back[:, 1:].reshape(-1, 3, 3), axis1=1, axis2=2))
        assert c.resistance is not None
        return c.resistance.arm**2 * answer / 3


def of_masses(mass: Scalar, inertia: Array) -> Array:
    """Matrices (n, 6, 6) of masses (n,) and inertias (n, 3, 3), or of the inverses of both."""
    straight = mass[:, None, None] * jnp.eye(3, dtype=inertia.dtype)
    none = jnp.zeros_like(straight)
    rows = [jnp.concatenate(row, axis=2) for row in ((straight, none), (none, inertia))]
    return jnp.concatenate(rows, axis=1)


def motion_of(state: State) -> Array:
    """(v, ω) (n, 6) in W."""
    return jnp.concatenate([state.velocity, state.orientation.rotate(state.angular_velocity)], axis=1)


def world_inertia(dynamics: Any, orientation: Rotation) -> tuple[Array, Array]:
    """Inertias [kg m²] about the centres and their inverses (n, 3, 3), in W, of bodies turned by R_WB (n, …)."""
    turned = RotationMatrix.from_rotation(orientation)
    return (
        dynamics.inertia.inertia.rotated(turned).as_matrix(),
        dynamics.inertia.inverted().rotated(turned).as_matrix(),
    )


def _applied(scale: Scalar, tensor: Array, motion: Array) -> Array:
    v1, v2, v3, w1, w2, w3 = components(motion)
    return stack(scale * v1, scale * v2, scale * v3, *components(matvec(tensor, stack(w1, w2, w3))))


def _mobility(inverse: Array, lever: Vector) -> Scalar:
    """A third of the trace of J M⁻¹ Jᵀ (k, s) [1/kg]: by how much an impulse at the point moves it, on the mean.

    1/m + (tr(I⁻¹) r² − r · I⁻¹ r)/3.
    """
    mass, xx, xy, xz, _, yy, yz, _, _, zz = (part[:, None] for part in components(inverse))
    x, y, z = components(lever)
    turning = (yy + zz) * x * x + (xx + zz) * y * y + (xx + yy) * z * z
    return mass + (turning - 2 * (xy * x * y + xz * x * z + yz * y * z)) / 3
