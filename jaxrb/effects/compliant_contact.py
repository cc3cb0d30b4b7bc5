"""Compliant contact: bodies sink into each other a little and are pushed apart by a force of the depth."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, count_of
from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.body.validity import inertia_matrix
from jaxrb.checks import is_concrete, quantities, quantity
from jaxrb.effects.compliant_touching import Still, Touching
from jaxrb.effects.effect import Effect, Wrench, check_indices
from jaxrb.effects.surfaces import kinds_of, obstacles_of
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.vector import dot

# A corner of a solid yields at most about so many times as easily as the body as a whole: box and rod 4, disc 5.
_CORNER = 4.0
# A rate must be named before anybody knows how hard bodies will meet: at no less than this speed [m/s], and friction
# under the weight that bodies have at this acceleration [m/s²].
_LEAST_SPEED, _WEIGHT = 1.0, 9.81


class CompliantContact(Effect):
    """Contact as a force, for every stepping method and for `rb.solve`: what bodies do in it is an ordinary flight.

    At each point of contact of depth δ [m], deepening at v = δ̇ [m/s], the normal force is

        F = k δⁿ (1 + 3/2 c v), never less than zero

    (Hunt and Crossley 1975, "Coefficient of restitution interpreted as damping in vibroimpact", J. Appl. Mech. 42,
    440). Blows at small speed u come back with 1 − c u of it, whatever k, n and the mass. Friction against the sliding
    velocity s is −μ F s/√(s² + s₀²): Coulomb's with its corner rounded, so that every derivative exists. It does not
    hold bodies still: under a load below μ F they creep, at less than about s₀.

    A contact that is a small patch also resists turning: a torque −b F ω/√(ω² + ω₀²) against the relative angular
    velocity, across the normal (rolling) and about it (spinning), with a length b [m] for each (Johnson 1985, "Contact
    mechanics", sections 8.5 and 9.2). A solid ball that rolls slows down by 5/7 g b/r.

    * `against`: a `Shape`, a pair (shape, `Pose`), or several of these, at rest in the world; None: the bodies meet
      each other. Both may stand in a scene, with numbers of their own.
    * `stiffness` k [N/mⁿ] of one point: a box on its face has four. `exponent` n, at least 1: 1 a linear spring, 1.5
      two balls (Hertz). `dissipation` c [s/m] and `friction` μ [1]: None is not in the program.
    * `slip_speed` s₀ [m/s]: the smaller, the stiffer the equations, with a rate of μ g/s₀ for a body that rests.
    * `rolling_resistance`, `spinning_resistance` b [m], None is not in the program; `turn_speed` ω₀ [rad/s].
    * `bodies`: those that take part, None all.

    Every pair of bodies that take part is looked at in every evaluation: for crowds take `RigidContact`. The potential
    energy is Σ k δⁿ⁺¹/(n + 1). Points are those of `contact_points`: closed forms for half-spaces with all shapes and
    for spheres, capsules and boxes. Where faces meet, points move along the faces as the bodies turn, so that energy
    is kept there only as far as depths are small beside the faces.
    """

    against: Any = None
    stiffness: Scalar = quantity((), positive=True, unit="N/mⁿ", kw_only=True)
    exponent: Scalar = quantity((), positive=True, default=1.5, kw_only=True)
    dissipation: Scalar | None = quantity((), nonnegative=True, unit="s/m", default=None, kw_only=True)
    friction: Scalar | None = quantity((), nonnegative=True, default=None, kw_only=True)
    slip_speed: Scalar = quantity((), positive=True, unit="m/s", default=1e-3, kw_only=True)
    rolling_resistance: Scalar | None = quantity((), nonnegative=True, unit="m", default=None, kw_only=True)
    spinning_resistance: Scalar | None = quantity((), nonnegative=True, unit="m", default=None, kw_only=True)
    turn_speed: Scalar = quantity((), positive=True, unit="rad/s", default=1e-2, kw_only=True)
    bodies: tuple[int, ...] | None = eqx.field(static=True, default=None, kw_only=True)

    def __post_init__(self):
        super().__post_init__()
        self.against = obstacles_of("CompliantContact", self.against)
        if is_concrete(self.exponent) and (np.asarray(self.exponent) < 1).any():
            raise InvalidInput(
                f"CompliantContact.exponent is {self.exponent}, but must be at least 1: the force of a smaller one "
                "has no derivative at touch"
            )

    def check(self, count: int) -> None:
        for field in quantities(type(self)):
            value = getattr(self, field.name)
            if value is not None and np.ndim(value):
                raise WrongStructure(
                    f"CompliantContact.{field.name}: shape {np.shape(value)}; give one number for all contacts, and "
                    "several effects for several materials"
                )
        if self.bodies is not None:
            check_indices("CompliantContact", "bodies", self.bodies, count)

    def with_shapes(self, bodies: tuple[Body, ...]) -> Effect:
        count = sum(count_of(body) or 1 for body in bodies)
        chosen = set(range(count) if self.bodies is None else self.bodies)
        kinds = kinds_of("CompliantContact", bodies, chosen)
        own = [(k, tuple(m for m in kind.members if m in chosen)) for k, kind in enumerate(kinds)]
        if self.against is not None:
            still = [Still(k, members, *item) for item in self.against for k, members in own]
            return Touching(self, tuple(kinds), tuple(still), ())
        pairs = []
        for at, (k, members) in enumerate(own):
            for other, others in own[at:]:
                met = tuple((i, j) for i in members for j in others if i < j or k != other)
                pairs += [((k, other), met)] if met else []
        return Touching(self, tuple(kinds), (), tuple(pairs))

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        raise WrongStructure(
            "CompliantContact: its force depends on the bodies' shapes; ask scene.prepared(dtype)"
        )

    def normal_force(self, depth: Scalar, deepening: Scalar) -> Scalar:
        """F [N] at a depth [m] that grows at `deepening` [m/s]; zero where the depth is not positive."""
        spring = self.stiffness * _power(depth, self.exponent)
        if self.dissipation is None:
            return spring
        return spring * jnp.maximum(1.0 + 1.5 * self.dissipation * deepening, 0.0)

    def stored_energy(self, depth: Scalar) -> Scalar:
        """What the spring holds [J] at a depth [m]."""
        return self.stiffness / (self.exponent + 1.0) * _power(depth, self.exponent + 1.0)

    def friction_force(self, pressing: Scalar, sliding: Vector) -> Vector:
        """The force (..., 3) [N] against a sliding velocity (..., 3) [m/s] across the normal."""
        assert self.friction is not None
        smooth = jnp.sqrt(dot(sliding, sliding) + self.slip_speed**2)
        return -(self.friction * pressing / smooth)[..., None] * sliding

    @property
    def resists_turning(self) -> bool:
        """Whether there is a torque beside the force."""
        return self.rolling_resistance is not None or self.spinning_resistance is not None

    def turning_torque(self, pressing: Scalar, spin: Vector, normal: Vector) -> Vector:
        """The torque (..., 3) [N m] against a relative angular velocity (..., 3) [rad/s]."""
        about = dot(spin, normal)[..., None] * normal
        total = jnp.zeros_like(spin)
        for length, part in ((self.rolling_resistance, spin - about), (self.spinning_resistance, about)):
            if length is not None:
                smooth = jnp.sqrt(dot(part, part) + self.turn_speed**2)
                total = total - (length * pressing / smooth)[..., None] * part
        return total

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        """The fastest of spring, dissipation and friction at a corner, for bodies that meet as fast as they move."""
        numbers = None if self.bodies is None else np.asarray(self.bodies)
        mass, velocity = np.asarray(bodies.mass, float), np.asarray(state.velocity, float)
        mass, velocity = (mass, velocity) if numbers is None else (mass[numbers], velocity[numbers])
        k, n = float(self.stiffness), float(self.exponent)
        speed = max(_LEAST_SPEED, float(np.linalg.norm(velocity, axis=-1).max(initial=0.0)))
        inverse = 1.0 / mass
        if self.against is None:  # both yield, and both may come
            inverse, speed = inverse + 1.0 / mass.min(), 2.0 * speed
        depth = (0.5 * (n + 1.0) * speed**2 / (inverse * k)) ** (1.0 / (n + 1.0))
        rates = [np.sqrt(_CORNER * n * k * depth ** (n - 1.0) * inverse)]
        if self.dissipation is not None:
            rates.append(_CORNER * 1.5 * float(self.dissipation) * k * depth**n * inverse)
        if self.friction is not None:
            rates.append(_CORNER * float(self.friction) * _WEIGHT / float(self.slip_speed) * mass * inverse)
        if self.resists_turning:
            length = max(
                float(b) for b in (self.rolling_resistance, self.spinning_resistance) if b is not None
            )
            moments = np.linalg.eigvalsh(np.asarray(inertia_matrix(bodies.inertia), float))[..., 0]
            least = (moments if numbers is None else moments[numbers]).min(initial=np.inf, where=moments > 0)
            rates.append(length * _WEIGHT / float(self.turn_speed) * mass / least)
        return float(np.max(rates))


def _power(base: Scalar, exponent: Scalar) -> Scalar:
    """base^exponent where base is positive, else zero with zero derivatives."""
    positive = base > 0
    return jnp.where(positive, jnp.where(positive, base, 1.0) ** exponent, 0.0)
