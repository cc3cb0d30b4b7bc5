"""Inertia from a gyroscope by MuJoCo: its own least squares over its own simulation, with finite differences.

`mujoco.sysid` calls this optimiser (`mujoco.minimize.least_squares`); its toolbox around it (extra mujoco[sysid]) is
not needed for one body, so the residual is written here: a free body, RK4, five log-Cholesky coordinates of the ratios
and the first spin.
"""

import numpy as np

from jaxrb.accuracy.mujoco_modules import mujoco_modules

mujoco, minimize, rollout = mujoco_modules("minimize", "rollout")

_MODEL = """<mujoco><option gravity="0 0 0" integrator="RK4" timestep="{step}"><flag contact="disable"/></option>
<worldbody><body name="b"><freejoint/><inertial pos="0 0 0" mass="1" fullinertia="{inertia}"/></body></worldbody>
</mujoco>"""


def mujoco_fit(times: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, int]:
    """I/tr(I) as xx, yy, zz, xy, xz, yz from angular velocities (K, 3), and the number of iterations."""
    step = float(times[1] - times[0])

    def predicted(inertia: np.ndarray, first: np.ndarray) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(
            _MODEL.format(step=step, inertia=" ".join(map(repr, inertia.tolist())))
        )
        data = mujoco.MjData(model)
        data.qvel[3:] = first
        state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        states, _ = rollout.rollout(model, data, state[None], nstep=len(times) - 1)
        return np.concatenate([first[None], np.asarray(states)[0, :, -3:]])

    def residual(columns: np.ndarray) -> np.ndarray:
        return np.stack([(predicted(_inertia(z[:5]), z[5:]) - measured).ravel() for z in columns.T], axis=1)

    start = np.concatenate([np.zeros(5), measured[0]])
    # Without bounds it runs off to a body without thickness, which MuJoCo refuses to compile.
    widest = np.array([3.0] * 5 + [50.0] * 3)
    found, trace = minimize.least_squares(
        start, residual, bounds=[-widest, widest], verbose=minimize.Verbosity.SILENT, max_iter=200
    )
    return _inertia(np.asarray(found).ravel()[:5]), len(trace)


def _inertia(five: np.ndarray) -> np.ndarray:
    lower = np.diag([*np.exp(five[:2]), 1.0])
    lower[1, 0], lower[2, 0], lower[2, 1] = five[2:]
    second = lower @ lower.T
    matrix = 0.5 * np.eye(3) - second / (2 * np.trace(second))
    return matrix[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
