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
from jaxrb.errors import InvalidInput
from jaxrb.fit.first_order import by_optimiser
from jaxrb.fit.least_squares import MEANING, levenberg_marquardt
from jaxrb.fit.problem import Alone
from jaxrb.fit.unknowns import Unknowns, names_of, unknowns_of, unraveled
from jaxrb.integrators.method import Method
from jaxrb.io.recording import Recording
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.scene import Scene

CHANNELS = {"position": "m", "velocity": "m/s", "orientation": "rad", "angular_velocity": "rad/s"}
# Strengths of the logarithmic barrier of a bounding shape, in squares of a standard deviation, one stage after the
# other (Nocedal and Wright 2006, section 19.6): the last moves an estimate that is not held back by a millionth.
_BARRIERS = (1.0, 1e-2, 1e-4, 1e-6)
_FINE = 1e-14  # of the cost: a prior is a small part of it, and decides alone where the data are blind


@dataclass(frozen=True)
class SceneFit:
    """Unknowns of a scene as found.

    `unknowns` has the tree that was given, `standard_errors` the same; `covariance` (P, P) is that of `names` in order,
    model-based, with the noise that the residuals show. `noise` has the root mean square residual of each channel in
    its own unit. `held` names the bodies that a bounding shape holds back: their error bars take the bound as known.
    """

    unknowns: Any
    standard_errors: Any
    covariance: np.ndarray
    names: tuple[str, ...]
    scene: Scene
    noise: dict[str, float]
    iterations: int
    ended: str
    held: tuple[str, ...] = ()


def fit_scene(
    scene: Scene | Callable[[Any], Scene],
    recording: Recording,
    unknowns: Any,
    *,
    state: State | Callable[[Any], State],
    observe: Callable[[Any, State], Mapping[str, Any]] | None = None,
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
            for a function, the tree of numbers to start from, in which `jaxrb.fit.Inertial` stands for all ten inertial
            parameters of a body. Numbers that start positive stay so: they are fitted by their logarithm.
        state: at the first sample; or a function from the unknowns to it, so that they may hold its numbers too.
        observe: what is recorded of the unknowns and the states (K samples, 1 body), by channel, where it is not the
            motion of the body itself: a tracked point beside the centre of mass, another metre, a biased gyroscope.
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
    start, build = _to_build(scene, unknowns)
    wanted = unknowns_of(start)
    if wanted.penalised and huber is not None:
        raise InvalidInput(
            "fit: huber would bend a prior or bounding shape too; give optimiser=… and a robust loss instead."
        )

    def residual(step, _, data):
        found = wanted.values(step)
        first = state(found) if callable(state) else state
        path = rollout(
            build(found), first, dt=dt / steps_per_sample, steps=(len(recording.time) - 1) * steps_per_sample,
            save_every=steps_per_sample, method=method, on_error="flag",
        )  # fmt: skip
        shown = {} if observe is None else observe(found, path.states)
        return jnp.concatenate(
            [_off(name, path.states, shown, data[name]).ravel() / compared[name] for name in compared]
            + [wanted.penalty(step, data["barrier"])]
        )

    data: dict[str, Any] = {
        name: jnp.asarray(getattr(recording, name), wanted.dtype)[None, None] for name in compared
    }
    data["barrier"] = jnp.full((1, 1), _BARRIERS[-1], wanted.dtype)
    bound, count = np.inf if huber is None else huber, _count(recording, compared)
    if optimiser is None:
        moved, information, iterations, ended = _by_squares(residual, wanted, data, bound, max_iterations)
    else:
        moved, information, iterations, ended = by_optimiser(
            residual, jnp.zeros(wanted.size, wanted.dtype), data, optimiser, _whole(loss, count), max_iterations,
            progress or (lambda line: None),
        )  # fmt: skip
    alone = jax.tree.map(lambda measured: measured[0, 0], data)
    left = np.asarray(residual(moved, None, alone))[:count]
    # A bound makes nothing known: what data and priors leave open is looked for without it.
    without = {**data, "barrier": 0.0 * data["barrier"]}
    seen = _solve(residual, moved, without, bound, 0)[1] if wanted.bounded else information
    wanted.check_seen(seen, moved, recording.source)
    covariance = _covariance(wanted, moved, information, left) * (1.0 if loss is None else np.nan)
    return _result(wanted, moved, build, covariance, _noise(left, compared), iterations, ended)


def _to_build(scene: Scene | Callable[[Any], Scene], unknowns: Any) -> tuple[Any, Callable[[Any], Scene]]:
    """The tree to start from, and the scene with other numbers in its place."""
    if isinstance(scene, Scene):
        return unknowns(scene), lambda values: eqx.tree_at(unknowns, scene, values)
    return unknowns, scene


def _covariance(wanted: Unknowns, step: Any, information: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Of the tree's numbers (N, N), with the noise that the residuals (R,) of the data show."""
    rates, variance = wanted.rates(step), float(left @ left) / max(left.size - wanted.size, 1)
    return variance * rates @ np.linalg.inv(information) @ rates.T


def _by_squares(residual: Any, wanted: Unknowns, data: dict[str, Any], huber: float, max_iterations: int):
    """The step (P,) from the start by Levenberg–Marquardt, the information there, iterations, and how it ended."""
    step, total = jnp.zeros(wanted.size, wanted.dtype), 0
    information, ended = np.zeros((wanted.size, wanted.size)), ""
    tolerance, damping = _FINE if wanted.penalised else 1e-9, 1e-3
    for barrier in _BARRIERS if wanted.bounded else _BARRIERS[-1:]:
        stage = {**data, "barrier": jnp.full((1, 1), barrier, wanted.dtype)}
        step, information, iterations, ended = _solve(
            residual, step, stage, huber, max_iterations, tolerance, damping
        )
        total, damping = total + iterations, 1e-12
    return step, information, total, ended


def _solve(
    residual: Any,
    step: Any,
    data: dict[str, Any],
    huber: float,
    max_iterations: int,
    tolerance: float = 1e-9,
    damping: float = 1e-3,
):
    solution = levenberg_marquardt(
        Alone(residual), step, jnp.zeros((1, 1, 0), step.dtype), data, weight=jnp.ones(1, step.dtype),
        free=jnp.ones_like(step), huber=huber, max_iterations=max_iterations, tolerance=tolerance,
        damping=damping,
    )  # fmt: skip
    information = np.asarray(solution.normal.shared[0], float)
    return solution.shared, information, int(solution.iterations), MEANING[int(solution.status)]


def _whole(loss: Callable[[Any], Any] | None, count: int) -> Callable[[Any], Any] | None:
    """A loss of the data's residuals, the first `count`, with half the squares of the others added."""
    if loss is None:
        return None
    return lambda r: loss(r[:count]) + 0.5 * jnp.sum(r[count:] ** 2)


def _result(
    wanted: Unknowns, step: Any, build: Any, covariance: np.ndarray, noise: dict, iterations: int, ended: str
) -> SceneFit:
    found = wanted.values(step)
    return SceneFit(
        unknowns=found,
        standard_errors=unraveled(np.sqrt(np.diag(covariance)), found),
        covariance=covariance,
        names=names_of(found),
        scene=build(found),
        noise=noise,
        iterations=iterations,
        ended=ended,
        held=wanted.reached(step),
    )


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


def _off(name: str, states: State, shown: Mapping[str, Any], measured: Any) -> Any:
    """Difference (K, 3) of the one body's motion, or what is observed of it, from what was measured."""
    if name == "orientation":
        wxyz = shown.get(name, states.orientation.as_quaternion_array()[:, 0])
        return (Quaternion(measured).inverse() @ Quaternion(wxyz)).log()
    return shown.get(name, getattr(states, name)[:, 0]) - measured


def _count(recording: Recording, compared: Mapping[str, float]) -> int:
    return 3 * len(recording.time) * len(compared)


def _noise(left: np.ndarray, compared: Mapping[str, float]) -> dict[str, float]:
    parts = np.split(left, len(compared))
    return {name: float(np.sqrt(np.mean(p**2))) * scale for p, (name, scale) in zip(parts, compared.items())}
