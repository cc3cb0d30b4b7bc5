"""Makes `tumbling_brick.npz`: the recording of a gyroscope in a brick that is tossed ten times.

Run as `python -m jaxrb.data.make_tumbling_brick`. It is simulated, so the truth is known:

- brick of 200 × 100 × 40 mm, uniform, 700 kg/m³: I/tr(I) = 0.1124, 0.4031, 0.4845 about its own axes, which are
  the body axes (exact: 29, 104, 125 over 258),
- ten tosses in free flight, 0.8 s each, sampled at 200 Hz (161 samples); first spins normal with 5 rad/s a
component,
- noise of 0.02 rad/s (standard deviation, each component and sample independent), seed 20240229,
- simulated by `jaxrb.rollout` in float64 with Runge–Kutta 4 at 1 ms; kept are angular velocities only.

The same facts stand in the file's `metadata`.
"""

from pathlib import Path

import jax
import numpy as np

from jaxrb.body import Body
from jaxrb.geometry import Box
from jaxrb.integrators import RungeKutta4
from jaxrb.io import Recording, write_recording
from jaxrb.scene import Scene, rollout

HALF_EXTENTS = (0.10, 0.05, 0.02)  # [m]
DENSITY = 700.0  # [kg/m³]
TOSSES, RATE, DURATION = 10, 200.0, 0.8  # count, [1/s], [s]
SPIN, NOISE, SEED = 5.0, 0.02, 20240229  # [rad/s], [rad/s]
STEPS_A_SAMPLE = 5


def make() -> Recording:
    """The recording, with noise, and with the truth in its metadata."""
    random = np.random.default_rng(SEED)
    first = SPIN * random.normal(size=(TOSSES, 3))
    dt = 1.0 / RATE / STEPS_A_SAMPLE
    samples = round(DURATION * RATE)
    with jax.enable_x64(True):
        brick = Body.from_shape(Box(half_extents=HALF_EXTENTS), density=DENSITY)
        scene = Scene(bodies=(brick,) * TOSSES)
        path = rollout(
            scene,
            scene.state(angular_velocity=first),
            dt=dt,
            steps=samples * STEPS_A_SAMPLE,
            save_every=STEPS_A_SAMPLE,
            method=RungeKutta4(),
        )
        spin = np.swapaxes(np.asarray(path.states.angular_velocity), 0, 1)
        moments = np.diag(np.asarray(brick.inertia.as_matrix()))
    noisy = spin + NOISE * random.normal(size=spin.shape)
    time = np.arange(samples + 1) / RATE
    return Recording(
        time=[time] * TOSSES,
        angular_velocity=list(noisy),
        metadata={
            "body": "uniform brick",
            "half_extents_m": list(HALF_EXTENTS),
            "density_kg_m3": DENSITY,
            "true_inertia_kg_m2": moments.tolist(),
            "true_ratios": (moments / moments.sum()).tolist(),
            "gyroscope_noise_rad_s": NOISE,
            "seed": SEED,
            "made_by": "python -m jaxrb.data.make_tumbling_brick",
        },
    )


if __name__ == "__main__":
    print(write_recording(make(), Path(__file__).with_name("tumbling_brick.npz")))
