"""Logs as instruments write them: a hand before and after the flight, bias, scale, drag, a wheel, gaps, odd names."""

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81
HEADER = (
    "time (us), loopIteration, gyroADC[0] (deg/s), gyroADC[1] (deg/s), gyroADC[2] (deg/s), accSmooth[0] (g), "
    "accSmooth[1] (g), accSmooth[2] (g), hx [N m s], hy [N m s], hz [N m s]"
)


def smooth(x):
    """A step from 0 to 1 without corners."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def flight(inertia, first, time, wheel=0.0, change=0.0, linear=0.01, quadratic=0.001):
    """Angular velocities and rates (K, 3); a wheel's momentum about z is `wheel` (1 + `change` t)."""
    inverse, trace = np.linalg.inv(inertia), np.trace(inertia)

    def rate(t, w):
        momentum = np.array([0.0, 0.0, wheel * (1.0 + change * t)])
        slowing = trace * (linear + quadratic * np.linalg.norm(w)) * w
        return inverse @ (-np.cross(w, inertia @ w + momentum) - [0.0, 0.0, wheel * change] - slowing)

    path = solve_ivp(rate, (time[0], time[-1]), first, method="DOP853", t_eval=time, rtol=1e-9, atol=1e-10)
    return path.y.T, np.stack([rate(t, w) for t, w in zip(time, path.y.T)])


def thrown(inertia, seed, *, rate=250.0, duration=0.6, hand=0.4, size=14.0, noise=0.03, bias=0.02, scale=0.003,
           jitter=0.0, direction=None, wheel=0.0, change=0.3, arm=(0.02, -0.01, 0.03)):  # fmt: skip
    """Columns of one throw by name, and the bounds of its flight in samples."""
    random = np.random.default_rng(seed)
    time = np.arange(round(rate * (duration + 2 * hand))) / rate
    time = time + jitter / rate * random.uniform(-0.4, 0.4, size=len(time))
    start, stop = (int(np.searchsorted(time, t)) for t in (hand, hand + duration))
    first = random.normal(size=3)
    if direction is not None:
        first = np.asarray(direction) + 0.03 * first
    first = size * first / np.linalg.norm(first)
    spin, change_of_spin = flight(inertia, first, time[start:stop], wheel, change)
    before, after = time[:start], time[stop:]
    wobble, phase, pace = 3.0 * random.normal(size=3), random.uniform(0, 6, 3), random.uniform(1.5, 4.0, 3)

    def held(t):
        return wobble * np.sin(2 * np.pi * pace * t[:, None] + phase)

    rise, fall = (
        smooth((before - hand + 0.15) / 0.15)[:, None],
        smooth((after - hand - duration) / 0.12)[:, None],
    )
    whole = np.concatenate(
        [(1 - rise) * held(before) + rise * first, spin, (1 - fall) * spin[-1] + 0.5 * fall * held(after)]
    )
    bend = np.gradient(whole, time, axis=0)
    bend[start:stop] = change_of_spin
    felt = np.cross(bend, arm) + np.cross(whole, np.cross(whole, arm))
    up = random.normal(size=3)
    up = GRAVITY * up / np.linalg.norm(up)
    felt[:start] += up * (1.0 + 1.5 * smooth((before - hand + 0.15) / 0.1))[:, None]
    felt[stop:] += up * (1.0 + 3.0 * np.exp(-(((after - hand - duration - 0.03) / 0.02) ** 2)))[:, None]
    columns = {
        "time": time,
        "angular_velocity": (1 + scale) * whole
        + bias * random.normal(size=3)
        + noise * random.normal(size=whole.shape),
        "specific_force": felt + 0.1 + 0.3 * random.normal(size=felt.shape),
        "internal_momentum": np.stack([0 * time, 0 * time, wheel * (1 + change * time)], axis=-1),
    }
    return columns, (start, stop)


def write_log(file, columns, seed=0):
    """The throw as a flight controller's log: µs since long ago, deg/s, g, lost and repeated readings; how many."""
    random = np.random.default_rng(seed)
    rows, lost, repeated = [], 0, 0
    for k, now in enumerate(columns["time"]):
        cells = [str(1_700_000_000_000_000 + round(now * 1e6)), str(k)]
        cells += [f"{v:.3f}" for v in np.degrees(columns["angular_velocity"][k])]
        cells += [f"{v:.4f}" for v in columns["specific_force"][k] / 9.80665]
        cells += [f"{v:.6g}" for v in columns["internal_momentum"][k]]
        chance = random.uniform()
        if chance < 0.02:
            cells[2 + random.integers(3)] = "" if chance < 0.01 else "NaN"
            lost += 1
        rows.append(", ".join(cells))
        if 0.5 < chance < 0.51:
            rows.append(rows[-1])
            repeated += 1
    file.write_text("\n".join([HEADER, *rows, ""]))
    return lost, repeated
