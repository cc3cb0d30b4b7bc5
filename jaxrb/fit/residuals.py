"""The trajectory residual: simulate a flight from its first moment, and compare with every sample.

Comparing whole trajectories reaches the Cramér–Rao bound, where regressing on differentiated gyroscope data
is eight to ten times worse. The motion is the engine's own: `jaxrb.step` with Runge–Kutta 4, so what is
fitted is exactly what will be simulated.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body import Body
from jaxrb.body.inertia import FullInertia
from jaxrb.body.state import State
from jaxrb.effects.drag import LinearDrag
from jaxrb.fit.parametrise import ratios_from_coordinates
from jaxrb.integrators import RungeKutta4
from jaxrb.math import Quaternion
from jaxrb.math.arrays import Array, Matrix, Scalar, Vector
from jaxrb.scene import Scene, step

RATIO_COORDINATES = 5


class FlightData(NamedTuple):
    """Flights of one length, padded: leading axis S in a fit, absent where one flight is simulated.

    Padding has `present` 0 and `interval` 0 (time stands still there), and repeats the last sample.
    """

    interval: Array  # (S, K) [s] from the sample before; the first is 0
    angular_velocity: Array  # (S, K, 3) [rad/s], body frame
    orientation: Array  # (S, K, 4) wxyz, body to world
    present: Array  # (S, K) 1 or 0
    spin_scale: Array  # (S,) [rad/s] standard deviation of one component of a sample's angular velocity
    attitude_scale: Array  # (S,) [rad] standard deviation of one component of a sample's attitude


class TrajectoryResidual(eqx.Module):
    """Residual (2 or 1, K, 3), flattened, of one flight, in standard deviations.

    `shared` is (5,) log-Cholesky coordinates of the inertia ratios, and with `drag` a sixth number c: a
    torque −c tr(I) ω, c in [1/s]. `local` is the first angular velocity (3,) and, where attitudes are
    compared, a rotation vector (3,) [rad] in the body frame that corrects the first attitude.
    """

    substeps: int = eqx.field(static=True)
    use_spin: bool = eqx.field(static=True)
    use_attitude: bool = eqx.field(static=True)
    drag: bool = eqx.field(static=True, default=False)

    @property
    def local_size(self) -> int:
        """How many unknowns a flight has of its own."""
        return 6 if self.use_attitude else 3

    def __call__(self, shared: Array, local: Array, data: FlightData) -> Array:
        return jnp.stack(self.channels(shared, local, data)).ravel()

    def channels(self, shared: Array, local: Array, data: FlightData) -> list[Array]:
        """Residuals (K, 3) of the angular velocity, then of the attitude: those that are in use."""
        attitude, spin = self.simulate(shared, local, data)
        present, parts = data.present[:, None], []
        if self.use_spin:
            parts.append(present * (spin - data.angular_velocity) / data.spin_scale)
        if self.use_attitude:
            turn = (Quaternion(data.orientation).inverse() @ attitude).log()
            parts.append(present * turn / data.attitude_scale)
        return parts

    def simulate(self, shared: Array, local: Array, data: FlightData) -> tuple[Quaternion, Vector]:
        """Attitude and angular velocity (K, 3) at every sample of one flight."""
        first = Quaternion(data.orientation[0])
        if self.use_attitude:
            first = first @ Quaternion.exp(local[3:6])
        damping = shared[RATIO_COORDINATES] if self.drag else None
        return tumble(
            ratios_from_coordinates(shared[:RATIO_COORDINATES]), first, local[:3], data.interval,
            self.substeps, damping,
        )  # fmt: skip


def tumble(
    inertia: Matrix,
    orientation: Quaternion,
    angular_velocity: Vector,
    interval: Array,
    substeps: int,
    damping: Scalar | None = None,
) -> tuple[Quaternion, Vector]:
    """Torque-free motion of one body, sampled.

    Args:
        inertia: (3, 3), any scale. orientation, angular_velocity: at the start, body frame [rad/s].
        interval: (K,) [s] to each sample from the one before (from the start, for the first). May be uneven
            or 0.
        substeps: Runge–Kutta steps in each interval.
        damping: c [1/s] of an optional torque −c tr(I) ω.

    Returns:
        Attitudes (K,) and angular velocities (K, 3) [rad/s], body frame.
    """
    body = Body(mass=jnp.ones_like(interval[0]), inertia=FullInertia.from_matrix(inertia))
    effects = ()
    if damping is not None:
        effects = (LinearDrag(0.0, angular_coefficient=damping * jnp.trace(inertia)),)
    scene = Scene(bodies=(body,), effects=effects)
    none = jnp.zeros((1, 3), interval.dtype)
    start = State(
        position=none,
        orientation=Quaternion(orientation.wxyz[None]),
        velocity=none,
        angular_velocity=angular_velocity[None],
        time=jnp.zeros((), interval.dtype),
    )

    def sample(state, span):
        state, _ = jax.lax.scan(
            lambda s, _: (step(scene, s, None, span / substeps, method=RungeKutta4()), None),
            state,
            length=substeps,
        )
        return state, (state.orientation.as_quaternion_array()[0], state.angular_velocity[0])

    _, (wxyz, spin) = jax.lax.scan(sample, start, interval)
    return Quaternion(wxyz), spin
