"""What may act on bodies. A scene's effects are values in a tuple; what is not in it is not in the program."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import PER_BODY, State
from jaxrb.checks import Checked, quantities
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.vector import cross


class Wrench(eqx.Module):
    """Force (..., 3) [N] in the world frame at the centre of mass, and torque (..., 3) [N m] in the body frame.

    None is a force or torque that is zero by type: it costs nothing, since nothing is compiled for it.
    """

    force: Vector | None = None
    torque: Vector | None = None

    def __add__(self, other: Wrench) -> Wrench:
        return Wrench(add(self.force, other.force), add(self.torque, other.torque))

    @classmethod
    def at_point(cls, force: Vector, point: Vector, state: State) -> Wrench:
        """A world force applied at a body point given in the body frame."""
        return cls(force, cross(point, state.orientation.unrotate(force)))


def add(a: Vector | None, b: Vector | None) -> Vector | None:
    """a + b, where None is zero by type."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


class Effect(Checked):
    """Something that acts on the bodies of a scene."""

    joins: ClassVar[bool] = False  # a joint (`jaxrb/joints`, which only scenes that have one load)

    def check(self, count: int) -> None:
        """Refuse what does not fit a scene of `count` bodies."""

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        """The wrench on each body of the scene; arrays have the bodies axis."""
        return Wrench()

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar | None:
        """Total potential energy [J], None for an effect that has none."""
        return None

    def with_shapes(self, bodies: tuple[Any, ...]) -> Effect:
        """The effect as a run computes it: one that depends on the shapes of the scene's bodies takes them here."""
        return self

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        """Estimate on the host of the fastest rate [1/s] that this effect gives: an oscillation's ω, a decay's 1/τ.

        A step dt with dt · rate above the method's limit is unstable; the run warns.
        """
        return 0.0


class Force(Effect):
    """An effect on one body at a time. Subclasses define `wrench(body, state)` for one body, without a bodies axis.

    `bodies` names the bodies that it acts on by their numbers in the scene; None is all of them. Its own numbers hold
    for all, or carry a leading axis over those bodies.
    """

    bodies: tuple[int, ...] | None = eqx.field(static=True, default=None, kw_only=True)

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        """The wrench on one body."""
        raise NotImplementedError

    def potential_energy(self, body: MassProperties, state: State) -> Scalar | None:
        """Potential energy [J] of one body, None if there is none."""
        return None

    def check(self, count: int) -> None:
        self.check_bodies(count)
        check_shapes(
            self, count if self.bodies is None else len(self.bodies), "all bodies", "one value a body"
        )

    def check_bodies(self, count: int) -> None:
        """Refuse `bodies` that a scene of `count` bodies does not have, or that are named twice."""
        if self.bodies is None:
            return
        name = type(self).__name__
        check_indices(name, "bodies", self.bodies, count)
        twice = [i for i in self.bodies if self.bodies.count(i) > 1]
        if twice:
            raise WrongStructure(
                f"{name}.bodies: body {twice[0]} is named twice; name it once, or use two effects"
            )

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        with jax.named_scope(type(self).__name__):
            if self.bodies is None:
                return self._each(type(self).wrench, bodies, state)
            index = np.asarray(self.bodies)
            wrench = self._each(type(self).wrench, *taken((bodies, state), index))
            return scattered(wrench, index, state)

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar | None:
        if self.bodies is not None:
            bodies, state = taken((bodies, state), np.asarray(self.bodies))
        energies = self._each(type(self).potential_energy, bodies, state)
        return None if energies is None else jnp.sum(energies)

    def _each(self, function: Any, bodies: MassProperties, state: State) -> Any:
        return jax.vmap(function, in_axes=(self._axes(), 0, PER_BODY))(self, bodies, state)

    def _axes(self) -> Any:
        """Which of the effect's own numbers carry an axis over bodies."""
        ranks = {f.name: len(f.metadata["quantity"]["core"]) for f in quantities(type(self))}
        axes = jax.tree.map(lambda _: None, self)
        for name, rank in ranks.items():
            value = getattr(self, name)
            if value is not None and np.ndim(value) > rank:
                object.__setattr__(axes, name, 0)
        return axes


def taken(tree: Any, index: np.ndarray) -> Any:
    """The chosen bodies of arrays with a bodies axis; the time, a scalar, is kept."""
    return jax.tree.map(lambda leaf: leaf[index] if jnp.ndim(leaf) else leaf, tree)


def scattered(wrench: Wrench, index: np.ndarray, state: State) -> Wrench:
    """Wrenches of the chosen bodies, added up into arrays over all bodies."""

    def spread(part: Array) -> Array:
        return jnp.zeros((state.position.shape[0], 3), part.dtype).at[index].add(part)

    return jax.tree.map(spread, wrench)


def check_shapes(effect: Effect, count: int, all_of_them: str, one_each: str) -> None:
    """Refuse numbers whose leading axis does not run over the `count` things that the effect acts on."""
    for field in quantities(type(effect)):
        value, core = getattr(effect, field.name), field.metadata["quantity"]["core"]
        if value is None or np.ndim(value) == len(core):
            continue
        if np.shape(value) != (count, *core):
            raise WrongStructure(
                f"{type(effect).__name__}.{field.name}: shape {np.shape(value)}; give {core} for {all_of_them}, or "
                f"{(count, *core)} for {one_each}"
            )


def check_indices(owner: str, field: str, indices: tuple[int, ...], count: int) -> None:
    """Refuse body numbers that the scene does not have."""
    if not isinstance(indices, tuple) or not all(isinstance(i, (int, np.integer)) for i in indices):
        raise WrongStructure(f"{owner}.{field}: {indices!r}; give a tuple of body numbers, or None for all")
    for i in indices:
        if not 0 <= i < count:
            raise WrongStructure(
                f"{owner}.{field}: there is no body {i} in a scene of {count}; numbers start at 0"
            )
