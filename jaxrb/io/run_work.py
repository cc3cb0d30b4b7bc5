"""A long run at work: what it has done, what it keeps, and when it writes."""

import time
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.errors import InvalidInput, RunFailed, RunInterrupted
from jaxrb.integrators.method import Method
from jaxrb.io import checkpoint as files
from jaxrb.io.rows import Rows
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene
from jaxrb.scene.status import Status
from jaxrb.scene.stretch import Progress, begun, report_of, room_for, stretched

_SECONDS = 0.5  # that a stretch is to take: between them a bar moves and Ctrl-C is heard
_BUFFER = 64 * 2**20  # bytes of saved states on the device
_MAX_FILE = 8 * 2**30

Show = Callable[[int, int], None]


class Work:
    """A run at work: where it is, what it saved, when it wrote."""

    def __init__(
        self,
        scene: Scene,
        method: Method,
        torque: Any,
        dt: float,
        steps: int,
        save_every: int,
        header: dict[str, Any],
        origin: dict[str, Any],
        target: File | None,
        record: File | None,
        overhead: float,
    ):
        self.scene, self.method, self.torque, self.steps = scene, method, torque, steps
        self.every, self.header, self.origin = save_every, header, origin
        self.target, self.record, self.overhead = target, record, overhead
        self.dt = jnp.asarray(dt, origin["state"].dtype)
        self.saved: Rows  # states and reports of contact
        self.at: tuple[
            Progress, int
        ]  # with the rows saved by then: in one, so that Ctrl-C finds both of one moment
        self.status: Status | None = None
        self.written = -1  # steps done in the newest file
        # What the newest file took to write [s], and when that was; the states saved in it.
        self.cost, self.since, self.rows_written = 0.0, time.monotonic(), 0
        self.sums = files.Sums()

    def begin(self, state: State, resume: bool) -> None:
        """At the first step, or where the file says."""
        start = begun(self.scene, state, self.method)
        first = jax.tree.map(np.asarray, (start.state, report_of(start)))
        self.saved, self.at = Rows(jax.tree.map(lambda x: x[None], first)), (start, 1)
        if not (resume and self.target is not None and self.target.exists()):
            return
        file = files.RunFile(self.target, _MAX_FILE)
        for name, value in self.header.items():
            file.expect(name, value, "give what the run was begun with, or another file")
        rows = file.tree("saved", first, rows=True)
        done = file.number("done")
        count = {len(leaf) for leaf in jax.tree.leaves(rows)}
        if count != {done // self.every + 1}:
            raise InvalidInput(
                f"{self.target}: {sorted(count)} states were saved in {done} steps; take another copy"
            )
        if done > self.steps:
            raise InvalidInput(
                f"{self.target}: has done {done} steps, more than steps = {self.steps}; raise steps"
            )
        self.saved, self.written = Rows(rows), done
        self.at = jax.tree.map(jnp.asarray, file.tree("progress", start)), count.pop()

    @property
    def progress(self) -> Progress:
        """What the next step needs."""
        return self.at[0]

    @property
    def rows(self) -> int:
        """States saved so far."""
        return self.at[1]

    @property
    def done(self) -> int:
        """Steps made."""
        return int(self.progress.done)

    def finished(self, chunk: int | None, show: Show, on_error: str) -> Path:
        """The whole run."""
        room = self._room()
        count = chunk if chunk is not None else min(self.every, 64)
        pace = _Pace()
        self.since = time.monotonic()
        try:
            show(self.done, self.steps)
            while self.done < self.steps:
                # One row more than fits may be begun: a stretch ends where the buffer does.
                here = min(count, (room - 1) * self.every, self.steps - self.done)
                began = time.monotonic()
                self._advance(here, room, on_error)
                if chunk is None:
                    count = pace.next(here, time.monotonic() - began)
                self._write_if_due()
                show(self.done, self.steps)
        except KeyboardInterrupt:
            self._write_checkpoint()
            kept = "" if self.target is None else f"; {self.target} goes on from there with resume=True"
            raise RunInterrupted(
                f"run: interrupted after {self.done} of {self.steps} steps{kept}", self.path()
            ) from None
        self._write_checkpoint()
        path = self.path()
        if on_error == "raise":
            path.raise_if_bad()  # a state that was bad before the first of no steps
        return path

    @property
    def failed(self) -> bool:
        """Whether the status is bad."""
        return self.status is not None and not bool(self.status.ok)

    def _room(self) -> int:
        """Rows of the buffer of saved states: structure of the program, so nothing that changes from try to try."""
        return max(2, min(room_for(self.steps // self.every), 1024, _BUFFER // self.saved.row_bytes))

    def _advance(self, count: int, room: int, on_error: str) -> None:
        """Make `count` steps; of the first failure keep a record, and raise it if so wanted."""
        now, found = stretched(
            self.scene, self.progress, self.torque, self.dt, self.method, jnp.int32(self.done + count),
            jnp.int32(self.every), room=room,
        )  # fmt: skip
        found = jax.block_until_ready(found)
        bad_before, self.status = self.failed, found.status
        if self.failed and not bad_before:
            kept = self._write_failure()
            if on_error == "raise":
                self._raise(kept)
        self.at = now, self.saved.put(self.rows, (found.states, found.contact), int(found.saved))

    def _raise(self, kept: File | None) -> None:
        assert self.status is not None
        try:
            self.status.raise_if_bad()
        except RunFailed as error:
            where = (
                ""
                if kept is None
                else f". The last good state, step {self.done}, is in {kept}: rb.replay shows it"
            )
            raise RunFailed(f"{error}{where}") from None

    def path(self) -> Path:
        """What is done so far."""
        states, contact = self.saved.first(self.rows)
        status = self.status
        if status is None:  # no step was made here, and only good states are in files
            unsound = self.progress.unsound
            status = Status(unsound, jnp.where(unsound != 0, 0, -1).astype(jnp.int32))
        return Path(states.time, states, self.progress.state, status, self.scene, None, contact)

    def _write_if_due(self) -> None:
        # A file holds all that was saved so far, and costs the more the more that is. Half of the share is left to the
        # last file, which follows whatever was written when.
        grown = max(1.0, self.rows / max(self.rows_written, 1))
        if (time.monotonic() - self.since) * 0.5 * self.overhead >= self.cost * grown:
            self._write_checkpoint()

    def _write_checkpoint(self) -> None:
        if self.target is None or self.failed or self.done == self.written:
            return
        began = time.monotonic()
        self._write(self.target, self.header)
        self.written = self.done
        self.since = time.monotonic()
        self.cost, self.rows_written = self.since - began, self.rows

    def _write_failure(self) -> File | None:
        """The states before the stretch that failed, and at which step it did."""
        if self.record is None:
            return None
        assert self.status is not None
        steps = np.asarray(self.status.first_bad_step)[np.asarray(self.status.reason) != 0]
        self._write(self.record, self.header | {"kind": files.FAILURE, "first_bad_step": int(steps.min())})
        return self.record

    def _write(self, path: File, header: dict[str, Any]) -> None:
        saved = self.saved.first(self.rows)
        files.write(path, header | {"done": self.done}, self.origin, self.progress, saved, self.sums)


class _Pace:
    """Steps of the next stretch. The first one compiles the program, and says nothing of the pace."""

    def __init__(self) -> None:
        self.known = False

    def next(self, steps: int, seconds: float) -> int:
        if not self.known:
            self.known = True
            return max(steps, 1)
        return max(1, int(steps * min(8.0, _SECONDS / max(seconds, 1e-6))))
