"""How much memory a run will take, known before it runs: read off the compiled program."""

import dataclasses
import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body.state import State
from jaxrb.checks import check_count
from jaxrb.compilation import compiler_options
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

_UNITS = ("bytes", "kB", "MB", "GB", "TB")


@dataclasses.dataclass(frozen=True)
class MemoryEstimate:
    """Bytes of a run: `given` (scene and states), `results` (what it saves, and for a gradient the gradient), and
    `working` (what it needs on the way)."""

    given: int
    results: int
    working: int

    @property
    def total(self) -> int:
        """The peak: all of it is there at once."""
        return self.given + self.results + self.working

    def summary(self) -> str:
        """In words."""
        parts = (f"{name} {_in_words(getattr(self, name))}" for name in ("given", "results", "working"))
        return f"{_in_words(self.total)} at the peak ({', '.join(parts)})"


def memory(
    scene: Scene,
    state: State,
    *,
    dt: float,
    steps: int,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
    save_every: int = 1,
    worlds: int | None = None,
    gradient: bool = False,
) -> MemoryEstimate:
    """Memory that a `rollout` will need. It is compiled (which takes as long as it will for the run) and not run.

    Args:
        scene, state, dt, steps, method, save_every: as for `rollout`.
        worlds: run so many worlds of this structure side by side, as `jax.vmap` over their states would.
        gradient: of a reverse pass instead, of a number made of the final state, by all numbers of scene and state.

    What JAX itself and the program's text take (some 200 MB) is not in it, nor what is made of the path afterwards:
    `path.diagnostics` forms energies and momenta of all saved states when asked for.
    """
    program, _ = compiled_run(scene, state, dt, steps, method, save_every, worlds, gradient)
    found = program.memory_analysis()
    return MemoryEstimate(
        int(found.argument_size_in_bytes), int(found.output_size_in_bytes), int(found.temp_size_in_bytes)
    )


def compiled_run(
    scene: Scene,
    state: State,
    dt: float,
    steps: int,
    method: Method | str,
    save_every: int,
    worlds: int | None,
    gradient: bool,
) -> tuple[Any, Any]:
    """The program that `memory` looks at, and the scene's numbers: to be called with these and the states."""
    numbers, rest = eqx.partition(scene, eqx.is_inexact_array_like)
    if worlds is not None:
        count = check_count("worlds", worlds, 1)
        state = jax.tree.map(lambda x: jax.ShapeDtypeStruct((count, *x.shape), x.dtype), state)

    def path_of(scene: Scene, state: State) -> Path:
        return rollout(
            scene, state, dt=dt, steps=steps, method=method, save_every=save_every, on_error="flag", max_bytes=2**62
        )  # fmt: skip

    def run(numbers: Any, state: State) -> Any:
        one = functools.partial(path_of, eqx.combine(numbers, rest))
        path = (one if worlds is None else jax.vmap(one))(state)
        return path.states, path.final, path.status, path.contact

    def end(numbers: Any, state: State) -> Any:
        return sum(jnp.sum(leaf) for leaf in jax.tree.leaves(run(numbers, state)[1]))

    function = jax.grad(end, argnums=(0, 1)) if gradient else run
    return jax.jit(function, compiler_options=compiler_options()).lower(numbers, state).compile(), numbers


def _in_words(count: int) -> str:
    power = min(int(math.log10(max(count, 1))) // 3, len(_UNITS) - 1)
    return f"{count / 1000**power:.3g} {_UNITS[power]}"
