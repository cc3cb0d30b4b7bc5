"""Free flights with known truth, made without the engine: SciPy's DOP853 on Euler's equations."""

import numpy as np
from scipy.integrate import solve_ivp

from jaxrb.io import Recording

TENSOR = np.array([[0.30, 0.02, 0.01], [0.02, 0.40, -0.03], [0.01, -0.03, 0.50]])  # [kg m²], trace 1.2
RATIOS = TENSOR / np.trace(TENSOR)
TOSSES, SAMPLES, RATE, NOISE = 10, 60, 100.0, 0.02  # count, count, [1/s], [rad/s]
TIME = np.arange(SAMPLES) / RATE
FIRST_SPIN = 6.0 * np.random.default_rng(5).normal(size=(TOSSES, 3))


def tumbles(inertia, first, time, drag=0.0):
    """Angular velocities (T, K, 3) and attitudes wxyz (T, K, 4) of flights with the first spins (T, 3).

    `drag` c [1/s] adds the torque −c tr(I) ω.
    """
    inertia, first = np.asarray(inertia, float), np.asarray(first, float)
    inverse, count = np.linalg.inv(inertia), len(first)

    def rate(_, y):
        q, w = y[: 4 * count].reshape(count, 4), y[4 * count :].reshape(count, 3)
        scalar = -0.5 * np.sum(q[:, 1:] * w, axis=1, keepdims=True)
        vector = 0.5 * (q[:, :1] * w + np.cross(q[:, 1:], w))
        torque = -np.cross(w, w @ inertia) - drag * np.trace(inertia) * w
        return np.concatenate([np.hstack([scalar, vector]).ravel(), (torque @ inverse).ravel()])

    start = np.concatenate([np.tile([1.0, 0.0, 0.0, 0.0], count), first.ravel()])
    path = solve_ivp(
        rate, (time[0], time[-1]), start, method="DOP853", t_eval=time, rtol=1e-11, atol=1e-12
    ).y.T
    spin = path[:, 4 * count :].reshape(-1, count, 3)
    attitude = path[:, : 4 * count].reshape(-1, count, 4)
    return spin.swapaxes(0, 1), attitude.swapaxes(0, 1)


def gyroscope(spin, time=TIME, noise=NOISE, seed=0, **more) -> Recording:
    """A recording of angular velocities (T, K, 3) with noise."""
    noisy = spin + noise * np.random.default_rng(seed).normal(size=spin.shape)
    return Recording([time] * len(spin), list(noisy), **more)
