"""Other programs on the same tests, in this process, where they are installed. Absence is said, never an error."""

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from jaxrb.accuracy.mujoco_modules import mujoco_modules

NOT_INSTALLED = 'not measured: MuJoCo is not installed; pip install "jaxrb[bench]"'
MUJOCO_INTEGRATORS = ("Euler", "implicitfast", "RK4")

_MODEL = """
<mujoco>
  <option timestep="{dt!r}" integrator="{integrator}" gravity="0 0 {gravity!r}"><flag energy="disable"/></option>
  <worldbody><body><freejoint/><inertial pos="0 0 0" mass="{mass!r}" diaginertia="{moments}"/></body></worldbody>
</mujoco>
"""


@dataclasses.dataclass(frozen=True)
class PeerRun:
    """States of one free body at every step, the first included: arrays over (steps + 1), and what the run cost [s]."""

    position: np.ndarray  # (k, 3) [m]
    orientation: np.ndarray  # (k, 4) wxyz
    velocity: np.ndarray  # (k, 3) [m/s] in the world frame
    angular_velocity: np.ndarray  # (k, 3) [rad/s] in the body frame
    cpu_seconds: float
    wall_seconds: float


def mujoco_version() -> str | None:
    """The version of MuJoCo that is installed; None where it is not."""
    try:
        import mujoco
    except ImportError:
        return None
    return mujoco.__version__


def mujoco_run(
    mass: float,
    moments: np.ndarray,
    velocity: Sequence[float],
    angular_velocity: Sequence[float],
    *,
    dt: float,
    steps: int,
    integrator: str,
    gravity: float = 0.0,
    repeats: int = 3,
) -> PeerRun:
    """A free body in MuJoCo, stepped in C by its own `rollout` on one thread; median times of `repeats` runs.

    `gravity` [m/s²] is along z, negative downwards. MuJoCo sorts `diaginertia` axes only for full tensors, so its body
    frame is ours.
    """
    mujoco, rollout = mujoco_modules("rollout")
    text = " ".join(repr(float(moment)) for moment in moments)
    model = mujoco.MjModel.from_xml_string(
        _MODEL.format(dt=dt, integrator=integrator, gravity=gravity, mass=float(mass), moments=text)
    )
    data = mujoco.MjData(model)
    data.qvel[:] = [*velocity, *angular_velocity]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    first = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, first, kind)
    costs, states = [], None
    for _ in range(repeats):
        cpu, wall = time.process_time(), time.perf_counter()
        states, _ = rollout.rollout(model, data, first[None], nstep=steps)
        costs.append((time.process_time() - cpu, time.perf_counter() - wall))
    path = np.concatenate([first[None], np.asarray(states)[0]])  # time, qpos (7), qvel (6)
    cpu_seconds, wall_seconds = np.median(costs, axis=0)
    return PeerRun(
        path[:, 1:4], path[:, 4:8], path[:, 8:11], path[:, 11:14], float(cpu_seconds), float(wall_seconds)
    )
