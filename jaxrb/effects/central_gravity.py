"""Gravity that falls off with distance: of a fixed centre, its torque, and of the bodies on each other."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.checks import quantity
from jaxrb.effects.effect import Effect, Force, Wrench, check_shapes
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.safe import norm
from jaxrb.math.vector import cross, dot

EARTH = 3.986004418e14  # μ = G M of the Earth [m³/s²] (IERS Conventions 2010, table 1.1)


class CentralGravity(Force):
    """F = −μ m d/|d|³ towards a fixed point, d from it to the body. The potential energy is −μ m/|d|.

    `parameter` μ = G M [m³/s²], by default the Earth's; `center` (3,) [m] in the world frame. A body in the centre
    itself is at a singularity: the run stops being finite there, and says so.
    """

    parameter: Scalar = quantity((), nonnegative=True, unit="m³/s²", default=EARTH)
    center: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        away = state.position - self.center
        return Wrench(force=(-self.parameter * body.mass / norm(away) ** 3) * away)

    def potential_energy(self, body: MassProperties, state: State) -> Scalar:
        return -self.parameter * body.mass / norm(state.position - self.center)

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        return _orbital_rate(self, state)


class GravityGradient(Force):
    """τ = 3 μ/|d|⁵ d × I d: the torque of a central field on a body whose parts are not all equally far from it.

    To first order in the size of the body over the distance d (Hughes 1986, "Spacecraft Attitude Dynamics", section
    8.1). Fields as of `CentralGravity`; the force is that effect's. The potential energy is what turning changes,
    ½ μ/|d|³ (3 u·I u − tr I), u the direction of d in the body frame.
    """

    parameter: Scalar = quantity((), nonnegative=True, unit="m³/s²", default=EARTH)
    center: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        away = state.position - self.center
        seen = state.orientation.unrotate(away)
        return Wrench(torque=(3.0 * self.parameter / norm(away) ** 5) * cross(seen, body.inertia.apply(seen)))

    def potential_energy(self, body: MassProperties, state: State) -> Scalar:
        away = state.position - self.center
        seen = state.orientation.unrotate(away) / norm(away)
        along = dot(seen, body.inertia.apply(seen))
        return 0.5 * self.parameter / norm(away) ** 3 * (3.0 * along - body.inertia.trace())

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        return 2.0 * _orbital_rate(self, state)


class MutualGravity(Effect):
    """F = −G m₁ m₂ d/|d|³ between every two bodies, as point masses. `constant` G [m³/(kg s²)] (CODATA 2018).

    All pairs in one sum: the cost grows with the square of the number of bodies. Two bodies in one place are at a
    singularity: the run stops being finite there, and says so.
    """

    constant: Scalar = quantity((), nonnegative=True, unit="m³/(kg s²)", default=6.67430e-11)

    def check(self, count: int) -> None:
        check_shapes(self, 1, "all bodies", "one value")

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        with jax.named_scope("MutualGravity"):
            line, inverse = _separations(state)
            pull = self.constant * bodies.mass[:, None] * bodies.mass * inverse**3
            return Wrench(force=jnp.sum(pull[..., None] * line, axis=1))

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar:
        _, inverse = _separations(state)
        return -0.5 * self.constant * jnp.sum(bodies.mass[:, None] * bodies.mass * inverse)

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        place, mass = np.asarray(state.position, float), np.asarray(bodies.mass, float)
        apart = np.linalg.norm(place - place[:, None], axis=-1) + np.diag(np.full(len(place), np.inf))
        with np.errstate(divide="ignore"):
            rate = np.sqrt(np.max(2.0 * np.asarray(self.constant) * (mass + mass[:, None]) / apart**3))
        return float(rate)


def _separations(state: State) -> tuple[Vector, Scalar]:
    """From each body to each (n, n, 3) [m], and the inverse distances (n, n) [1/m], zero from a body to itself."""
    line = state.position - state.position[:, None]
    itself = jnp.eye(line.shape[0], dtype=bool)
    # Where-safe: the distance of a body from itself has no derivative, and must not enter even as an unused branch.
    return line, jnp.where(itself, 0.0, 1.0 / norm(jnp.where(itself[..., None], 1.0, line)))


def _orbital_rate(effect: CentralGravity | GravityGradient, state: State) -> np.ndarray | float:
    place = np.asarray(state.position, float)
    if effect.bodies is not None:
        place = place[np.asarray(effect.bodies)]
    apart = np.linalg.norm(place - np.asarray(effect.center), axis=-1)
    with np.errstate(divide="ignore"):
        return np.sqrt(2.0 * np.asarray(effect.parameter) / apart**3).max()
