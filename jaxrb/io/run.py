"""Long runs: progress, files to go on from, and a record of what went wrong."""

import contextlib
import os
from pathlib import Path as File
from typing import Any

from jaxrb.body.state import State
from jaxrb.errors import InvalidInput
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.io import checkpoint as files
from jaxrb.io.npz import check_target
from jaxrb.io.run_work import Show, Work
from jaxrb.io.tree import fingerprint
from jaxrb.scene import settings
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene, check_fit


def run(
    scene: Scene,
    state: State,
    *,
    dt: float,
    steps: int,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
    torque: Any = None,
    save_every: int = 1,
    chunk: int | None = None,
    checkpoint: str | os.PathLike | None = None,
    resume: bool = False,
    overhead: float = 0.01,
    failure: str | os.PathLike | None = None,
    progress: bool | Show = False,
    on_error: str = "raise",
    max_bytes: int = settings.DEFAULT_MAX_BYTES,
) -> Path:
    """`rollout` for runs that take long: in stretches of one program, with progress, files to go on from, and Ctrl-C.

    The steps and their bits do not depend on `chunk`, nor on where a run was interrupted. It runs on the host and is
    neither traced nor differentiated.

    Args:
        scene, state, dt, steps, method, torque, save_every, on_error, max_bytes: as for `rollout`.
        chunk: steps of a stretch; by default so many as take half a second.
        checkpoint: the file (.npz) from which the run can go on. It is written after a stretch, and always replaced
            whole: at any moment, killed or not, the last one that was finished is there.
        resume: go on from `checkpoint` if it exists; else its existence is an error. `steps` may have grown since.
        overhead: the share of the time that writing files may take. A stretch is not followed by a file while that
            would cost more than half of it, so what a killed run loses is at most a stretch, or `2 / overhead` times
            what a file takes; the other half is the last file's.
        failure: where the states before a failure go, with the scene, for `replay`; by default beside `checkpoint`.
        progress: True draws a bar; a function is called with the steps done and the steps wanted.

    Raises:
        RunInterrupted: Ctrl-C; what is done is in its `path`, and in the file. RunFailed: a state that is not finite,
            or another bad status; the message names the file for `replay`. InvalidInput: a file of another run, damaged
            or in the way. JaxrbError: a file that cannot be written, with the system's reason; the old one is kept.
    """
    method = method_of(method)
    check_fit(scene, state)
    settings.check_representation(method, state)
    settings.check_positive("dt", dt)
    settings.check_choice("on_error", on_error, settings.ON_ERROR)
    steps, save_every = (
        settings.check_count("steps", steps, 0),
        settings.check_count("save_every", save_every, 1),
    )
    settings.check_steps("run", steps)
    settings.check_positive("overhead", overhead, "1")
    settings.check_saved_bytes(state, steps // save_every + 1, max_bytes)
    chunk = None if chunk is None else settings.check_count("chunk", chunk, 1)
    torque = settings.applied_torque(torque, state, steps)
    settings.warn_of_coarse_steps(scene, state, dt, method)
    target = None if checkpoint is None else File(checkpoint)
    record = _failure_file(target, failure)
    origin = {"scene": scene, "method": method, "state": state, "torque": torque}
    header = {
        **{f"{name}_sha256": fingerprint(part) for name, part in origin.items()},
        "dt": float(dt),
        "save_every": save_every,
        "kind": files.CHECKPOINT,
    }
    with contextlib.ExitStack() as held:
        if target is not None:
            held.enter_context(files.only_writer(target))
            if target.exists() and not resume:
                raise InvalidInput(
                    f"{target}: exists already; give resume=True to go on from it, or another name"
                )
        work = Work(scene, method, torque, dt, steps, save_every, header, origin, target, record, overhead)
        work.begin(state, resume)
        show = held.enter_context(_shown(progress, steps))
        return work.finished(chunk, show, on_error)


def _failure_file(target: File | None, failure: str | os.PathLike | None) -> File | None:
    if failure is None:
        return None if target is None else target.with_name(f"{target.stem}.failure.npz")
    check_target(File(failure))
    return File(failure)


@contextlib.contextmanager
def _shown(progress: bool | Show, steps: int) -> Any:
    if callable(progress):
        yield progress
    elif not progress:
        yield lambda done, wanted: None
    else:
        from tqdm import tqdm

        with tqdm(total=steps, unit=" steps") as bar:
            yield lambda done, wanted: bar.update(done - bar.n)
