"""Checks of data at construction, on the host. Values that are being traced pass; a run's status catches those.

A field of a public class says what it holds by `quantity(...)`: how many axes one body's value has, and which numbers
make sense. `Checked` turns numbers into host arrays and refuses the rest, naming class, field, value and mend.
"""

import dataclasses
import warnings
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from jaxrb.errors import InvalidInput, JaxrbWarning, LimitExceeded, WrongStructure


def is_concrete(value: Any) -> bool:
    """Whether the numbers are there to be looked at, not being traced."""
    return not isinstance(value, Tracer)


def as_array(where: str, value: Any) -> Any:
    """Numbers as a floating array; arrays of JAX and traced values stay what they are.

    Lists and Python numbers become host arrays in float64: they cost no device call, and take the state's dtype when a
    run is prepared.
    """
    if isinstance(value, jax.Array):
        if not jax.numpy.issubdtype(value.dtype, jax.numpy.floating):
            if not jax.numpy.issubdtype(value.dtype, jax.numpy.integer):
                raise InvalidInput(f"{where}: an array of {value.dtype} is none of real numbers")
            return value.astype(jax.dtypes.canonicalize_dtype(float))
        return value
    if isinstance(value, (list, tuple)) and any(not is_concrete(v) for v in jax.tree.leaves(value)):
        return jax.numpy.asarray(value, float)
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            raise TypeError
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{where}: {value!r} is not a real number or an array of real numbers") from error
    return array if array.dtype.kind == "f" else array.astype(float)


def quantity(
    core: tuple[int, ...] = (),
    *,
    positive: bool = False,
    nonnegative: bool = False,
    at_most: float | None = None,
    unit: str = "1",
    mend: str = "",
    **options: Any,
) -> Any:
    """A field of numbers: `core` is the shape for one body; further leading axes run over bodies."""
    limits = {"core": core, "positive": positive, "nonnegative": nonnegative, "at_most": at_most}
    return eqx.field(metadata={"quantity": {**limits, "unit": unit, "mend": mend}}, **options)


class Checked(eqx.Module):
    """A module whose `quantity` fields are converted and checked when it is constructed."""

    def __post_init__(self):
        for field in quantities(type(self)):
            where = f"{type(self).__name__}.{field.name}"
            value = getattr(self, field.name)
            if value is None:
                if field.default is not None:
                    raise InvalidInput(f"{where} is None, but must be a number or an array of numbers")
                continue
            value = as_array(where, value)
            object.__setattr__(self, field.name, value)
            check_quantity(where, value, **field.metadata["quantity"])


def quantities(kind: type) -> list[dataclasses.Field]:
    """The fields of a class that hold numbers."""
    return [field for field in dataclasses.fields(kind) if "quantity" in field.metadata]


def check_quantity(
    where: str,
    value: Any,
    *,
    core: tuple[int, ...] = (),
    positive: bool = False,
    nonnegative: bool = False,
    at_most: float | None = None,
    unit: str = "1",
    mend: str = "",
) -> None:
    """Refuse a wrong shape (also of a traced value), numbers that are not finite or out of range."""
    rank = len(core)
    shape = np.shape(value)
    if len(shape) < rank or shape[len(shape) - rank :] != core:
        raise WrongStructure(f"{where}: the shape is {shape}, but must end in {core} for one body")
    if not is_concrete(value):
        return
    array = np.asarray(value)
    hint = f"; {mend}" if mend else ""
    for bad, problem in (
        (~np.isfinite(array), "must be finite"),
        ((array <= 0) if positive else np.zeros_like(array, bool), "must be positive"),
        ((array < 0) if nonnegative else np.zeros_like(array, bool), "must not be negative"),
        (
            (array > at_most) if at_most is not None else np.zeros_like(array, bool),
            f"must be at most {at_most}",
        ),
    ):
        if bad.any():
            raise InvalidInput(
                f"{where}{at(bad, rank)} is {array[bad].ravel()[0].item()!r} {unit}, but {problem}{hint}"
            )


def check_count(name: str, value: Any, least: int) -> int:
    """A whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise WrongStructure(f"{name}: {value!r} is not a whole number known when the program is traced")
    if value < least:
        raise InvalidInput(f"{name} is {value}, but must be at least {least}")
    return int(value)


def check_tolerance(name: str, value: Any) -> None:
    """Refuse a tolerance outside (0, 1)."""
    if not is_concrete(value):
        return
    if (
        isinstance(value, bool)
        or np.ndim(value) != 0
        or not np.issubdtype(np.asarray(value).dtype, np.number)
    ):
        raise WrongStructure(f"{name}: {value!r} is not a number")
    if not 0 < float(value) < 1:
        raise InvalidInput(
            f"{name} is {value!r}, but must lie between 0 and 1, ends excluded; 1e-6 is a good start"
        )


def raise_if_overflowed(overflow: Any, message: str) -> None:
    """Raise `LimitExceeded` where a capacity was too small. Does nothing while being traced."""
    if is_concrete(overflow) and np.any(np.asarray(overflow)):
        raise LimitExceeded(message)


def check_direction(where: str, vector: Any) -> None:
    """Refuse the zero vector where a direction is wanted."""
    if is_concrete(vector) and (zero := ~np.asarray(vector).any(axis=-1)).any():
        raise InvalidInput(f"{where}{at(zero)} is the zero vector, but must have a direction")


def at(bad: np.ndarray | np.bool_, rank: int = 0) -> str:
    """Where the first True stands, in words: ` of body 3` for an array with a bodies axis."""
    if bad.ndim <= rank:
        return ""
    index = np.argwhere(bad)[0]
    return f" of body {index[0]}"


def warn(message: str) -> None:
    """A documented repair or a doubtful setting."""
    warnings.warn(message, JaxrbWarning, stacklevel=3)
