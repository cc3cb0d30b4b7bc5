"""A medium that moves, here so and there otherwise: the wind that drag, lift and Magnus forces feel."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import PER_BODY, State
from jaxrb.effects.effect import Effect, Force, Wrench
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Array, Scalar


class WindField(Effect):
    """The given `effects` in a medium whose velocity is `function(position, time, parameters)` (3,) [m/s], in W.

    The function is asked at each body's centre of mass `position` (3,) [m] and `time` [s]; each effect then acts as if
    the body moved through a medium at rest with its velocity relative to the wind. For effects that depend on velocity
    through the medium alone: `LinearDrag`, `QuadraticDrag`, `MagnusForce`, `PlateAerodynamics`, or one of your own. A
    uniform wind is cheaper as their own `wind`. `parameters` is any tree of arrays and may be differentiated. Define
    the function once: a new function object means a new trace.
    """

    effects: Any  # an Effect or several; afterwards a tuple[Effect, ...]
    function: Callable[..., Array] = eqx.field(static=True)
    parameters: Any = None

    def __post_init__(self):
        super().__post_init__()
        self.effects = (self.effects,) if isinstance(self.effects, Effect) else tuple(self.effects)
        for effect in self.effects:
            if not isinstance(effect, Force) or isinstance(effect, FixedPoint):
                raise WrongStructure(
                    f"WindField.effects: {effect!r} is no force on one body at a time; give drag, lift or Magnus forces"
                )
        if not callable(self.function):
            raise WrongStructure(
                f"WindField.function: {self.function!r} is no function; give function(position, time, parameters)"
            )

    def check(self, count: int) -> None:
        for effect in self.effects:
            effect.check(count)

    def with_shapes(self, bodies: tuple[Any, ...]) -> Effect:
        return dataclasses.replace(self, effects=tuple(effect.with_shapes(bodies) for effect in self.effects))

    def wrench_on(self, bodies: MassProperties, state: State) -> Wrench:
        with jax.named_scope("WindField"):
            relative = self._relative(state)
            total = Wrench()
            for effect in self.effects:
                total = total + effect.wrench_on(bodies, relative)
            return total

    def potential_energy_of(self, bodies: MassProperties, state: State) -> Scalar | None:
        total = None
        for effect in self.effects:
            energy = effect.potential_energy_of(bodies, state)
            total = energy if total is None else total if energy is None else total + energy
        return total

    def rate(self, bodies: MassProperties, state: State) -> np.ndarray | float:
        relative = _relative_jitted(self, state)
        return max((float(np.max(effect.rate(bodies, relative))) for effect in self.effects), default=0.0)

    def _relative(self, state: State) -> State:
        def at(one: State) -> Array:
            wind = self.function(one.position, one.time, self.parameters)
            if np.shape(wind) != (3,):
                raise WrongStructure(
                    f"WindField: {self.function} returned shape {np.shape(wind)}; return the velocity (3,) [m/s]"
                )
            return wind

        wind = jax.vmap(at, in_axes=(PER_BODY,))(state)
        return eqx.tree_at(lambda s: s.velocity, state, (state.velocity - wind).astype(state.dtype))


_relative_jitted = jax.jit(WindField._relative)
