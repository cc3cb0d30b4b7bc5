"""Any numbers of a scene from a recording: least squares through `rb.rollout`, whatever the scene's effects."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.rollout import rollout
from jaxrb.body.state import State
from jaxrb.errors import InvalidInput, NotIdentifiable
from jaxrb.fit.first_order import by_optimiser
from jaxrb.fit.least_squares import MEANING, levenberg_marquardt
from jaxrb.fit.problem import Alone
from jaxrb.integrators.method import Method
from jaxrb.io.recording import Recording
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.scene import Scene

CHANNELS = {"position": "m", "velocity": "m/s", "orientation": "rad", "angular_velocity": "rad/s"}
_ROUND_OFF = 1e-12  # of the information, relative to its largest direction, once each number has its own unit


@dataclass(frozen=True)
class SceneFit:
    """Unknowns of a scene as found.

    `unknowns` has the tree that was given, `standard_errors` the same; `covariance` (P, P) is that of `names` in order,
    model-based, with the noise that the residuals show. `noise` has the root mean square residual of each channel in
    its own unit.
    """

    unknowns: Any
    standard_errors: Any
    covariance: np.ndarray
    names: tuple[str, ...]
    scene: Scene
    noise: dict[str, float]
    iterations: int
    ended: str


def fit_scene(
    scene: Scene | Callable[[Any], Scene],
    recording: Recording,
    unknowns: Any,
    *,
    state: State | Callable[[Any], State],
    scales: Mapping[str, float] | None = None,
    steps_per_sample: int = 1,
    method: Method | str | None = None,
    huber: float | None = None,
    max_iterations: int = 50,
    optimiser: Any = None,
    loss: Callable[[Any], Any] | None = None,
    progress: Callable[[str], None] | None = None,
) -> SceneFit:
    """Numbers of a scene of one body from one toss, by least squares through `rb.rollout`.

    Args:
        scene: a scene, or a function from the unknowns to one, such as from half extents and density to a box on a
            floor: the derivative then goes through shape, mass properties, dynamics and contact at once.
        recording: one toss at an even rate, with any of position, velocity, orientation and angular velocity.
        unknowns: for a scene, a function that picks leaves of it, such as `lambda scene: scene.effects[1].coefficient`;
            for a function, the tree of numbers to start from. Numbers that start positive stay so: they are fitted by
            their logarithm.
        state: at the first sample; or a function from the unknowns to it, so that they may hold its numbers too.
        scales: standard deviations by channel ("position" [m], "velocity" [m/s], "orientation" [rad],
            "angular_velocity" [rad/s]); only these are compared. By default all that were recorded, equally trusted
            relative to their root mean square.
        steps_per_sample: steps of the method between two samples.
        method: as of `rb.rollout`.
        huber: standard deviations beyond which a residual's pull stops growing.
        max_iterations: of Levenberg–Marquardt, or steps of the optimiser.
        optimiser: an optax transformation, such as `optax.adam(0.05)`, in place of Levenberg–Marquardt. It steps in
            logarithms of the unknowns that start positive, and in units of their start for the others.
        loss: of the residuals (R,) in standard deviations, in place of half their sum of squares; needs an optimiser.
            Its error bars are not known, and are NaN.
        progress: called with a line of text now and then (with an optimiser).

    Raises:
        InvalidInput: for a recording of several tosses, an uneven rate, a channel that is not there, or a loss without
            an optimiser.
        NotIdentifiable: if the motion leaves a combination of the unknowns open; `null_vectors` (n, P) are relative
            changes.
    """
    if loss is not None and optimiser is None:
        raise InvalidInput("fit: a loss of your own needs an optimiser, such as optimiser=optax.adam(0.05).")
    dt, compared = _checked(recording, scales)
    if isinstance(scene, Scene):
        start, given = unknowns(scene), scene

        def build(values: Any) -> Scene:
            return eqx.tree_at(unknowns, given, values)
    else:
        start, made = unknowns, scene

        def build(values: Any) -> Scene:
            return made(values)

    flat, unit, values = _coordinates(start)

    def residual(step, _, data):
        found = values(step)
        first = state(found) if callable(state) else state
        path = rollout(
            build(found), first, dt=dt / steps_per_sample, steps=(len(recording.time) - 1) * steps_per_sample,
            save_every=steps_per_sample, method=method, on_error="flag",
        )  # fmt: skip
        return jnp.concatenate(
            [_off(name, path.states, data[name]).ravel() / compared[name] for name in compared]
        )

    data = {name: jnp.asarray(getattr(recording, name), flat.dtype)[None, None] for name in compared}
    if optimiser is None:
        bound = np.inf if huber is None else huber
        moved, information, iterations, ended = _by_squares(residual, flat, data, bound, max_iterations)
    else:
        moved, information, iterations, ended = by_optimiser(
            residual, flat, data, optimiser, loss, max_iterations, progress or (lambda line: None)
        )
    left = residual(moved, None, {name: measured[0, 0] for name, measured in data.items()})
    found = values(moved)
    numbers = jnp.concatenate([jnp.ravel(value) for value in jax.tree.leaves(found)])
    rates = np.asarray(jnp.where(flat > 0, numbers, unit))
    rest = np.asarray(left)
    covariance = _covariance(information, rest, rates, _names(found), recording.source)
    covariance = covariance if loss is None else np.full_like(covariance, np.nan)
    return _result(found, build(found), covariance, _noise(rest, compared), iterations, ended)


def _coordinates(start: Any) -> tuple[Any, Any, Callable[[Any], Any]]:
    """The numbers of a tree (P,), the unit of each one's step, and the tree a step (P,) away."""
    leaves, tree = jax.tree.flatten(start)
    shapes = [np.shape(leaf) for leaf in leaves]
    flat = jnp.concatenate([jnp.ravel(jnp.asarray(leaf, float)) for leaf in leaves])
    if not bool(jnp.all(jnp.isfinite(flat))):
        raise InvalidInput(f"fit: an unknown starts at {np.asarray(flat).tolist()}; give finite numbers.")
    positive, unit = flat > 0, jnp.where(flat == 0, 1.0, jnp.abs(flat))

    def values(step):
        moved = jnp.where(positive, flat * jnp.exp(jnp.where(positive, step, 0.0)), flat + unit * step)
        cuts = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
        parts = [part.reshape(shape) for part, shape in zip(jnp.split(moved, cuts), shapes)]
        return jax.tree.unflatten(tree, parts)

    return flat, unit, values


def _by_squares(residual: Any, flat: Any, data: Any, huber: float, max_iterations: int):
    """The step (P,) from the start by Levenberg–Marquardt, the information there, iterations, and how it ended."""
    solution = levenberg_marquardt(
        Alone(residual), jnp.zeros_like(flat), jnp.zeros((1, 1, 0), flat.dtype), data, weight=jnp.ones(1, flat.dtype),
        free=jnp.ones_like(flat), huber=huber, max_iterations=max_iterations,
    )  # fmt: skip
    information = np.asarray(solution.normal.shared[0], float)
    return solution.shared, information, int(solution.iterations), MEANING[int(solution.status)]


def _result(
    found: Any, scene: Scene, covariance: np.ndarray, noise: dict, iterations: int, ended: str
) -> SceneFit:
    leaves, tree = jax.tree.flatten(found)
    shapes = [np.shape(leaf) for leaf in leaves]
    errors = np.split(np.sqrt(np.diag(covariance)), np.cumsum([int(np.prod(s)) for s in shapes])[:-1])
    return SceneFit(
        unknowns=found,
        standard_errors=jax.tree.unflatten(tree, [e.reshape(s) for e, s in zip(errors, shapes)]),
        covariance=covariance,
        names=_names(found),
        scene=scene,
        noise=noise,
        iterations=iterations,
        ended=ended,
    )


def _covariance(
    information: np.ndarray, left: np.ndarray, rates: np.ndarray, names: tuple[str, ...], source: str
) -> np.ndarray:
    """By the residuals `left`; `rates` (P,) turn steps of the fit into the unknowns' own units."""
    _refuse_open(information, names, source)
    variance = float(left @ left) / max(left.size - len(rates), 1)
    return variance * np.linalg.inv(information) * rates[:, None] * rates


def _checked(recording: Recording, scales: Mapping[str, float] | None) -> tuple[float, dict[str, float]]:
    """The interval between samples [s] and the standard deviation of each channel that is compared."""
    if recording.tosses != 1:
        raise InvalidInput(f"{recording.source}: {recording.tosses} tosses; fit a scene to one at a time.")
    spans = np.diff(recording.time)
    if np.ptp(spans) > 1e-3 * spans.mean():
        raise InvalidInput(
            f"{recording.source}: samples lie {spans.min():.4g} to {spans.max():.4g} s apart; resample."
        )
    recorded = [name for name in CHANNELS if getattr(recording, name) is not None]
    for name in scales or {}:
        if name not in recorded:
            raise InvalidInput(
                f"fit: scales has {name!r}, which {recording.source} has not: {', '.join(recorded)}."
            )
    if scales is not None:
        return float(spans.mean()), dict(scales)
    sizes = {name: float(np.sqrt(np.mean(getattr(recording, name) ** 2))) for name in recorded}
    sizes |= {"orientation": 1.0} if "orientation" in recorded else {}
    return float(spans.mean()), {name: max(size, 1e-9) for name, size in sizes.items()}


def _off(name: str, states: State, measured: Any) -> Any:
    """Difference (K, 3) of the one body's motion from what was measured."""
    if name == "orientation":
        there = Quaternion(states.orientation.as_quaternion_array()[:, 0])
        return (Quaternion(measured).inverse() @ there).log()
    return getattr(states, name)[:, 0] - measured


def _names(start: Any) -> tuple[str, ...]:
    names = []
    for path, leaf in jax.tree_util.tree_flatten_with_path(start)[0]:
        name = jax.tree_util.keystr(path).strip(".[]'") or "unknown"
        shape = np.shape(leaf)
        names += [name if not shape else f"{name}{list(index)}" for index in np.ndindex(*shape)]
    return tuple(names)


def _refuse_open(information: np.ndarray, names: tuple[str, ...], source: str) -> None:
    if not np.all(np.isfinite(information)):
        raise NotIdentifiable(f"{source}: the motion has no finite derivative by {', '.join(names)}.")
    values, vectors = np.linalg.eigh(information)
    null = vectors.T[values <= _ROUND_OFF * max(values[-1], 1e-300)]
    if len(null):
        words = [
            " ".join(f"{value:+.2g} {name}" for value, name in zip(row, names) if abs(value) > 0.05)
            for row in null
        ]
        error = NotIdentifiable(
            f"{source}: nothing that was recorded changes along {'; '.join(words)} (relative). Hold one of them."
        )
        error.null_vectors = null  # pyright: ignore[reportAttributeAccessIssue]
        raise error


def _noise(left: np.ndarray, compared: Mapping[str, float]) -> dict[str, float]:
    parts = np.split(left, len(compared))
    return {name: float(np.sqrt(np.mean(p**2))) * scale for p, (name, scale) in zip(parts, compared.items())}
