"""MuJoCo's compiler for many spoiled models: one process that has it loaded forks another for each of them.

Loading takes a second, compiling a small model a millisecond. What a fork does is what `io/models/compiler.py` does in
a process of its own, to the same limits; a fork that dies takes nothing with it.
"""

import atexit
import importlib.util
import json
import os
import select
import signal
import struct
import subprocess
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from jaxrb.io.models import child

_LENGTH = struct.Struct("<q")


class Compiler:
    """Takes the place of `subprocess` in `io/models/child.py`: the same call, answered by a fork.

    `forks`: how many models were compiled.
    """

    TimeoutExpired = subprocess.TimeoutExpired

    def __init__(self) -> None:
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # no thread may be lost by a fork
        command = [sys.executable, "-m", "jaxrb.hard.fuzz_compiler"]
        self._server = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
        )
        self.forks = 0
        atexit.register(self.close)

    def close(self) -> None:
        """End the process."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.close()
        self._server.wait()
        self._server.stdout.close()
        atexit.unregister(self.close)

    def run(
        self, command: list[str], *, input: bytes, timeout: float, **_: Any
    ) -> subprocess.CompletedProcess:
        """As `subprocess.run` with captured output.

        Raises:
            TimeoutExpired: the fork took longer than `timeout` [s] and was killed.
        """
        to, back = self._server.stdin, self._server.stdout
        assert to is not None
        assert back is not None
        for part in (json.dumps(timeout).encode(), input):
            to.write(_LENGTH.pack(len(part)) + part)
        to.flush()
        code, out, error = json.loads(_received(back)), _received(back), _received(back)
        self.forks += 1
        if code is None:
            raise subprocess.TimeoutExpired(command, timeout)
        return subprocess.CompletedProcess(command, code, out, error)


def installed() -> Compiler:
    """A compiler that all models of this process go to from now on."""
    compiler = Compiler()
    child.subprocess = compiler  # pyright: ignore[reportAttributeAccessIssue]
    return compiler


def _received(stream: Any) -> bytes:
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError("the process that forks for each model is gone")
    return stream.read(*_LENGTH.unpack(head))


def _serve() -> None:
    """Fork for each job, until there are no more."""
    import mujoco  # noqa: F401 - what the forks are for

    path = Path(child.__file__).with_name("compiler.py")
    spec = importlib.util.spec_from_file_location("compiler", path)
    assert spec is not None
    assert spec.loader is not None
    compiler = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(compiler)
    os.chdir("/")
    jobs, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    while head := jobs.read(_LENGTH.size):
        timeout = json.loads(jobs.read(*_LENGTH.unpack(head)))
        for part in _forked(compiler.main, _received(jobs), timeout):
            answers.write(_LENGTH.pack(len(part)) + part)
        answers.flush()


def _forked(main: Any, given: bytes, timeout: float) -> tuple[bytes, bytes, bytes]:
    """Exit code as JSON (null where it was killed for taking too long), output and errors of `main` in a fork."""
    to, out, error = os.pipe(), os.pipe(), os.pipe()
    process = os.fork()
    if process == 0:
        code = 1
        try:
            for place, end in enumerate((to[0], out[1], error[1])):
                os.dup2(end, place)
            os.closerange(3, 256)  # the jobs of others among them
            sys.stdin = os.fdopen(0, "r")
            main()
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    for end in (to[0], out[1], error[1]):
        os.close(end)
    late = _fed(to[1], given, {out[0]: (told := []), error[0]: (said := [])}, time.monotonic() + timeout)
    if late:
        os.kill(process, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    return json.dumps(None if late else code).encode(), b"".join(told), b"".join(said)


def _fed(to: int, given: bytes, found: dict[int, list[bytes]], deadline: float) -> bool:
    """Write what is given and read what comes until all ends are closed; True where that takes too long."""
    os.set_blocking(to, False)
    left, reading, writing = memoryview(given), list(found), [to]
    late = False
    while reading and not late:
        rest = deadline - time.monotonic()
        ready, free, _ = select.select(reading, writing, [], max(rest, 0.0))
        late = not ready and not free
        for end in free:
            try:
                left = left[os.write(end, left[:65536]) :]
            except BrokenPipeError:
                left = left[:0]
            if not left:
                os.close(end)
                writing = []
        for end in ready:
            if data := os.read(end, 65536):
                found[end].append(data)
            else:
                reading.remove(end)
    for end in (*writing, *found):
        os.close(end)
    return late


if __name__ == "__main__":
    _serve()
