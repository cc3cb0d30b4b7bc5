"""Compliant contact: bodies sink into each other a little and are pushed apart by a force of the depth."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, count_of
from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.checks import is_concrete, quantities, quantity
from jaxrb.effects.effect import Effect, Wrench, check_indices
from jaxrb.effects.surfaces import Kind, kinds_of, obstacles_of, placed, standing
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.geometry.primitives import Pose
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.vector import cross, dot

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

    * `against`: a `Shape`, a pair (shape, `Pose`), or several of these, at rest in the world; None: the bodies meet
      each other. Both may stand in a scene, with numbers of their own.
    * `stiffness` k [N/mⁿ] of one point: a box on its face has four. `exponent` n, at least 1: 1 a linear spring, 1.5
      two balls (Hertz). `dissipation` c [s/m] and `friction` μ [1]: None is not in the program.
    * `slip_speed` s₀ [m/s]: the smaller, the stiffer the equations, with a rate of μ g/s₀ for a body that rests.
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
            still = [_Still(k, members, *item) for item in self.against for k, members in own]
            return _Touching(self, tuple(kinds), tuple(still), ())
        pairs = []
        for at, (k, members) in enumerate(own):
            for other, others in own[at:]:
                met = tuple((i, j) for i in members for j in others if i < j or k != other)
                pairs += [((k, other), met)] if met else []
        return _Touching(self, tuple(kinds), (), tuple(pairs))

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
        return float(np.max(rates))


class _Still(eqx.Module):
    """Bodies of one kind against one shape that stands still."""

    kind: int = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)
    shape: Shape
    pose: Pose | None


class _Touching(Effect):
    """A law of contact with the shapes on which it acts. `pairs`: two kinds, and all pairs of their bodies."""

    law: CompliantContact
    kinds: tuple[Kind, ...]
    still: tuple[_Still, ...]
    pairs: tuple[tuple[tuple[int, int], tuple[tuple[int, int], ...]], ...] = eqx.field(static=True)

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        with jax.named_scope("CompliantContact"):
            force, turning = jnp.zeros_like(state.position), jnp.zeros_like(state.position)
            spin = state.orientation.rotate(state.angular_velocity)

            def lever(body: np.ndarray, points: Any) -> Vector:
                return points.position - state.position[body][:, None]

            def velocity(body: np.ndarray, points: Any) -> Vector:
                return state.velocity[body][:, None] + cross(spin[body][:, None], lever(body, points))

            for points, first, second in self._points(state):
                relative = velocity(second, points)
                if first is not None:
                    relative = relative - velocity(first, points)
                push = self._force(points, relative)
                for body, sign in ((second, 1.0), (first, -1.0)):
                    if body is not None:
                        force = force.at[body].add(sign * jnp.sum(push, axis=1))
                        turning = turning.at[body].add(
                            sign * jnp.sum(cross(lever(body, points), push), axis=1)
                        )
            return Wrench(force, state.orientation.unrotate(turning))

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar:
        depths = [_depth(points) for points, _, _ in self._points(state)]
        return sum((jnp.sum(self.law.stored_energy(depth)) for depth in depths), jnp.zeros((), state.dtype))

    def _points(self, state: State) -> Iterator[tuple[Any, np.ndarray | None, np.ndarray]]:
        """The points of each group (k, s), and the bodies from which and to which their normals point."""
        from jaxrb.collision.touch import contact_points  # only scenes with contact load the collision floor

        for one in self.still:
            kind, members = self.kinds[one.kind], np.asarray(one.members, np.int32)
            shape, pose = placed(kind, kind.rows(members), state, members)
            still = standing(one.pose, state)
            yield jax.vmap(contact_points, (None, None, 0, 0))(one.shape, still, shape, pose), None, members
        for numbers, met in self.pairs:
            sides = np.asarray(met, np.int32).T
            both = [self.kinds[k] for k in numbers]
            given = [
                placed(kind, kind.rows(side), state, side) for kind, side in zip(both, sides, strict=True)
            ]
            yield jax.vmap(contact_points)(*given[0], *given[1]), sides[0], sides[1]

    def _force(self, points: Any, relative: Vector) -> Vector:
        """The force (k, s, 3) [N] on the second bodies, which move with `relative` (k, s, 3) past the first."""
        normal = jnp.broadcast_to(points.normal[:, None], relative.shape)
        along = dot(relative, normal)
        pressing = self.law.normal_force(_depth(points), -along)
        push = pressing[..., None] * normal
        if self.law.friction is None:
            return push
        return push + self.law.friction_force(pressing, relative - along[..., None] * normal)


def _depth(points: Any) -> Scalar:
    return jnp.where(points.valid, -points.distance, 0.0)


def _power(base: Scalar, exponent: Scalar) -> Scalar:
    """base^exponent where base is positive, else zero with zero derivatives."""
    positive = base > 0
    return jnp.where(positive, jnp.where(positive, base, 1.0) ** exponent, 0.0)
