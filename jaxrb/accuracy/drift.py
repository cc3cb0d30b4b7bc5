"""The lecture's demonstration: a set of free boxes in each representation, and what becomes of the numbers."""

import dataclasses

import jax
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.geometry.primitives import Box
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Array
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

# The reference takes so many steps of RK4 for one of the methods under test; its error is 4000 times below theirs.
REFINEMENT = 8


@dataclasses.dataclass(frozen=True)
class Boxes:
    """A set of free boxes on a grid, each with edges and a spin of its own."""

    scene: Scene
    half_extents: np.ndarray  # (n, 3) [m]
    position: np.ndarray  # (n, 3) [m]
    angular_velocity: np.ndarray  # (n, 3) [rad/s], body frame
    torque: np.ndarray  # (n, 3) [N m], body frame

    def state(self, rotation: type[Rotation]) -> State:
        """The start, in a representation."""
        return self.scene.state(self.position, angular_velocity=self.angular_velocity, rotation=rotation)


def free_boxes(count: int = 9, seed: int = 0) -> Boxes:
    """`count` boxes of wood with edges of 0.2 to 0.8 m that spin at 1 to 3 rad/s, the same for the same seed."""
    random = drawn(seed)
    half = random.uniform(0.1, 0.4, (count, 3))
    side = int(np.ceil(np.sqrt(count)))
    grid = np.stack([np.arange(count) % side, np.arange(count) // side, np.zeros(count)], axis=-1) * 1.5
    axes = random.normal(size=(count, 3))
    spin = random.uniform(1.0, 3.0, (count, 1)) * axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    bodies = tuple(Body.from_shape(Box(h), density=600.0, name=f"box {i}") for i, h in enumerate(half))
    # About 0.1 rad/s² whatever the size of the box.
    trace = np.array([np.asarray(body.inertia.trace()) for body in bodies])
    torque = 0.03 * trace[:, None] * random.normal(size=(count, 3))
    return Boxes(Scene(bodies), half, grid, spin, torque)


@dataclasses.dataclass(frozen=True)
class DriftRun:
    """One run of the demonstration; arrays over saved times (k,) and bodies (n,)."""

    representation: str
    renormalised: bool
    method: str
    with_torque: bool
    iterations: np.ndarray  # (k,)
    path: Path
    attitude_error: np.ndarray  # (k, n) [rad]
    scale: np.ndarray  # (k, n)
    skew: np.ndarray  # (k, n)

    def row(self, iteration: int) -> dict[str, object]:
        """Largest values over the bodies after so many iterations."""
        at = int(np.searchsorted(self.iterations, iteration))
        return {
            "method": self.method,
            "representation": self.representation,
            "renormalised": self.renormalised,
            "torque": self.with_torque,
            "iterations": int(self.iterations[at]),
            "attitude_error_rad": float(self.attitude_error[at].max()),
            "scale_error": float(np.abs(self.scale[at]).max()),
            "skew": float(self.skew[at].max()),
        }


def reference(boxes: Boxes, dt: float, steps: int, save_every: int, with_torque: bool) -> Array:
    """Orientations wxyz (k, n, 4) at the saved times, from steps that are `REFINEMENT` times finer."""
    path = rollout(
        boxes.scene,
        boxes.state(Quaternion),
        dt=dt / REFINEMENT,
        steps=steps * REFINEMENT,
        save_every=save_every * REFINEMENT,
        torque=boxes.torque if with_torque else None,
        method=RungeKutta4(),
    )
    return path.states.orientation.as_quaternion_array()


def drift_run(
    boxes: Boxes,
    rotation: type[Rotation],
    method: Method,
    exact: Array,
    *,
    dt: float,
    steps: int,
    save_every: int,
    with_torque: bool,
) -> DriftRun:
    """Run the boxes in one representation and compare with the reference."""
    path = rollout(
        boxes.scene,
        boxes.state(rotation),
        dt=dt,
        steps=steps,
        save_every=save_every,
        torque=boxes.torque if with_torque else None,
        method=method,
    )
    error, scale, skew = _compare(path.states.orientation, exact)
    return DriftRun(
        rotation.name,
        method.renormalise,
        type(method).__name__,
        with_torque,
        np.arange(steps // save_every + 1) * save_every,
        path,
        np.asarray(error),
        np.asarray(scale),
        np.asarray(skew),
    )


@jax.jit
def _compare(orientation: Rotation, exact: Array) -> tuple[Array, Array, Array]:
    drift = orientation.drift()
    return Quaternion(exact).angle_to(orientation.normalise()), drift.scale, drift.skew
