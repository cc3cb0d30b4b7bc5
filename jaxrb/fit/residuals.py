"""The trajectory residual: simulate a window of a flight from its first moment, and compare with every sample.

Comparing whole trajectories reaches the Cramér–Rao bound, where regressing on differentiated gyroscope data
is eight to ten times worse. What stands between the motion and the numbers of an instrument (bias, scale, tilt,
delay, lever arm) and what else acts on the body (drag) are unknowns by name, each fitted or held at zero.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxrb.fit.motion import Medium, angular_acceleration, tumble
from jaxrb.fit.parametrise import moved_ratios, ratios_from_coordinates
from jaxrb.math import Quaternion
from jaxrb.math.arrays import Array, Matrix
from jaxrb.math.vector import cross

RATIO_COORDINATES = 5
# Shared unknowns beside the inertia ratios: how many numbers each has, their unit, and what they are.
UNKNOWNS = {
    "scale": (1, "", "log of tr(I) over its first guess"),
    "linear_drag": (1, "1/s", "c of a torque −c tr(I) ω"),
    "quadratic_drag": (1, "1", "c of a torque −c tr(I) |ω| ω"),
    "gyro_bias": (3, "rad/s", "constant error of the angular velocity"),
    "gyro_scale": (1, "1", "relative error of the angular velocity's size"),
    "tilt": (3, "rad", "rotation from the gyroscope's axes to those of the attitude"),
    "delay": (1, "s", "how much later than the attitude the angular velocity is"),
    "metric_scale": (1, "1", "relative error of the recorded lengths; from free fall (jaxrb.fit.metre)"),
    "lever_arm": (3, "m", "from the centre of mass to the accelerometer"),
    "accelerometer_bias": (3, "m/s²", "constant error of the specific force"),
}


class FlightData(NamedTuple):
    """Windows of one length, padded: leading axes (S, W) in a fit, absent where one window is simulated.

    The first sample of a window is the last of the one before, and is compared there (`present` 0 here).
    Padding has `present` 0 and `interval` 0 (time stands still there), and repeats the last sample.
    """

    interval: Array  # (K,) [s] from the sample before; the first is 0
    angular_velocity: Array  # (K, 3) [rad/s], body frame
    orientation: Array  # (K, 4) wxyz, body to world
    specific_force: Array | None  # (K, 3) [m/s²], body frame
    internal_momentum: (
        Array | None
    )  # (K, 3) of a wheel, relative to the body, in units of the first guess of tr(I)
    present: Array  # (K,) 1 or 0
    scales: Array  # (3,) standard deviation of one component of a sample's ω [rad/s], attitude [rad], force [m/s²]


class TrajectoryResidual(eqx.Module):
    """Residuals of one window in standard deviations: angular velocity, attitude, specific force, as are in use.

    `shared` is (5,) log-Cholesky coordinates of the inertia ratios and then those of `unknowns` (names of `UNKNOWNS`).
    `local` is the first angular velocity (3,) and, where attitudes are compared, a rotation vector (3,) [rad] in the
    body frame that corrects the first attitude.
    """

    substeps: int = eqx.field(static=True)
    use_spin: bool = eqx.field(static=True)
    use_attitude: bool = eqx.field(static=True)
    use_force: bool = eqx.field(static=True, default=False)
    unknowns: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def local_size(self) -> int:
        """How many unknowns a window has of its own."""
        return 6 if self.use_attitude else 3

    @property
    def shared_size(self) -> int:
        """How many unknowns all have in common."""
        return RATIO_COORDINATES + sum(UNKNOWNS[name][0] for name in self.unknowns)

    @property
    def channels_used(self) -> tuple[int, ...]:
        """Which of angular velocity 0, attitude 1 and specific force 2 are compared."""
        return tuple(i for i, use in enumerate((self.use_spin, self.use_attitude, self.use_force)) if use)

    def place(self, name: str) -> slice:
        """Where the numbers of an unknown stand in `shared`."""
        start = RATIO_COORDINATES
        for other in self.unknowns:
            if other == name:
                return slice(start, start + UNKNOWNS[name][0])
            start += UNKNOWNS[other][0]
        raise KeyError(name)

    def value(self, shared: Array, name: str) -> Array | None:
        """The numbers of an unknown, without their axis where it is one; None if it is not among them."""
        if name not in self.unknowns:
            return None
        numbers = shared[self.place(name)]
        return numbers[0] if UNKNOWNS[name][0] == 1 else numbers

    def inertia(self, shared: Array) -> Matrix:
        """Inertia (3, 3) over the first guess of its trace."""
        ratios, scale = ratios_from_coordinates(shared[:RATIO_COORDINATES]), self.value(shared, "scale")
        return ratios if scale is None else jnp.exp(scale) * ratios

    def medium(self, shared: Array) -> Medium:
        """The drag in these unknowns."""
        return Medium(self.value(shared, "linear_drag"), self.value(shared, "quadratic_drag"))

    def move(self, shared: Array, step: Array) -> Array:
        """Ratios a step away in coordinates about themselves (`moved_ratios`), the other unknowns by their sum."""
        ratios = moved_ratios(shared[:RATIO_COORDINATES], step[:RATIO_COORDINATES])
        return jnp.concatenate([ratios, shared[RATIO_COORDINATES:] + step[RATIO_COORDINATES:]])

    def shoot(self, shared: Array, local: Array, data: FlightData) -> tuple[Array, Array]:
        """Residuals (R,) of one window, and its last angular velocity, with the attitude where that is compared."""
        attitude, spin = self.simulate(shared, local, data)
        parts = self._compare(shared, attitude, spin, data)
        last = jnp.concatenate([spin[-1], attitude.wxyz[-1]]) if self.use_attitude else spin[-1]
        return jnp.stack(parts).ravel(), last

    def gap(self, end: Array, following: Array, data: FlightData) -> Array:
        """How far a window ends from the start of the following one, in standard deviations of one sample."""
        missed = (end[:3] - following[:3]) / data.scales[0]
        if not self.use_attitude:
            return missed
        turn = (self._first(following, data).inverse() @ Quaternion(end[3:])).log()
        return jnp.concatenate([missed, turn / data.scales[1]])

    def channels(self, shared: Array, local: Array, data: FlightData) -> list[Array]:
        """Residuals (K, 3) of one window, one entry for each of `channels_used`."""
        return self._compare(shared, *self.simulate(shared, local, data), data)

    def simulate(self, shared: Array, local: Array, data: FlightData) -> tuple[Quaternion, Array]:
        """Attitude and angular velocity (K, 3) at every sample of one window."""
        momentum = data.internal_momentum
        if momentum is not None:
            momentum = jnp.concatenate([momentum[:1], momentum])
        return tumble(
            self.inertia(shared), self._first(local, data), local[:3], data.interval, self.substeps,
            self.medium(shared), momentum,
        )  # fmt: skip

    def _first(self, local: Array, data: FlightData) -> Quaternion:
        first = Quaternion(data.orientation[0])
        return first @ Quaternion.exp(local[3:6]) if self.use_attitude else first

    def _compare(self, shared: Array, attitude: Quaternion, spin: Array, data: FlightData) -> list[Array]:
        present, parts = data.present[:, None], []
        rate = None
        if self.use_force or "delay" in self.unknowns:
            rate = angular_acceleration(self.inertia(shared), spin, self.medium(shared), _wheel(data))
        if self.use_spin:
            parts.append(
                present * (self._gyroscope(shared, spin, rate) - data.angular_velocity) / data.scales[0]
            )
        if self.use_attitude:
            turn = (Quaternion(data.orientation).inverse() @ attitude).log()
            parts.append(present * turn / data.scales[1])
        if self.use_force:
            arm, bias = self.value(shared, "lever_arm"), self.value(shared, "accelerometer_bias")
            assert arm is not None
            assert rate is not None
            assert data.specific_force is not None
            felt = cross(rate, arm) + cross(spin, cross(spin, jnp.broadcast_to(arm, spin.shape)))
            felt = felt if bias is None else felt + bias
            parts.append(present * (felt - data.specific_force) / data.scales[2])
        return parts

    def _gyroscope(self, shared: Array, spin: Array, rate: Array | None) -> Array:
        """What the instrument shows (K, 3) of an angular velocity (K, 3) and its rate of change."""
        delay, tilt = self.value(shared, "delay"), self.value(shared, "tilt")
        scale, bias = self.value(shared, "gyro_scale"), self.value(shared, "gyro_bias")
        if delay is not None:
            assert rate is not None
            spin = spin - delay * rate  # to first order: delays are a small part of a turn
        if tilt is not None:
            spin = Quaternion.exp(tilt).unrotate(spin)
        spin = spin if scale is None else (1.0 + scale) * spin
        return spin if bias is None else spin + bias


def _wheel(data: FlightData) -> tuple[Array, Array] | None:
    """Momentum and its rate of change (K, 3) at the samples."""
    momentum = data.internal_momentum
    if momentum is None:
        return None
    span = jnp.where(data.interval > 0, data.interval, 1.0)[1:, None]
    change = jnp.diff(momentum, axis=0) / span
    return momentum, jnp.concatenate([change[:1], change])
