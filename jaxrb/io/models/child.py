"""Running the compiler in a process of its own, which may take only so much memory and time."""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from jaxrb.errors import InvalidInput, JaxrbError, LimitExceeded
from jaxrb.io.models.survey import Survey

_PROGRAM = Path(__file__).with_name("compiler.py")


def compiled(survey: Survey, free_root: bool, keyframe: str | int | None) -> dict[str, Any]:
    """What MuJoCo makes of a model that was looked through; see `compiler.py` for what is in it.

    Raises:
        InvalidInput: MuJoCo refuses the model. LimitExceeded: it takes more memory or time than allowed. JaxrbError:
            MuJoCo is not installed, or its process ended without an answer.
    """
    if importlib.util.find_spec("mujoco") is None:
        raise JaxrbError("reading MJCF and URDF needs MuJoCo's compiler: pip install jaxrb[mjcf]")
    limits, name = survey.limits, survey.file.name
    meshes = {new: path.read_bytes() for new, path in survey.meshes.items()}
    job = {
        "document": survey.document,
        "assets": {new: len(data) for new, data in meshes.items()},
        "free_root": free_root,
        "keyframe": keyframe,
        "max_memory": limits.max_memory,
        "max_bodies": limits.max_bodies,
    }
    given = b"\n".join([json.dumps(job).encode(), b""]) + b"".join(meshes.values())
    # -P: the folder of the program is no place to import from. One thread: each asks for address space of its own.
    environment = {
        **os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OPENBLAS_NUM_THREADS": "1"
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as empty:
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(_PROGRAM)], input=given, capture_output=True, timeout=limits.timeout,
                cwd=empty, env=environment, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise LimitExceeded(
                f"{name}: compiling it took more than timeout={limits.timeout:g} s; make it smaller or raise that"
            ) from None
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        answer = {}
    if "memory" in answer or (not answer and b"alloc" in done.stderr):
        raise LimitExceeded(
            f"{name}: compiling it took more than max_memory={limits.max_memory} bytes; make the model smaller or "
            "raise that"
        )
    if "too_many" in answer:
        raise LimitExceeded(
            f"{name}: the model has {answer['too_many']} bodies, above max_bodies={limits.max_bodies}; raise that"
        )
    if "error" in answer:
        raise InvalidInput(f"{name}: MuJoCo refuses it: {answer['error']}")
    if not answer:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise JaxrbError(
            f"{name}: MuJoCo's process ended with code {done.returncode} and no answer: {' '.join(last)}; some of its "
            f"parts do so where memory ends, so raise max_memory={limits.max_memory} bytes or mend the model"
        )
    return answer
