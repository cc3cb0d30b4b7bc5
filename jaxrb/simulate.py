"""`jaxrb simulate`: run a scene, say what happened, and what it cost."""

import json as json_text
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path as File
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.errors import InvalidInput
from jaxrb.integrators.names import method_of
from jaxrb.math.euler_angles import EulerAngles
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.example import Example
from jaxrb.scene.library import example_of
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.scene.settings import check_positive, check_representation, warn_of_coarse_steps
from jaxrb.scene.status import Status
from jaxrb.tables import table

SAVES, CHUNKS = 200, 20  # about so many saved states, and chunks between which the bar moves
REPRESENTATIONS = {"quaternion": Quaternion, "matrix": RotationMatrix, "euler": EulerAngles}
_DEFAULT_STEPS = 1000  # of a scene that names no step


def simulate(
    scene: str,
    *,
    dt: float | None = None,
    duration: float | None = None,
    method: str = "RungeKutta4",
    representation: Literal["quaternion", "matrix", "euler"] = "quaternion",
    save: File | None = None,
    plot: File | None = None,
    json: bool = False,
) -> None:
    """Run a scene: its energy, what contact did, and the time that it took.

    Example: jaxrb simulate stack_of_10 --plot stack.png
    Example: jaxrb simulate domino_row --duration 0.5 --save dominoes.npz --float32

    Args:
        scene: a name (bouncing_ball, billiard_break, slab_with_balls, block_on_incline, domino_row, stack_of_10, arch,
            pile_of_64, spheres_216, cube_toss, spinning_coin, tippe_top; without contact those of work-precision), or
            a Python file that defines scene, state and duration, and dt if it likes.
        dt: step [s]; by default the scene's own.
        duration: [s]; by default the scene's own.
        method: how to advance.
        representation: of rotations.
        save: write the saved states, energies and the report of contact into this NumPy file (.npz).
        plot: draw heights and energy over time and the bodies at the end, from the side, into this file.
        json: print one JSON object instead of a table.
    """
    example = example_of(scene)
    if save is not None and save.suffix != ".npz":
        raise InvalidInput(f"--save {save}: the file is a NumPy archive; give it a name that ends in .npz")
    path, facts = run(example, dt, duration, method, representation, bar=sys.stderr.isatty())
    if save is not None:
        np.savez(save, **arrays(path))  # pyright: ignore[reportArgumentType] - of savez itself
    if plot is not None:
        from jaxrb.view import figures
        from jaxrb.view.simulation_figure import simulation_figure

        figures.save(simulation_figure(path, example), plot)
    if json:
        print(json_text.dumps(facts))
        return
    count = example.scene.count
    print(f"{example.name}: {example.about}; {count} {'body' if count == 1 else 'bodies'}.")
    print(table([{"": name, "value": value} for name, value in _lines(facts)]))


def run(
    example: Example,
    dt: float | None = None,
    duration: float | None = None,
    method: str = "RungeKutta4",
    representation: str = "quaternion",
    bar: bool = False,
) -> tuple[Path, dict[str, Any]]:
    """The run as a path of about 200 saved states, and its figures.

    Raises:
        RunFailed: a state that is not finite, or more contacts than there is room for. InvalidInput, UnknownName.
    """
    state = example.state(REPRESENTATIONS[representation])
    span = example.duration if duration is None else duration
    check_positive("duration", span)
    step = next(d for d in (dt, example.dt, span / _DEFAULT_STEPS) if d is not None)
    check_positive("dt", step)
    how = method_of(method)
    check_representation(how, state)
    warn_of_coarse_steps(example.scene, state, step, how)
    steps = max(1, round(span / step))
    parts, compiling, running = _chunks(example.scene, state, step, steps, how, bar)
    path = _joined(parts)
    energy = np.asarray(path.diagnostics.energy, float)
    facts: dict[str, Any] = {
        "scene": example.name,
        "bodies": example.scene.count,
        "method": type(how).__name__,
        "representation": representation,
        "precision": str(np.dtype(state.dtype)),
        "dt_s": step,
        "steps": steps,
        "final_time_s": float(path.final.time),
        "energy_at_start_j": float(energy[0]),
        "energy_at_end_j": float(energy[-1]),
        **_contact_facts(path, steps),
        "wall_s": running,
        "to_first_step_s": compiling + running / steps,
        "body_steps_per_s": example.scene.count * steps / running,
    }
    return path, facts


def _contact_facts(path: Path, steps: int) -> dict[str, Any]:
    if path.contact is None:
        return {}
    last = jax.tree.map(lambda leaf: np.asarray(leaf)[-1], path.contact)
    return {
        "normal_work_j": float(last.normal_work),
        "friction_work_j": float(last.friction_work),
        "deepest_overlap_m": float(last.penetration),
        "worst_residual_m_s": float(last.residual),
        "poor_steps": int(last.poor),
        "newton_steps_a_step": int(last.newton_steps) / steps,
        "most_points": int(last.points),
    }


def _chunks(
    scene: Scene, state: State, dt: float, steps: int, method: Any, bar: bool
) -> tuple[list[Path], float, float]:
    """The run in stretches of one program, on the host so that a bar can move and a failure stops it."""
    from tqdm import tqdm

    length, every = layout(steps)

    def stretch(scene: Scene, state: State, dt: Any, method: Any, count: int, every: int) -> Path:
        return rollout(scene, state, dt=dt, steps=count, save_every=every, method=method, on_error="flag")

    program = jax.jit(stretch, static_argnums=(4, 5))
    step = jnp.asarray(dt, state.dtype)
    parts, done, compiling, running = [], 0, 0.0, 0.0
    compiled: dict[int, Any] = {}
    with tqdm(total=steps, disable=not bar, leave=False, unit=" steps") as progress:
        for count, saved in _stretches(steps, length, every):
            began = time.perf_counter()
            if count not in compiled:
                compiled[count] = program.lower(scene, state, step, method, count, saved).compile()
            ready = time.perf_counter()
            path = jax.block_until_ready(compiled[count](scene, state, step, method))
            compiling, running = compiling + ready - began, running + time.perf_counter() - ready
            _raise_if_bad(path.status, done)
            done, state = done + count, path.final
            parts.append(path)
            progress.update(count)
    return parts, compiling, running


def _stretches(steps: int, length: int, every: int) -> Iterator[tuple[int, int]]:
    """Steps of each stretch, and how many of them lie between saves."""
    for _ in range(steps // length):
        yield length, every
    if rest := steps % length:
        yield rest, rest


def layout(steps: int) -> tuple[int, int]:
    """Steps of a stretch and between saves: divisors where there are fitting ones, since a rest is a second program."""
    length = _near_divisor(steps, steps / CHUNKS)
    return length, _near_divisor(length, max(1.0, steps / SAVES))


def _near_divisor(number: int, wanted: float) -> int:
    found = [d for d in range(1, number + 1) if number % d == 0 and wanted / 4 <= d <= 4 * wanted]
    return min(found, key=lambda d: abs(math.log(d / wanted)), default=max(1, round(wanted)))


def _raise_if_bad(status: Status, done: int) -> None:
    first = jnp.where(status.first_bad_step >= 0, status.first_bad_step + done, status.first_bad_step)
    Status(status.reason, first).raise_if_bad()


def _joined(parts: list[Path]) -> Path:
    """One path of all; the report of contact, which each stretch begins anew, summed up."""
    later = parts[1:]
    times, states, contact = jax.tree.map(
        lambda first, *others: np.concatenate([first, *(other[1:] for other in others)]),
        *[(part.times, part.states, None) for part in parts],
    )
    if parts[0].contact is not None:
        contact = _reports([part.contact for part in parts])
    last = later[-1] if later else parts[0]
    return Path(times, states, last.final, last.status, last.scene, None, contact)


def _reports(reports: list[Any]) -> Any:
    """Reports with leading axis of saves, each of its own stretch, as one of the run."""
    largest = ("penetration", "residual", "points")
    joined = jax.tree.map(np.array, reports[0])
    for report in reports[1:]:
        before, fields = jax.tree.map(lambda leaf: leaf[-1], joined), {}
        for name in vars(joined):
            old, new = getattr(before, name), np.asarray(getattr(report, name))[1:]
            if name in largest:
                new = np.maximum(old, new)
            elif name != "overflow":  # a run in which that happens does not get here
                new = old + new
            fields[name] = np.concatenate([getattr(joined, name), new])
        joined = type(joined)(**fields)
    return joined


def arrays(path: Path) -> dict[str, np.ndarray]:
    """What `--save` writes: arrays with leading axis of saves."""
    states = path.states
    found = {
        "time": path.times,
        "position": states.position,
        "orientation_wxyz": jax.jit(Quaternion.from_rotation)(states.orientation).as_quaternion_array(),
        "velocity": states.velocity,
        "angular_velocity": states.angular_velocity,
        "energy": path.diagnostics.energy,
    }
    if path.contact is not None:
        found |= {f"contact_{name}": value for name, value in vars(path.contact).items()}
    return {name: np.asarray(value) for name, value in found.items()}


def _lines(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "method", f"{facts['method']}, {facts['representation']}, {facts['precision']}"
    yield "step", f"{facts['dt_s']:g} s, {facts['steps']} of them"
    yield "final time", f"{facts['final_time_s']:.6g} s"
    yield "energy at the start", f"{facts['energy_at_start_j']:.9g} J"
    yield "energy at the end", f"{facts['energy_at_end_j']:.9g} J"
    if "normal_work_j" in facts:
        yield "work of contact, normal", f"{facts['normal_work_j']:.6g} J"
        yield "work of contact, friction", f"{facts['friction_work_j']:.6g} J"
        yield "deepest overlap", f"{facts['deepest_overlap_m']:.2e} m"
        poor = facts["poor_steps"]
        worst = f"{facts['worst_residual_m_s']:.1e} m/s"
        yield "worst residual", worst + (f"; {poor} steps were solved poorly" if poor else "")
        yield "Newton steps a step", f"{facts['newton_steps_a_step']:.2f}"
        yield "most points pressed at a time", str(facts["most_points"])
    yield "wall time", f"{facts['wall_s']:.3g} s"
    yield "time to the first step", f"{facts['to_first_step_s']:.3g} s"
    yield "body-steps per second", f"{facts['body_steps_per_s']:.3g}"
