"""Options that every command has, said in the help of each."""

import contextlib
import dataclasses
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import jax
import tyro

from jaxrb.draws import seeded
from jaxrb.errors import InvalidInput


@dataclasses.dataclass(frozen=True)
class Common:
    """Options of every command."""

    x64: bool = False
    """compute in float64, as commands do unless told otherwise."""
    float32: bool = False
    """compute in float32."""
    device: str | None = None
    """compute on cpu, gpu or tpu, or on the one of a number (gpu:1); by default as JAX chooses."""
    seed: int = 0
    """of what is drawn at random: places in scenes and measurements, starts of searches."""
    debug: bool = False
    """check every result, and show where the first comes from that is no number."""

    @contextlib.contextmanager
    def applied(self) -> Iterator[None]:
        """The command runs within it.

        Raises:
            InvalidInput: both precisions, a negative seed, a device that is not there.
        """
        if self.x64 and self.float32:
            raise InvalidInput("--x64 and --float32: choose one precision")
        if self.seed < 0:
            raise InvalidInput(f"--seed {self.seed}: give a number from 0 on")
        with contextlib.ExitStack() as stack:
            stack.enter_context(jax.enable_x64(not self.float32))
            stack.enter_context(seeded(self.seed))
            if self.device is not None:
                stack.enter_context(jax.default_device(_device(self.device)))
            if self.debug:
                # JAX's own checks of every program: each runs again, operation by operation, where NaN came out of
                # it, and what is traced is checked for consistency. Some times slower.
                stack.enter_context(jax.debug_nans(True))
                stack.enter_context(jax.enable_checks(True))
            yield


def with_common(command: Callable) -> Callable:
    """The command with the common options behind its own, applied while it runs."""
    signature = inspect.signature(command)

    def wrapped(*arguments: Any, common: Common = Common(), **options: Any) -> Any:
        with common.applied():
            return command(*arguments, **options)

    shown = tyro.conf.OmitArgPrefixes[Common]
    own = list(signature.parameters.values())
    last = inspect.Parameter("common", inspect.Parameter.KEYWORD_ONLY, annotation=shown, default=Common())
    wrapped.__signature__ = signature.replace(parameters=[*own, last])  # type: ignore[attr-defined]
    wrapped.__annotations__ = {**command.__annotations__, "common": shown}
    wrapped.__doc__ = command.__doc__
    return wrapped


def _device(name: str) -> Any:
    kind, _, number = name.partition(":")
    try:
        found = jax.devices(kind)
    except RuntimeError:
        here = sorted({device.platform for device in jax.devices()} | {"cpu"})
        raise InvalidInput(f"--device {name}: not on this machine; it has {', '.join(here)}") from None
    index = number or "0"
    if not index.isdecimal() or int(index) >= len(found):
        raise InvalidInput(f"--device {name}: this machine has {kind}:0 to {kind}:{len(found) - 1}")
    return found[int(index)]
