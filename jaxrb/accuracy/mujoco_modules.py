"""MuJoCo, where it is installed, kept from writing into the folder that a program is run in."""

import importlib
import importlib.util
from typing import Any


def mujoco_modules(*names: str) -> tuple[Any, ...]:
    """`mujoco` and its modules `names`, such as "rollout".

    MuJoCo tells of a state that it resets by a line in a file MUJOCO_LOG.TXT in the current folder, unless somebody
    listens. Whoever compares looks at its states, which say more.

    Raises:
        ImportError: it is not installed.
    """
    mujoco = importlib.import_module("mujoco")
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_heard)
    return mujoco, *(importlib.import_module(f"mujoco.{name}") for name in names)


def _heard(message: str) -> None:
    """Nothing is written."""
