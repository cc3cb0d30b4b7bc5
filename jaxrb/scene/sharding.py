"""Worlds laid over devices and processes. Each device runs its share by itself; none waits for another on the way."""

import contextlib
import subprocess
import sys
import warnings
import zlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, JaxrbWarning, RunFailed, WrongStructure

_HOW_TO_GO_ON = (
    "Start all of them again. Calls of fewer steps lose less: the final states of one are the starts of the next, and "
    "rb.run keeps a single world's in a file."
)
# Ends when its input does. A line tells that all is well; without one, whoever started it is gone.
_MOURNER = "import sys; sys.stdin.readline() or print(sys.argv[1], file=sys.stderr, flush=True)"


def mesh_of(sharding: Any) -> Mesh:
    """The mesh that a user means: one, or a sharding that has one."""
    mesh = sharding.mesh if isinstance(sharding, NamedSharding) else sharding
    if not isinstance(mesh, Mesh):
        raise WrongStructure(
            f'sharding: a {type(sharding).__name__}; give a mesh, as jax.make_mesh((8,), ("worlds",)) for 8 devices'
        )
    # Of jax.make_mesh's explicit axes a program would have to keep track outside of here.
    return Mesh(mesh.devices, mesh.axis_names)


def along(mesh: Mesh) -> PartitionSpec:
    """The leading axis over all devices of a mesh."""
    return PartitionSpec(mesh.axis_names)


def laid_over(mesh: Mesh, worlds: Any, count: int) -> Any:
    """Worlds (count, …), with copies of the last so that every device has as many, each share where it will run."""
    missing = -count % mesh.size
    if missing:
        warnings.warn(
            f"rollout_worlds: {count} worlds of one structure over {mesh.size} devices: {missing} copies of the last "
            "run beside them and are dropped",
            JaxrbWarning,
            stacklevel=4,
        )
    here = NamedSharding(mesh, along(mesh))

    def lay(leaf: Any) -> Any:
        if not is_concrete(leaf):
            return jax.numpy.concatenate([leaf, *[leaf[-1:]] * missing])
        rows = np.asarray(leaf)
        rows = np.concatenate([rows, *[rows[-1:]] * missing])
        # Every process has all worlds and takes its own: nothing is sent.
        return jax.make_array_from_callback(rows.shape, here, lambda index: rows[index])

    return jax.tree.map(lay, worlds)


def check_agreement(worlds: Any) -> None:
    """Refuse worlds that are not the same in all processes: each runs its share of its own.

    It also opens the connections, so that the loss of a process is noticed at once and not after a timeout.
    """
    if jax.process_count() == 1:
        return
    leaves, structure = jax.tree.flatten(worlds)
    own = zlib.crc32(repr(structure).encode())
    for leaf in leaves:
        own = zlib.crc32(np.ascontiguousarray(leaf).tobytes(), own)
    sums = np.ravel(_from_all(np.asarray(own, np.uint32)))
    if len(set(sums.tolist())) > 1:
        odd = np.flatnonzero(sums != sums[0]).tolist()
        raise InvalidInput(
            f"rollout_worlds: the worlds of process 0 differ from those of {odd}; give all worlds, and the same, in "
            "every process"
        )


def gathered(found: Any, count: int) -> Any:
    """The first `count` worlds of a result, in every process, on the host; traced values as they are."""
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves(found)):
        return jax.tree.map(lambda leaf: leaf[:count], found)
    if jax.process_count() > 1:
        found = _from_all(found)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:count], found)


def _from_all(found: Any) -> Any:
    from jax.experimental.multihost_utils import process_allgather

    try:
        return process_allgather(found, tiled=True)
    except Exception as error:  # whatever the transport raises: its type differs with it
        reason = str(error).strip().splitlines()[0]
        raise RunFailed(
            f"rollout_worlds: process {jax.process_index()} of {jax.process_count()} has lost the others ({reason}). "
            f"{_HOW_TO_GO_ON}"
        ) from error


@contextlib.contextmanager
def last_words() -> Iterator[None]:
    """See that the user reads how to go on when this process, one of several, is ended while it runs its worlds.

    When one is lost, JAX's service ends the others by abort, out of a thread in which no Python runs any more. So a
    small process waits beside this one and speaks for it. A thread of ours that watched the others would have to
    notice before JAX does, which the loss of the first process, in which the service runs, does not allow.
    """
    if jax.process_count() == 1:
        yield
        return
    who = f"process {jax.process_index()} of {jax.process_count()}"
    text = f"jaxrb: {who} was ended while it ran worlds, as it is when another one is lost. {_HOW_TO_GO_ON}"
    command = [sys.executable, "-I", "-S", "-c", _MOURNER, text]
    beside = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield
    finally:
        with contextlib.suppress(BrokenPipeError):  # it was ended before this one
            beside.communicate(b"\n")
