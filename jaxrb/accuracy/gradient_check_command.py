"""The body of `jaxrb gradient-check SCENE`."""

import importlib
import json as json_text
import sys
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp

from jaxrb.accuracy.gradient_check import STEPS, gradient_check
from jaxrb.accuracy.gradient_check_report import GradientCheck
from jaxrb.errors import InvalidInput
from jaxrb.io.models.load import example_named
from jaxrb.scene.example import Example
from jaxrb.scene.rollout import rollout

_HORIZONS = 32


def gradient_check_of_scene(
    scene: str,
    *,
    of: Literal["x", "y", "z"] = "x",
    with_respect_to: Literal["velocity", "position", "angular_velocity"] = "velocity",
    body: int = 0,
    dt: float | None = None,
    duration: float | None = None,
    method: str = "RungeKutta4",
    growth: bool = False,
    plot: Path | None = None,
    json: bool = False,
) -> None:
    """Which gradient of a run to trust: derivatives in both modes beside differences over many steps, and a verdict.

    The loss is where a body is at the end, along one axis; the numbers are those of the same body's start. Exit code 1
    where the gradient is not right. docs/gradients.md says how to read the verdicts.

    Example: jaxrb gradient-check bouncing_ball --duration 1 --of x
    Example: jaxrb gradient-check cube_toss --duration 0.5 --with-respect-to angular_velocity --plot cube.png

    Args:
        scene: a name (those of simulate and work-precision), a Python file that defines scene, state and duration, or a
            model (.xml, .urdf).
        of: the axis along which the final position is looked at.
        with_respect_to: the part of the start that varies.
        body: number of the body.
        dt: step [s]; by default the scene's own.
        duration: [s]; by default the scene's own.
        method: how to advance.
        growth: also how the gradient grows with the horizon.
        plot: draw the differences over their steps into this file.
        json: print one JSON object instead of a table.
    """
    from tqdm import tqdm

    example = example_named(scene)
    with tqdm(total=2 * 3 * len(STEPS), disable=not sys.stderr.isatty(), leave=False, unit=" runs") as bar:
        found, facts = checked_run(
            example, "xyz".index(of), with_respect_to, body, dt, duration, method, growth, bar.update
        )
    if plot is not None:
        # Named, not imported: pictures are made on a floor above this one, and only who draws needs them.
        view = importlib.import_module("jaxrb.view.gradient_figure")
        figure = view.gradient_figure(found, f"{example.name}, final {of} by {with_respect_to}")
        importlib.import_module("jaxrb.view.figures").save(figure, plot)
    if json:
        print(json_text.dumps(facts | found.as_dict()))
    else:
        start = f"{example.name}: final {of} of body {body} by its {with_respect_to} at the start"
        print(
            f"{start}; {facts['method']}, {facts['steps']} steps of {facts['dt_s']:g} s.\n{found.summary()}"
        )
    if not found.ok:
        sys.exit(1)


def checked_run(
    example: Example,
    axis: int,
    part: str,
    body: int = 0,
    dt: float | None = None,
    duration: float | None = None,
    method: str = "RungeKutta4",
    growth: bool = False,
    progress: Any = None,
) -> tuple[GradientCheck, dict[str, Any]]:
    """The check of a run, and what was run. A run that fails counts as a loss that is not finite."""
    state = example.state()
    if not 0 <= body < example.scene.count:
        raise InvalidInput(
            f"body is {body}, but {example.name} has {example.scene.count}; numbers start at 0"
        )
    how, step, steps = example.steps(state, method, dt, duration)

    def run(numbers: Any, every: int) -> Any:
        moved = eqx.tree_at(lambda s: getattr(s, part), state, getattr(state, part).at[body].set(numbers))
        given = {"dt": step, "steps": steps, "method": how, "save_every": every, "on_error": "flag"}
        return rollout(example.scene, moved, **given)

    def loss(numbers: Any) -> Any:
        path = run(numbers[part], steps)
        return jnp.where(path.status.ok, path.final.position[body, axis], jnp.nan)

    def over_time(numbers: Any) -> Any:
        path = run(numbers[part], max(1, steps // _HORIZONS))
        return path.times[1:], path.states.position[1:, body, axis]

    at = {part: getattr(state, part)[body]}
    found = gradient_check(loss, at, over_time=over_time if growth else None, progress=progress)
    facts = {
        "scene": example.name, "method": type(how).__name__, "dt_s": step, "steps": steps, "body": body,
        "of": "xyz"[axis], "with_respect_to": part,
    }  # fmt: skip
    return found, facts
