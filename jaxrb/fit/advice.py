"""What motion would determine more: the Fisher information of throws not made yet."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.fit.packing import rounded
from jaxrb.fit.residuals import FlightData
from jaxrb.fit.stages import Fitted, Problem
from jaxrb.fit.uncertainty import directions, fitted_information, in_words

# Twenty-six axes: those through the faces, edges and corners of a cube, and one sign of each is enough.
_AXES = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)], float
)
_UNEVEN = 0.1  # part of the spin that a hand puts about another axis


class Advice(NamedTuple):
    """The throw that would shrink the largest standard error of the ratios most.

    `axis` (3,) in the body frame, `gain` the factor by which one more throw about it, as fast and as long as the
    fastest so far, shrinks that error; `weakest` is the direction of the ratios that is known least, in words.
    """

    axis: np.ndarray
    gain: float
    weakest: str

    def sentence(self) -> str:
        """The advice in words."""
        x, y, z = self.axis
        return (
            f"Known least: {self.weakest}. One more throw about the body axis ({x:.2f}, {y:.2f}, {z:.2f}) would divide "
            f"the largest error by {self.gain:.2f}."
        )


def next_throw(problem: Problem, fitted: Fitted) -> Advice:
    """Compare throws about thirteen axes, as fast and as long as the fastest and longest of the recording."""
    flights = problem.flights.flights
    spin = np.concatenate([problem.spin[f.start : f.stop] for f in flights])
    longest = max(flights, key=len)
    spans = np.diff(problem.recording.time[longest.start : longest.stop])
    count = rounded(len(spans)) + 1
    shared, free = fitted.solution.shared, jnp.asarray(problem.free)
    speed = float(np.sqrt(np.max(np.sum(spin**2, axis=1))))
    wheel = None if problem.recording.internal_momentum is None else jnp.zeros((count, 3))
    data = FlightData(
        interval=jnp.asarray(np.concatenate([[0.0], np.full(count - 1, spans.mean())])),
        angular_velocity=jnp.zeros((count, 3)),
        orientation=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (count, 1)),
        specific_force=jnp.zeros((count, 3)) if problem.residual.use_force else None,
        internal_momentum=wheel,
        present=jnp.ones(count),
        scales=jnp.asarray(fitted.scales),
    )
    # Nobody throws a body about one axis alone.
    first = _AXES / np.linalg.norm(_AXES, axis=1, keepdims=True) + _UNEVEN * np.roll(_AXES, 1, axis=1)
    first = speed * first / np.linalg.norm(first, axis=1, keepdims=True)
    more = np.asarray(jax.jit(_information)(problem.residual, shared, free, jnp.asarray(first), data))
    now = fitted_information(problem, fitted.solution, fitted.weight)
    found = directions(now, np.asarray(shared))
    then = [
        directions(now._replace(total=now.total + part), np.asarray(shared)).deviation[0] for part in more
    ]
    best = int(np.argmin(then))
    return Advice(first[best] / speed, float(found.deviation[0] / then[best]), in_words(found.rows[:1])[0])


def _information(residual: Any, shared: Any, free: Any, first: Any, data: FlightData) -> Any:
    """Information (A, P, P) on the shared unknowns from a flight with each first spin (A, 3)."""
    p = shared.size

    def one(spin):
        local = jnp.zeros(residual.local_size).at[:3].set(spin)

        def shot(z):
            return residual.shoot(residual.move(shared, free * z[:p]), local + z[p:], data)[0]

        jacobian = jax.jacfwd(shot)(jnp.zeros(p + local.size))
        product = jacobian.T @ jacobian
        return product[:p, :p] - product[:p, p:] @ jnp.linalg.solve(product[p:, p:], product[p:, :p])

    return jax.vmap(one)(first)
