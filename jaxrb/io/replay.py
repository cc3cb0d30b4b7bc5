"""Looking again at a run that failed."""

import os
from pathlib import Path as File
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.io.checkpoint import CHECKPOINT, FAILURE, RunFile
from jaxrb.io.tree import fingerprint
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import check_count, check_positive
from jaxrb.scene.stretch import Progress, begun, report_of, room_for, stretched


def replay(
    file: str | os.PathLike, scene: Scene | None = None, *, last: int = 1000, max_bytes: int = 2**33
) -> Path:
    """The `last` steps up to a failure that `rb.run` recorded, made again with the same bits, each of them saved.

    `status.first_bad_step` counts from the beginning of the run, as the run did; `times` are the run's.

    Args:
        file: what the message of the failure names.
        scene: that of the run, where the file cannot hold it: a scene with functions of one's own.
        last: steps before the failure to look at; fewer where the record begins later.
        max_bytes: refuse larger files.

    Raises:
        InvalidInput: no such record, damaged, or of another scene. WrongStructure: another floating type.
    """
    last = check_count("last", last, 1)
    found = RunFile(File(file), max_bytes)
    scene, method, torque, dt, progress = opened(found, scene)
    done, bad = found.number("done"), found.number("first_bad_step")
    start = max(done, bad - last)

    def advanced(end: int, every: int) -> tuple:
        with found.must_fit():
            return stretched(
                scene, progress, torque, dt, method, jnp.int32(end), jnp.int32(every), room=room_for(last)
            )

    if start > done:
        progress, _ = advanced(start, 2**30)
    first = jax.tree.map(lambda x: np.asarray(x)[None], (progress.state, report_of(progress)))
    progress, made = advanced(bad, 1)
    rows = jax.tree.map(lambda x: np.asarray(x)[: int(made.saved)], (made.states, made.contact))
    states, contact = jax.tree.map(lambda *parts: np.concatenate(parts), first, rows)
    return Path(states.time, states, progress.state, made.status, scene, None, contact)


def opened(found: RunFile, scene: Scene | None = None) -> tuple[Scene, Method, Any, Any, Progress]:
    """What `replay` goes on from: scene, method, torque (or None), dt () [s], and how far the run was.

    Raises:
        InvalidInput: as of `replay`; also for a file whose checksum is right and whose content is no run.
    """
    if found.header.get("kind") != FAILURE:
        mend = "continue it with rb.run(…, checkpoint=…, resume=True)" if found.header.get(
            "kind") == CHECKPOINT else "give the file that a failed run named"  # fmt: skip
        raise InvalidInput(f"{found.path}: is no record of a failure; {mend}")
    if scene is None:
        scene = found.origin("scene", Scene)
    assert scene is not None
    found.expect("scene_sha256", fingerprint(scene), "give the scene as it was")
    state, method, torque = (
        found.origin("state", State),
        found.origin("method", Method),
        found.origin("torque"),
    )
    dt = found.header.get("dt")
    check_positive("dt", dt)
    with found.must_fit():
        check_fit(scene, state)
        if jax.dtypes.canonicalize_dtype(state.dtype) != state.dtype:
            raise WrongStructure(
                f"{found.path}: was run in {state.dtype}; start Python with JAX_ENABLE_X64=1"
            )
        like = jax.eval_shape(begun, scene, state, method)
        torque = None if torque is None else jnp.asarray(torque)
        dt = jnp.asarray(dt, state.dtype)
    return scene, method, torque, dt, jax.tree.map(jnp.asarray, found.tree("progress", like))
