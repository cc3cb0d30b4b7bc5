"""The type checker that the import hook of jaxtyping puts on every function of jaxrb (see conftest.py)."""

from typing import Any, Self

from beartype import BeartypeConf, beartype

_CONF = BeartypeConf(is_pep484_tower=True)


def checked(function: Any) -> Any:
    """beartype, with two exceptions.

    Constructors take a user's raw numbers, which are converted and checked by jaxrb itself. And `Self` is not checked:
    the hook decorates methods one by one, where beartype cannot tell their class.
    """
    if function.__name__ == "__init__":
        return function
    hints = function.__annotations__
    function.__annotations__ = {name: Any if hint is Self else hint for name, hint in hints.items()}
    return beartype(function, conf=_CONF)
