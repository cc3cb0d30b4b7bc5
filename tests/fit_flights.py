"""Twins of real throws, made without the engine: SciPy on Euler's equations with drag, a wheel, and instruments."""

import numpy as np
from scipy.integrate import solve_ivp

from jaxrb.io import Recording

GRAVITY = 9.81


def spins(inertia, first, time, *, linear=0.0, quadratic=0.0, wheel=(0.0, 0.0, 0.0)):
    """Angular velocities and their rates (K, 3) of one flight; drag in units of tr(I), `wheel` a constant momentum."""
    inertia, wheel = np.asarray(inertia, float), np.asarray(wheel, float)
    inverse, trace = np.linalg.inv(inertia), np.trace(inertia)

    def rate(_, w):
        slowing = trace * (linear + quadratic * np.linalg.norm(w)) * w
        return inverse @ (-np.cross(w, inertia @ w + wheel) - slowing)

    path = solve_ivp(
        rate, (time[0], time[-1]), first, method="DOP853", t_eval=time, rtol=1e-10, atol=1e-11
    ).y.T
    return path, np.stack([rate(0, w) for w in path])


def throws(inertia, seed, count, *, rate=500.0, duration=0.7, size=12.0, noise=0.02, bias=0.0, wheel=0.0, arm=None,
           handled=0.0, direction=None, **drag):  # fmt: skip
    """A recording of `count` throws.

    `wheel` [kg m²/s] is the largest of the throws' momenta about the body's z; `arm` (3,) the lever arm of an
    accelerometer; `handled` [s] of a hand before and after each flight; `direction` (3,) of the first spin.
    """
    random = np.random.default_rng(seed)
    time = np.arange(round(duration * rate)) / rate
    columns = {"time": [], "angular_velocity": [], "internal_momentum": [], "specific_force": []}
    for k in range(count):
        first = (
            random.normal(size=3)
            if direction is None
            else np.asarray(direction) + 0.03 * random.normal(size=3)
        )
        first = size * first / np.linalg.norm(first)
        momentum = np.array([0.0, 0.0, wheel * (0.3 + 0.7 * (k + 1) / count)])
        spin, change = spins(inertia, first, time, wheel=momentum, **drag)
        lever = np.zeros(3) if arm is None else np.asarray(arm)
        felt = np.cross(change, lever) + np.cross(spin, np.cross(spin, lever))
        hand = round(handled * rate)
        if hand:
            ramp = np.linspace(0.0, 1.0, hand)[:, None]
            push = GRAVITY * np.array([0.3, 0.5, 1.0]) * (1.0 + 2.0 * ramp)
            swing = 0.5 * random.normal(size=3) + 2.0 * np.sin(9.0 * np.linspace(0, handled, hand))[:, None]
            spin = np.concatenate(
                [ramp * spin[0] + (1 - ramp) * swing, spin, ramp[::-1] * spin[-1] + 0.3 * swing]
            )
            felt = np.concatenate([push, felt, push[::-1] * 1.5])
        columns["time"].append(np.arange(len(spin)) / rate)
        columns["angular_velocity"].append(spin + bias + noise * random.normal(size=spin.shape))
        columns["internal_momentum"].append(np.tile(momentum, (len(spin), 1)))
        columns["specific_force"].append(felt + 0.05 * random.normal(size=felt.shape))
    if not wheel:
        del columns["internal_momentum"]
    if arm is None:
        del columns["specific_force"]
    return Recording(**columns)
