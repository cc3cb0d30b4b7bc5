"""A user's own force."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.effects.effect import Force, Wrench
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Scalar


class CustomForce(Force):
    """A force given by a function: `function(body, state, parameters) -> Wrench` for one body.

    `body` has `mass` and `inertia`, `state` the fields of `State` without a bodies axis, with the time. `parameters` is
    any tree of arrays and may be differentiated. `potential(body, state, parameters)`, if given, is the potential
    energy [J]. Define the functions once: a new function object means a new trace.
    """

    function: Callable[..., Wrench] = eqx.field(static=True)
    parameters: Any = None
    potential: Callable[..., Scalar] | None = eqx.field(static=True, default=None)

    def __post_init__(self):
        super().__post_init__()
        if not callable(self.function):
            raise WrongStructure(
                f"CustomForce.function: {self.function!r} is no function; give function(body, state, parameters)"
            )

    def wrench(self, body: MassProperties, state: State) -> Wrench:
        wrench = self.function(body, state, self.parameters)
        if not isinstance(wrench, Wrench):
            raise WrongStructure(
                f"CustomForce: {self.function} returned {type(wrench).__name__}; return Wrench(force=…, torque=…)"
            )
        return wrench

    def potential_energy(self, body: MassProperties, state: State) -> Scalar | None:
        return None if self.potential is None else self.potential(body, state, self.parameters)
