"""The type checker that the import hook of jaxtyping puts on every function of jaxrb (see conftest.py)."""

import typing
from typing import Any

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray

_CONF = BeartypeConf(is_pep484_tower=True)


def checked(function: Any) -> Any:
    """beartype for the annotations of arrays, which is where shapes stand.

    The others are left out: words and objects of a wrong kind are given on purpose in the tests of bad input, and must
    get jaxrb's own message. Constructors take a user's raw numbers, which jaxrb converts and checks itself.
    """
    if function.__name__ == "__init__":
        return function
    hints = function.__annotations__
    function.__annotations__ = {name: hint if _has_shape(hint) else Any for name, hint in hints.items()}
    return beartype(function, conf=_CONF)


def _has_shape(hint: Any) -> bool:
    if isinstance(hint, type) and issubclass(hint, AbstractArray):
        return True
    return any(_has_shape(part) for part in typing.get_args(hint))
