"""`jaxrb simulate`: run a scene, say what happened, and what it cost."""

import functools
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
from jaxrb.compilation import compiler_options
from jaxrb.errors import InvalidInput
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.io.models.load import example_named
from jaxrb.math.euler_angles import EulerAngles
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.example import Example
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene
from jaxrb.scene.stretch import begun, report_of, room_for, stretched
from jaxrb.tables import table

SAVES, STRETCHES = 200, 20  # about so many saved states, and stretches after which the bar moves
REPRESENTATIONS = {"quaternion": Quaternion, "matrix": RotationMatrix, "euler": EulerAngles}


def simulate(
    scene: str,
    *,
    dt: float | None = None,
    duration: float | None = None,
    method: str = "RungeKutta4",
    representation: Literal["quaternion", "matrix", "euler"] = "quaternion",
    save: File | None = None,
    plot: File | None = None,
    html: File | None = None,
    json: bool = False,
) -> None:
    """Run a scene: its energy, what contact did, and the time that it took.

    Example: jaxrb simulate stack_of_10 --plot stack.png
    Example: jaxrb simulate domino_row --duration 0.5 --save dominoes.npz --float32

    Args:
        scene: a name (bouncing_ball, billiard_break, slab_with_balls, block_on_incline, domino_row, stack_of_10, arch,
            pile_of_64, spheres_216, sphere_box, cube_toss, spinning_coin, tippe_top; with joints double_pendulum,
            chain, door, four_bar, bricard, ragdoll; without either those of work-precision), or
            a Python file that defines scene, state and duration, and dt if it likes, or a model (.xml, .urdf).
        dt: step [s]; by default the scene's own.
        duration: [s]; by default the scene's own.
        method: how to advance.
        representation: of rotations.
        save: write the saved states, energies, the report of contact, its points and forces into this file (.npz).
        plot: draw heights and energy over time and the bodies at the end, from the side, into this file.
        html: write a page that plays the run, without a network, into this file (see `jaxrb view`).
        json: print one JSON object instead of a table.
    """
    example = example_named(scene)
    if save is not None and save.suffix != ".npz":
        raise InvalidInput(f"--save {save}: the file is a NumPy archive; give it a name that ends in .npz")
    path, facts = run(example, dt, duration, method, representation, bar=sys.stderr.isatty())
    if save is not None:
        found = arrays(path) | _pressed(path, facts["dt_s"], method)
        np.savez(save, **found)  # pyright: ignore[reportArgumentType] - of savez itself
    if plot is not None:
        from jaxrb.view import figures
        from jaxrb.view.simulation_figure import simulation_figure

        figures.save(simulation_figure(path, example), plot)
    if html is not None:
        from jaxrb.view.viewer import view

        view(path, html, title=f"{example.name}: {example.about}")
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
    how, step, steps = example.steps(state, method, dt, duration)
    path, compiling, running = _in_stretches(example.scene, state, step, steps, how, bar)
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


def _in_stretches(
    scene: Scene, state: State, dt: float, steps: int, method: Method, bar: bool
) -> tuple[Path, float, float]:
    """The run in stretches of one program, on the host so that a bar can move and a failure stops it; and the seconds
    that compiling and running took."""
    from tqdm import tqdm

    every = near_divisor(steps, steps / SAVES)
    length = every * max(1, round(steps / every / STRETCHES))
    began = time.perf_counter()
    step, apart = jnp.asarray(dt, state.dtype), jnp.asarray(every, jnp.int32)
    progress = begun(scene, state, method)
    room = room_for(length // every)
    lowered = stretched.lower(scene, progress, None, step, method, apart, apart, room=room)
    program: Any = lowered.compile(compiler_options=compiler_options())
    if getattr(jax.config, "jax_debug_nans"):  # noqa: B009
        # only a function can be run again, operation by operation
        program = functools.partial(stretched, room=room)
    compiling, began = time.perf_counter() - began, time.perf_counter()
    rows = [jax.tree.map(lambda x: np.asarray(x)[None], (state, report_of(progress)))]
    done = 0
    with tqdm(total=steps, disable=not bar, leave=False, unit=" steps") as shown:
        while done < steps:
            end = min(done + length, steps)
            progress, part = program(scene, progress, None, step, method, jnp.asarray(end, jnp.int32), apart)
            part.status.raise_if_bad()
            saved = int(part.saved)
            rows.append(jax.tree.map(lambda x, n=saved: np.asarray(x)[:n], (part.states, part.contact)))
            shown.update(end - done)
            done = end
    if steps % every:
        rows.append(jax.tree.map(lambda x: np.asarray(x)[None], (progress.state, report_of(progress))))
    running = time.perf_counter() - began
    states, contact = jax.tree.map(lambda *x: np.concatenate(x), *rows)
    path = Path(states.time, states, progress.state, part.status, scene, None, contact)
    return path, compiling, running


def near_divisor(number: int, wanted: float) -> int:
    """A divisor of `number` near the one wanted, so that the last state saved is the last of the run."""
    found = [d for d in range(1, number + 1) if number % d == 0 and wanted / 4 <= d <= 4 * wanted]
    return min(found, key=lambda d: abs(math.log(d / wanted)), default=max(1, round(wanted)))


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


def _pressed(path: Path, dt: float, method: str) -> dict[str, np.ndarray]:
    """Points and forces of contact at the saved states, for `jaxrb view`."""
    if path.contact is None:
        return {}
    from jaxrb.view.viewer_contacts import contacts_of

    found = contacts_of(path.scene, path.states, dt, method_of(method))
    return {} if found is None else found.arrays()


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
