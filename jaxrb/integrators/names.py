"""Methods by name, for the command line and for messages."""

import difflib
from collections.abc import Callable
from typing import Any

from jaxrb.errors import UnknownName, WrongStructure
from jaxrb.integrators.euler import ExplicitEuler
from jaxrb.integrators.method import Method
from jaxrb.integrators.midpoint import ImplicitMidpoint
from jaxrb.integrators.moser_veselov import MoserVeselov, MoserVeselov4, MoserVeselov6
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.integrators.semi_implicit import SemiImplicitEuler
from jaxrb.integrators.three_axis_splitting import ThreeAxisSplitting, ThreeAxisSplitting4
from jaxrb.integrators.verlet import VelocityVerlet

METHODS: dict[str, Callable[[], Method]] = {
    kind.__name__: kind
    for kind in (
        ExplicitEuler,
        SemiImplicitEuler,
        VelocityVerlet,
        RungeKutta4,
        ImplicitMidpoint,
        ThreeAxisSplitting,
        ThreeAxisSplitting4,
        MoserVeselov,
        MoserVeselov4,
        MoserVeselov6,
    )
}


def method_of(method: Any) -> Method:
    """The method itself, or the one of that name.

    Raises:
        UnknownName: no method is called so; the message suggests the nearest names.
        WrongStructure: it is neither a method nor a name.
    """
    if isinstance(method, Method):
        return method
    if isinstance(method, type) and issubclass(method, Method):
        raise WrongStructure(f"method: {method.__name__} is a class; write {method.__name__}()")
    if isinstance(method, str):
        lowered = {name.lower(): name for name in METHODS}
        if method.lower() in lowered:
            return METHODS[lowered[method.lower()]]()
        near = [lowered[m] for m in difflib.get_close_matches(method.lower(), lowered, n=2, cutoff=0.4)]
        meant = f"did you mean {' or '.join(near)}? " if near else ""
        raise UnknownName(f"method {method!r} is not known; {meant}There are {', '.join(METHODS)}")
    raise WrongStructure(
        f"method: {method!r} is no method of jaxrb; use one of {', '.join(METHODS)}, or rb.solve for diffrax's solvers"
    )
