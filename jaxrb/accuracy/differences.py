"""How far two scenes part from one start."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.integrators.method import Method
from jaxrb.math.arrays import Scalar
from jaxrb.math.safe import norm
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

PLACES = 64  # along the run at which the two are compared


@dataclasses.dataclass(frozen=True)
class Difference:
    """Largest differences over all bodies and places: attitude [rad], position [m], velocity [m/s], rate of turn
    [rad/s]; infinite where one of the runs leaves the finite numbers and the other does not."""

    attitude: float
    position: float
    velocity: float
    angular_velocity: float

    @property
    def largest(self) -> float:
        """The larger of attitude [rad] and position [m]: the measure of tolerances."""
        return max(self.attitude, self.position)


def difference(one: Scene, other: Scene, state: State, dt: float, steps: int, method: Method) -> Difference:
    """How far two scenes part over `steps` steps of `dt` [s] from the same start, at most."""
    every = max(1, steps // PLACES)
    paths = [
        rollout(scene, state, dt=dt, steps=steps, method=method, save_every=every, on_error="flag")
        for scene in (one, other)
    ]
    if not all(bool(path.status.ok) for path in paths):
        return Difference(*4 * (np.inf,))
    apart = _apart(*(path.states for path in paths)), _apart(*(_one(path.final) for path in paths))
    return Difference(*(max(float(a), float(b)) for a, b in zip(*apart, strict=True)))


def _one(state: State) -> State:
    return jax.tree.map(lambda leaf: leaf[None], state)


@jax.jit
def _apart(a: State, b: State) -> tuple[Scalar, ...]:
    pairs = (
        (a.position, b.position), (a.velocity, b.velocity), (a.angular_velocity, b.angular_velocity)
    )  # fmt: skip
    position, velocity, omega = (jnp.max(norm(x - y)) for x, y in pairs)
    attitude = jnp.max(a.orientation.normalise().angle_to(b.orientation.normalise()))
    return attitude, position, velocity, omega
