"""What the joints have in common: which bodies they hold, and what acts along their coordinate."""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.body.validity import inertia_matrix
from jaxrb.effects.effect import Effect, Wrench, check_indices, check_shapes
from jaxrb.errors import WrongStructure
from jaxrb.joints.drives import Drive
from jaxrb.joints.rows import Place, Rows, places
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.math.safe import unit_or


class Joint(Effect):
    """A joint, or several of one kind, between body a and body b; b = None is the world.

    `bodies` = (a, b) are body numbers of the scene; for several joints in one value, tuples of numbers, and numbers
    with a leading axis over the joints: the program is then no larger than that of one. The forces of a joint do no
    work. They are solved for at each evaluation of a method, so that a method keeps its order, and after each step
    positions and velocities are projected onto the joints, so that nothing drifts.
    """

    joins: ClassVar[bool] = True
    free: ClassVar[str | None] = None  # unit of the free coordinate, None where there is none to speak of

    bodies: tuple[Any, Any] = eqx.field(static=True, kw_only=True)

    def __post_init__(self):
        super().__post_init__()
        given = self.bodies
        if not isinstance(given, (tuple, list)) or len(given) != 2:
            raise WrongStructure(
                f"{type(self).__name__}.bodies: {given!r}; give two body numbers (a, b), or (a, None) for a joint "
                "to the world; for several joints ((a0, a1, …), (b0, b1, …))"
            )
        a, b = (tuple(side) if isinstance(side, list) else side for side in given)
        self.bodies = (a, b)
        for drive in self.drives:
            if self.free is None or not isinstance(drive, Drive):
                mend = (
                    "it has no one coordinate to drive"
                    if self.free is None
                    else "give JointSpring(…) or another"
                )
                raise WrongStructure(f"{type(self).__name__}.drives: {drive!r}; {mend}")

    @property
    def drives(self) -> tuple[Drive, ...]:
        """What acts along the coordinate."""
        return ()

    @property
    def count(self) -> int:
        """How many joints the value holds."""
        return len(_numbers(self.bodies[0]))

    @property
    def members(self) -> tuple[int, ...]:
        """Numbers of the bodies that it holds, the world left out."""
        return (*_numbers(self.bodies[0]), *_numbers(self.bodies[1]))

    def check(self, count: int) -> None:
        name = type(self).__name__
        a, b = _numbers(self.bodies[0]), _numbers(self.bodies[1])
        check_indices(name, "bodies[0]", a, count)
        check_indices(name, "bodies[1]", b, count)
        if not a or (self.bodies[1] is not None and len(a) != len(b)):
            raise WrongStructure(
                f"{name}.bodies: {a} and {b} must name equally many bodies, at least one each"
            )
        for one, other in zip(a, b):
            if one == other:
                raise WrongStructure(f"{name}.bodies: body {one} cannot be joined to itself")
        for part in (self, *self.drives):
            check_shapes(part, self.count, "all joints", "one value a joint")  # type: ignore[arg-type]

    def pairs(self, world: int) -> np.ndarray:
        """(k, 2): the bodies of each joint, with the number `world` for the world."""
        a, b = _numbers(self.bodies[0]), _numbers(self.bodies[1])
        return np.stack([np.asarray(a, np.int32), np.asarray(b or len(a) * [world], np.int32)], axis=1)

    def parts(self, world: int) -> list[tuple[Any, np.ndarray]]:
        """The rows that hold the joints, by kind (`rows.py`), and of each row which joint of the value it is of."""
        raise NotImplementedError

    def misfit(self, a: Place, b: Place) -> tuple[Scalar, Scalar]:
        """How far each joint is open: the gap (k,) [m] and the angle (k,) [rad] that should both be zero."""
        raise NotImplementedError

    def coordinate(self, state: State) -> Scalar:
        """The free coordinate of each joint: angle [rad] or travel [m]; () for one joint, (k,) for several."""
        return self._shaped(self._coordinate(state).value)

    def coordinate_rate(self, state: State) -> Scalar:
        """Its time derivative [rad/s or m/s]."""
        row = self._coordinate(state)
        return self._shaped(self._rate(row, state))

    def coordinate_rows(self, a: Place, b: Place) -> Rows:
        """The coordinate as rows; their `bias` is not formed."""
        raise WrongStructure(f"{type(self).__name__} has no one coordinate; look at the state of its bodies")

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        if not self.drives:
            return Wrench()
        with jax.named_scope(type(self).__name__):
            row = self._coordinate(state)
            rate = self._rate(row, state)
            count = state.position.shape[0]
            push = sum(drive.effort(row.value, rate) for drive in self.drives)
            return Wrench(*row.pushed(self.pairs(count), count, jnp.broadcast_to(push, rate.shape)))

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar | None:
        if not self.drives:
            return None
        x = self._coordinate(state).value
        energies = [energy for drive in self.drives if (energy := drive.energy(x)) is not None]
        return sum((jnp.sum(energy) for energy in energies[1:]), jnp.sum(energies[0])) if energies else None

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        if not self.drives:
            return 0.0
        inverse = self._inverse_inertia(bodies)
        return max(float(np.max(drive.fastest(inverse))) for drive in self.drives)

    def spread(self, value: Vector) -> Vector:
        """One value a joint, (k, …)."""
        value = jnp.asarray(value)
        core = 1 if value.ndim and value.shape[-1:] == (3,) else 0
        return jnp.broadcast_to(value, (self.count, *value.shape[value.ndim - core :]))

    def _inverse_inertia(self, bodies: MassProperties) -> np.ndarray:
        """Against motion along the coordinate, of the two bodies by themselves: an upper bound."""
        a, b = _numbers(self.bodies[0]), _numbers(self.bodies[1])
        if self.free == "m":
            own = 1.0 / np.asarray(bodies.mass, float)
        else:
            matrix = np.asarray(inertia_matrix(bodies.inertia), float)
            axis = np.broadcast_to(np.asarray(self.axis, float), (len(a), 3))  # type: ignore[attr-defined]
            in_b = np.asarray(resting(self.rest, None).rotate(jnp.asarray(axis)), float)  # type: ignore[attr-defined]
            return _inverse_about(matrix[list(a)], axis) + (
                _inverse_about(matrix[list(b)], in_b) if b else 0.0
            )
        return own[np.asarray(a)] + (own[np.asarray(b)] if b else 0.0)

    def _coordinate(self, state: State) -> Rows:
        return self.coordinate_rows(*places(state, self.pairs(state.position.shape[0])))

    def _rate(self, row: Rows, state: State) -> Scalar:
        count = state.position.shape[0]
        still = jnp.zeros((1, 3), state.dtype)
        velocity, omega = (
            jnp.concatenate([part, still]) for part in (state.velocity, state.angular_velocity)
        )
        return row.rate(self.pairs(count), velocity, omega)

    def _shaped(self, values: Scalar) -> Scalar:
        return values if isinstance(self.bodies[0], tuple) else values[0]


def _inverse_about(inertia: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """1/(n·I n) (k,) of inertias (k, 3, 3) about axes (k, 3); 0 for points."""
    n = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    moment = np.einsum("ki,kij,kj->k", n, inertia, n)
    return np.where(moment > 0, 1.0 / np.where(moment > 0, moment, 1.0), 0.0)


def _numbers(bodies: Any) -> tuple[int, ...]:
    if bodies is None:
        return ()
    return bodies if isinstance(bodies, tuple) else (bodies,)


def resting(rest: Rotation | None, dtype: Any) -> Quaternion:
    """The attitude of a at rest as seen from b, (…, 4)."""
    if rest is None:
        return Quaternion.identity(dtype)
    return Quaternion.from_rotation(rest)


def basis_about(axis: Vector) -> tuple[Vector, Vector, Vector]:
    """The unit vector along `axis` (k, 3) and two across it, right-handed."""
    n = unit_or(axis, jnp.zeros_like(axis))
    # The world axis that is most across: whichever is chosen, the plane that the two span is the same.
    most_across = jnp.argmin(jnp.abs(n), axis=-1)
    helper = jax.nn.one_hot(most_across, 3, dtype=n.dtype)
    first = jnp.cross(n, helper)
    first = unit_or(first, jnp.zeros_like(first))
    return n, first, jnp.cross(n, first)


def in_turn(per_joint: Sequence[Vector]) -> Vector:
    """Several vectors a joint (k, 3) each as rows (k · m, 3), joint by joint."""
    return jnp.stack(per_joint, axis=1).reshape(-1, 3)
