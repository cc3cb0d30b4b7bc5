"""Evaluating a function of rows without ever putting vectors together.

The equations of motion are written with vectors that `stack` joins and `components` takes apart. XLA cancels such pairs
only where nothing lies between; where sums of vectors do, it makes a loop and an array of each: six a step, not two.
Here a traced function is run with each vector kept as its components; arithmetic goes to the components one by one.
The numbers are the same. A step of 1000 tops costs half.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.extend.core import Literal

from jaxrb.math.stacking import components, stack, stack_p, unstack_p

# Primitives that treat every number of equally shaped arguments alike.
_ELEMENTWISE = frozenset(
    (
        *(
            "add",
            "add_any",
            "sub",
            "mul",
            "div",
            "neg",
            "abs",
            "sign",
            "max",
            "min",
            "sqrt",
            "rsqrt",
            "square",
        ),
        *(
            "pow",
            "integer_pow",
            "exp",
            "log",
            "sin",
            "cos",
            "tan",
            "tanh",
            "select_n",
            "convert_element_type",
        ),
        *("eq", "ne", "lt", "le", "gt", "ge", "and", "or", "not", "stop_gradient", "copy"),
    )
)
_SMALL = 16  # numbers
_INLINED = ("jit", "pjit", "closed_call", "core_call")


class _Parts(tuple):
    """An array as its slices along the last axis; a slice may be `_Parts` in turn."""


class ByRows:
    """`function(fixed, time, rows)` for rows given as a list of arrays, traced once, arrays out.

    Arrays in `fixed` are taken apart here, once: in a loop their rows would be read with a stride at every step.
    What depends on the time alone is a function of its own, `schedule`: left among the rows, XLA would fuse it into
    their loop and evaluate, say, one sine of the time for every body.
    """

    def __init__(self, function: Callable[..., Sequence[jax.Array]], fixed: Any, time: Any, rows: Any):
        self._closed = jax.make_jaxpr(function)(fixed, time, rows)
        jaxpr = self._closed.jaxpr
        leaves = [_taken_apart(leaf) for leaf in jax.tree.leaves(fixed)]
        self._time = jaxpr.invars[len(leaves)]
        self._rows = jaxpr.invars[len(leaves) + 1 :]
        self._known = dict(
            zip([*jaxpr.constvars, *jaxpr.invars], [*self._closed.consts, *leaves], strict=False)
        )
        constant, self._timed, self._rest = _split(jaxpr.eqns, self._time, set(self._known))
        _follow(constant, self._known)
        made = {v for equation in self._timed for v in equation.outvars}
        used = [v for equation in self._rest for v in equation.invars] + list(jaxpr.outvars)
        self._handed = list(dict.fromkeys(v for v in used if not isinstance(v, Literal) and v in made))

    def schedule(self, time: Any) -> list[jax.Array]:
        """What the rates need of the time alone."""
        known = self._known | {self._time: time}
        _follow(self._timed, known)
        return [_whole(known[v]) for v in self._handed]

    def __call__(
        self, time: Any, scheduled: Sequence[jax.Array], rows: Sequence[jax.Array]
    ) -> list[jax.Array]:
        known = self._known | {self._time: time} | dict(zip(self._handed, scheduled, strict=True))
        known |= dict(zip(self._rows, rows, strict=True))
        _follow(self._rest, known)
        outputs = self._closed.jaxpr.outvars
        return [_whole(v.val if isinstance(v, Literal) else known[v]) for v in outputs]


def _split(equations: Sequence[Any], time: Any, known: set) -> tuple[list[Any], list[Any], list[Any]]:
    """Equations that need neither time nor rows, those that need the time alone, and the rest.

    What spreads numbers over bodies is of the rest: in a loop a number costs less than a row of equal ones.
    """
    constant, timed, rest = [], [], []
    of_time = {time}
    for equation in equations:
        inputs = {v for v in equation.invars if not isinstance(v, Literal)}
        small = all(v.aval.size <= _SMALL for v in (*inputs, *equation.outvars))
        if not small or equation.primitive.name == "broadcast_in_dim" or not inputs <= known | of_time:
            rest.append(equation)
        elif inputs & of_time:
            timed.append(equation)
            of_time.update(equation.outvars)
        else:
            constant.append(equation)
            known.update(equation.outvars)
    return constant, timed, rest


def _taken_apart(array: Any) -> Any:
    return _Parts(_taken_apart(part) for part in components(array)) if jax.numpy.ndim(array) > 1 else array


def _run(jaxpr: Any, constants: Sequence[Any], values: Sequence[Any]) -> list[Any]:
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *values], strict=True))
    _follow(jaxpr.eqns, known)
    return [v.val if isinstance(v, Literal) else known[v] for v in jaxpr.outvars]


def _follow(equations: Sequence[Any], known: dict) -> None:
    """Evaluate equations in turn, adding to the known values."""
    for equation in equations:
        given = [v.val if isinstance(v, Literal) else known[v] for v in equation.invars]
        known.update(zip(equation.outvars, _evaluated(equation, given), strict=True))


def _evaluated(equation: Any, given: list[Any]) -> Sequence[Any]:
    primitive = equation.primitive
    if primitive is stack_p:
        return [_Parts(given)]
    if primitive is unstack_p:
        return _parts(given[0])
    if primitive.name in _INLINED:
        inner = equation.params.get("jaxpr") or equation.params["call_jaxpr"]
        return _run(inner.jaxpr, inner.consts, given)
    if primitive.name in _ELEMENTWISE and any(isinstance(value, _Parts) for value in given):
        return [_apart(equation, given, equation.outvars[0].aval.ndim)]
    return _bound(equation, [_whole(value) for value in given])


def _apart(equation: Any, given: list[Any], rank: int) -> Any:
    """An elementwise equation on the parts of its arguments; a scalar holds for all parts."""
    if not any(isinstance(value, _Parts) for value in given):
        return _bound(equation, given)[0]
    apart = [_parts(value) if _rank(value) == rank else None for value in given]
    count = max(len(parts) for parts in apart if parts is not None)

    def part(value: Any, parts: Sequence[Any] | None, i: int) -> Any:
        if parts is None:
            return value
        return parts[i if len(parts) > 1 else 0]  # an axis of length one holds for all parts

    return _Parts(
        _apart(equation, [part(*pair, i) for pair in zip(given, apart, strict=True)], rank - 1)
        for i in range(count)
    )


def _bound(equation: Any, given: list[Any]) -> list[Any]:
    bound = equation.primitive.get_bind_params(equation.params)
    functions, parameters = bound if isinstance(bound, tuple) else ((), bound)  # JAX changed it at 0.10
    found = equation.primitive.bind(*functions, *given, **parameters)
    return list(found) if equation.primitive.multiple_results else [found]


def _rank(value: Any) -> int:
    return 1 + _rank(value[0]) if isinstance(value, _Parts) else jax.numpy.ndim(value)


def _parts(value: Any) -> Sequence[Any]:
    return value if isinstance(value, _Parts) else components(value)


def _whole(value: Any) -> Any:
    return stack(*(_whole(part) for part in value)) if isinstance(value, _Parts) else value
