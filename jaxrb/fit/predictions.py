"""Tosses side by side, and how far a scene's predictions from their first states are off: one compiled program."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.fit.metre import METRIC_SCALE
from jaxrb.io.recording import Recording
from jaxrb.math.quaternion import attitude_error
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

Scenes = Callable[[Mapping[str, Any]], Scene]
NEEDED = ("position", "orientation", "velocity", "angular_velocity")


class Recorded(NamedTuple):
    """Tosses (n) of frames (t), the shorter ones filled up with their last frame; `there` (n, t)."""

    position: np.ndarray
    orientation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    there: np.ndarray

    def some(self, rows: np.ndarray) -> "Recorded":
        """The tosses of these numbers."""
        return Recorded(*(part[rows] for part in self))


def recorded(recording: Recording) -> tuple[Recorded, float]:
    """The tosses side by side, and samples a second.

    Raises:
        InvalidInput: a quantity that is missing, or samples that are not even.
    """
    missing = [name for name in NEEDED if getattr(recording, name) is None]
    if missing:
        raise InvalidInput(
            f"{recording.source}: a toss begins with {', '.join(NEEDED)}; {missing[0]} is missing."
        )
    within = np.ones(len(recording.time), bool)
    within[recording.starts[:-1]] = False
    spans = np.diff(recording.time)[within[1:]]
    if not len(spans) or np.ptp(spans) > 1e-3 * spans.mean():
        raise InvalidInput(f"{recording.source}: samples are not at one even rate; resample.")
    return side_by_side({name: getattr(recording, name) for name in NEEDED}, recording.length), 1.0 / float(
        spans.mean()
    )


def side_by_side(columns: Mapping[str, np.ndarray], length: np.ndarray) -> Recorded:
    """Columns (N, …) of tosses one after the other, as (n, t, …)."""
    ends = np.cumsum(length)
    numbers = np.minimum(
        np.arange(length.max()) + (ends - length)[:, None], (ends - 1)[:, None]
    )  # the last frame again after the end
    there = np.arange(length.max()) < length[:, None]
    return Recorded(*(columns[name][numbers] for name in Recorded._fields[:-1]), there)  # pyright: ignore[reportCallIssue]


def toss_errors(
    tosses: Recorded, rate: float, scene: Scenes, numbers: Mapping[str, float], substeps: int = 4
) -> tuple[np.ndarray, np.ndarray]:
    """Mean errors (n,) of each toss: of position [m], in the recording's metres, and attitude [rad]."""
    with jax.enable_x64(True):
        program = _program(scene, tuple(numbers), tosses.there.shape[1] - 1, rate, substeps)
        found = program(jnp.asarray(list(numbers.values())), *(jnp.asarray(part) for part in tosses))
        return np.asarray(found[0]), np.asarray(found[1])


@functools.lru_cache(maxsize=8)
def _program(scene: Scenes, names: tuple[str, ...], frames: int, rate: float, substeps: int) -> Any:
    def one(scene: Scene, metre: Any, toss: Recorded) -> tuple[Any, Any]:
        state = scene.state(
            position=(toss.position[0] / metre)[None],
            orientation=toss.orientation[0][None],
            velocity=(toss.velocity[0] / metre)[None],
            angular_velocity=toss.angular_velocity[0][None],
        )
        path = rollout(
            scene,
            state,
            dt=1.0 / (rate * substeps),
            steps=frames * substeps,
            save_every=substeps,
            on_error="flag",
        )
        apart = jnp.linalg.norm(path.states.position[:, 0] * metre - toss.position, axis=-1)
        chord = attitude_error(path.states.orientation.as_quaternion_array()[:, 0], toss.orientation)
        angle = 4.0 * jnp.arcsin(jnp.minimum(0.25 * chord, 1.0))
        weight = toss.there / jnp.sum(toss.there)
        return jnp.sum(weight * apart), jnp.sum(weight * angle)

    def run(numbers: Any, *tosses: Any) -> tuple[Any, Any]:
        named = dict(zip(names, numbers))
        built, metre = scene(named), 1.0 + named.get(METRIC_SCALE, 0.0)
        return jax.vmap(lambda toss: one(built, metre, toss))(Recorded(*tosses))

    return jax.jit(run)
