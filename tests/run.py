"""Run the whole test suite in float64 and in float32, with whatever Python runs this file.

    python tests/run.py [arguments for pytest]

A short third run checks annotated shapes at every call. Tests use the installed jaxrb, not the folder beside.
"""

import os
import pathlib
import subprocess
import sys
from collections.abc import Sequence

ROOT = pathlib.Path(__file__).resolve().parent.parent
RUNS = (
    {"JAX_ENABLE_X64": "1", "JAXRB_CHECK_SHAPES": "0"},
    {"JAX_ENABLE_X64": "0", "JAXRB_CHECK_SHAPES": "0"},
)
# Checked shapes make tracing three times slower, so a third run has them for the floors on which all others stand.
SHAPES = {"JAX_ENABLE_X64": "1", "JAXRB_CHECK_SHAPES": "1"}
SHAPE_TESTS = ("tests/body", "tests/math/test_quaternion_algebra.py")

# Prints XLA's name for what `rb.rollout` asks of it to compile sooner, where this release of JAX knows it.
QUICK = "import jaxrb; print(*(f'--{name}={str(value).lower()}' for name, value in jaxrb.compiler_options().items()))"


def main() -> int:
    """Exit code: 0 if all runs pass."""
    given = sys.argv[1:]
    # For the tests' own programs too: they compile in two thirds of the time.
    quick = subprocess.run([sys.executable, "-c", QUICK], capture_output=True, text=True, check=True).stdout
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {quick.strip()}".strip()
    code = 0
    for run in RUNS:
        code = pytest(run, given) or code
    return code if given else pytest(SHAPES, SHAPE_TESTS) or code


def pytest(run: dict[str, str], arguments: Sequence[str]) -> int:
    """Run pytest on all cores in an environment; its exit code."""
    print(*(f"{key}={value}" for key, value in run.items()), flush=True)
    program = pathlib.Path(sys.executable).with_name("pytest")
    # A file stays on one core, so that what its tests share is compiled once.
    spread = ["-n", str(os.cpu_count() or 1), "--dist=loadfile", "--no-loadscope-reorder"]
    command = [str(program), *spread, "--durations=10", *arguments]
    return subprocess.run(command, cwd=ROOT, env={**os.environ, **run}, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
