"""Worlds of different structure run by one call: those of one structure share one program."""

import contextlib
import functools
import operator
from collections.abc import Iterator, Sequence
from typing import Any, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.errors import LimitExceeded, RunFailed, WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Scalar
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import (
    DEFAULT_MAX_BYTES,
    ON_ERROR,
    check_choice,
    check_count,
    check_positive,
    check_representation,
    check_saved_bytes,
    warn_of_coarse_steps,
)
from jaxrb.scene.sharding import along, check_agreement, gathered, laid_over, last_words, mesh_of
from jaxrb.scene.status import OK


class WorldPaths(Sequence[Path]):
    """The paths of many worlds, in the order in which the worlds were given.

    `buckets` are the worlds of one structure as they ran: the numbers (k,) of the worlds in that order, and one `Path`
    whose arrays have a leading axis over them. `paths[i]` takes one world out of its bucket.
    """

    def __init__(self, buckets: Sequence[tuple[np.ndarray, Path]]):
        self.buckets = tuple(buckets)
        places = [(int(i), b, row) for b, (who, _) in enumerate(self.buckets) for row, i in enumerate(who)]
        self._places = [(b, row) for _, b, row in sorted(places)]

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> Path: ...
    @overload
    def __getitem__(self, index: slice) -> list[Path]: ...
    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        bucket, row = self._places[operator.index(index)]
        return jax.tree.map(lambda leaf: leaf[row], self.buckets[bucket][1])

    def __iter__(self) -> Iterator[Path]:
        return (self[i] for i in range(len(self)))

    def raise_if_bad(self) -> None:
        """Raise `RunFailed` for the first world, in the order given, in which a body went wrong."""
        worst = []
        for who, path in self.buckets:
            if is_concrete(path.status.reason):
                worst += who[(np.asarray(path.status.reason) != OK).any(axis=-1)].tolist()
        if worst:
            try:
                self[min(worst)].raise_if_bad()
            except RunFailed as error:
                raise RunFailed(f"world {min(worst)} of {len(self)}: {error}") from None


def rollout_worlds(
    worlds: Sequence[tuple[Scene, State]],
    *,
    dt: Scalar | float,
    steps: int,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
    save_every: int = 1,
    on_error: str = "raise",
    max_bytes: int = DEFAULT_MAX_BYTES,
    sharding: Any = None,
) -> WorldPaths:
    """Run many worlds that may differ in bodies and effects; the paths come back in the order given.

    Worlds whose trees are alike (the same bodies, effects, shapes of numbers, floating type) form one program, in which
    they run side by side; each structure is traced and compiled once. Worlds of a single structure are run as
    `jax.vmap` over `rb.rollout` would. Differentiate and `jit` as you like: the worlds' numbers are arrays.

    Args:
        worlds: pairs (scene, state), at least one.
        dt, steps, method, save_every: as for `rb.rollout`, the same for all.
        on_error: "raise" `RunFailed` for the first world that fails, or "flag" it in that world's `status`.
        max_bytes: refuse to start if the saved states of all worlds would need more.
        sharding: a `jax.sharding.Mesh` over whose devices the worlds are laid, also those of other processes after
            `jax.distributed.initialize`; every process calls with all worlds and gets all paths, on the host. A number
            of worlds that the devices do not divide is filled up, with a warning. Free bodies move with the same bits
            as on one device, but for the last digit where a device has a single world. None: the default device.

    Raises:
        WrongStructure: something else than pairs of a scene and a state of it.
        LimitExceeded: as of `rollout`.
        RunFailed: as of `rollout`.
    """
    method = method_of(method)
    check_choice("on_error", on_error, ON_ERROR)
    check_positive("dt", dt)
    steps, save_every = check_count("steps", steps, 0), check_count("save_every", save_every, 1)
    worlds = _checked(worlds, method)
    _check_bytes(worlds, steps // save_every + 1, max_bytes)
    for scene, state in worlds:
        warn_of_coarse_steps(scene, state, dt, method)
    found = []
    mesh = None if sharding is None else mesh_of(sharding)
    with contextlib.nullcontext() if mesh is None else last_words():
        if mesh is not None:
            check_agreement(worlds)
        for who in _buckets(worlds):
            stacked = jax.tree.map(_stacked, *(worlds[i] for i in who))
            if mesh is None:
                path = _together(*stacked, dt, method, steps=steps, save_every=save_every)
            else:
                shares = laid_over(mesh, stacked, len(who))
                path = _apart(*shares, dt, method, mesh=mesh, steps=steps, save_every=save_every)
                path = gathered(path, len(who))
            found.append((np.asarray(who), path))
    paths = WorldPaths(found)
    if on_error == "raise":
        paths.raise_if_bad()
    return paths


def _checked(worlds: Any, method: Method) -> list[tuple[Scene, State]]:
    worlds = list(worlds)
    if not worlds:
        raise WrongStructure("rollout_worlds: no worlds were given; give at least one pair (scene, state)")
    for i, world in enumerate(worlds):
        if not (isinstance(world, tuple) and len(world) == 2 and isinstance(world[0], Scene)):
            raise WrongStructure(
                f"rollout_worlds: world {i} is a {type(world).__name__}; give pairs (scene, state)"
            )
        try:
            check_fit(*world)
            check_representation(method, world[1])
        except WrongStructure as error:
            raise WrongStructure(f"rollout_worlds: world {i}: {error}") from None
    return worlds


def _check_bytes(worlds: list[tuple[Scene, State]], saves: int, max_bytes: int) -> None:
    try:
        check_saved_bytes(jax.tree.map(_as_array, [state for _, state in worlds]), saves, max_bytes)  # type: ignore[arg-type]
    except LimitExceeded as error:
        raise LimitExceeded(f"rollout_worlds, {len(worlds)} worlds together: {error}") from None


def _buckets(worlds: list[tuple[Scene, State]]) -> list[list[int]]:
    """Numbers of the worlds of each structure, in the order in which the structures first come."""
    buckets: dict[Any, list[int]] = {}
    for i, world in enumerate(worlds):
        leaves, structure = jax.tree.flatten(world)
        kinds = tuple((np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
        buckets.setdefault((structure, kinds), []).append(i)
    return list(buckets.values())


def _as_array(leaf: Any) -> Any:
    return leaf if hasattr(leaf, "dtype") else np.asarray(leaf)


def _stacked(*leaves: Any) -> Any:
    """On the host where all numbers are there: a call to the device for each leaf would take longer than the run."""
    if all(isinstance(leaf, (np.ndarray, np.generic, float, int)) for leaf in leaves):
        return np.stack(leaves)
    return jnp.stack(leaves)


def _run(scene: Scene, state: State, dt: Scalar, method: Method, *, steps: int, save_every: int) -> Path:
    def one(scene: Scene, state: State) -> Path:
        return rollout(
            scene, state, dt=dt, steps=steps, method=method, save_every=save_every, on_error="flag"
        )

    return jax.vmap(one)(scene, state)


_together = jax.jit(_run, static_argnames=("steps", "save_every"))


def _run_apart(
    scene: Scene, state: State, dt: Scalar, method: Method, *, mesh: Mesh, steps: int, save_every: int
) -> Path:
    run = functools.partial(_run, steps=steps, save_every=save_every)
    own, same = along(mesh), PartitionSpec()
    # Not left to the compiler: it would let all devices wait for the slowest in every loop of a contact solve.
    split = jax.shard_map(run, mesh=mesh, in_specs=(own, own, same, same), out_specs=own, check_vma=False)
    return split(scene, state, dt, method)


_apart = jax.jit(_run_apart, static_argnames=("mesh", "steps", "save_every"))
