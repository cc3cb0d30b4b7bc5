"""How programs are compiled: options that XLA takes a program at a time."""

import contextlib
import functools
import gc
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

from jaxrb.checks import is_concrete

# XLA's newer way to turn a group of operations into one loop takes LLVM two thirds longer than the older, for loops
# that run no faster (one box on a plane, seconds of CPU: 4.8 against 2.9; its gradient 20 against 12; sixteen boxes 16
# against 11; 1000 free bodies 0.64 against 0.37; run times within 5 %, the gradient's 30 % less). Releases differ in
# what they have, so it is asked for only where it is known.
_QUICK = {"xla_cpu_use_fusion_emitters": False}


@functools.cache
def compiler_options() -> dict[str, Any]:
    """Options with which jaxrb's programs compile soonest on this machine and this release of JAX; may be empty.

    `rb.rollout` and `rb.step` use them where they are called with numbers. JAX takes options for whole programs only:
    give them to a `jax.jit` of your own, `jax.jit(loss, compiler_options=rb.compiler_options())`. On an accelerator,
    and where XLA does not know them, there are none.
    """
    if jax.default_backend() != "cpu":
        return {}
    try:
        # The smallest program there is: XLA refuses options that it does not know.
        jax.jit(lambda: 0, compiler_options=_QUICK).lower().compile()
    except Exception:
        return {}
    return dict(_QUICK)


def jit(function: Callable, static_argnames: Sequence[str] = ()) -> Callable:
    """`jax.jit`, with `compiler_options` where the call is a program of its own.

    Inside another program or transformation that cannot be, and plain `jax.jit` is used.
    """
    inner = jax.jit(function, static_argnames=static_argnames)

    @functools.cache
    def outer() -> Callable:
        return jax.jit(function, static_argnames=static_argnames, compiler_options=compiler_options())

    @functools.wraps(function)
    def called(*arguments: Any, **options: Any) -> Any:
        alone = all(is_concrete(leaf) for leaf in jax.tree.leaves((arguments, options)))
        with _collector_resting():
            return (outer() if alone and not _tracing() else inner)(*arguments, **options)

    return called


@contextlib.contextmanager
def _collector_resting() -> Iterator[None]:
    """No search for unreachable objects meanwhile: tracing makes a million that are all still in use, and the searches
    take a sixth of its time (a box on a plane, cached: 0.69 s of CPU instead of 0.80)."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _tracing() -> bool:
    """Whether a program is being traced, though it may have no arguments: then whatever is added up is traced too."""
    return not is_concrete(jax.lax.add(np.float32(0), np.float32(0)))
