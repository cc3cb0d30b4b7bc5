"""Run the whole test suite in float64 and in float32, with whatever Python runs this file.

    python tests/run.py [arguments for pytest]

The second run also checks every annotated shape at every call. Tests use the installed jaxrb, not the folder beside.
"""

import os
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
RUNS = (
    {"JAX_ENABLE_X64": "1", "JAXRB_CHECK_SHAPES": "0"},
    {"JAX_ENABLE_X64": "0", "JAXRB_CHECK_SHAPES": "1"},
)


def main() -> int:
    """Exit code: 0 if both runs pass."""
    pytest = pathlib.Path(sys.executable).with_name("pytest")
    code = 0
    for run in RUNS:
        print(*(f"{key}={value}" for key, value in run.items()), flush=True)
        command = [
            str(pytest),
            "-n",
            str(os.cpu_count() or 1),
            "--dist=loadgroup",
            "--durations=10",
            *sys.argv[1:],
        ]
        code = subprocess.run(command, cwd=ROOT, env={**os.environ, **run}, check=False).returncode or code
    return code


if __name__ == "__main__":
    sys.exit(main())
