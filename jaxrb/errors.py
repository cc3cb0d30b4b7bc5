"""The errors and warnings of jaxrb. Every one that the library raises on purpose is a `JaxrbError`."""

from typing import Any


class JaxrbError(Exception):
    """Base of every error that jaxrb raises on purpose."""


class InvalidInput(JaxrbError, ValueError):
    """Data that cannot be simulated: the message names what, where, the value and the mend."""


class WrongStructure(JaxrbError, TypeError):
    """A shape, type or combination that no program can be traced for."""


class UnknownName(JaxrbError, LookupError):
    """A method, scene or shape of that name does not exist; the message suggests the nearest."""


class LimitExceeded(JaxrbError, MemoryError):
    """A run that would need more than a stated, configurable limit; refused before it starts."""


class RunFailed(JaxrbError, ArithmeticError):
    """A run that left the finite numbers, or a solver that stopped early. Raised once, at the outermost call."""


class RunInterrupted(JaxrbError, KeyboardInterrupt):
    """A run that Ctrl-C ended: `path` holds what was done. Leaves a program as Ctrl-C does where nobody catches it."""

    def __init__(self, message: str, path: Any = None):
        super().__init__(message)
        self.path = path


class NotIdentifiable(JaxrbError):
    """The recording cannot determine what was asked for; the message describes the null vector."""


class JaxrbWarning(UserWarning):
    """A documented repair, or a setting that is likely to give a poor answer."""
