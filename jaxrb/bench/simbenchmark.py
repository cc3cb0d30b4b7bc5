"""Rows C of the scoreboard: SimBenchmark's tests of contact (J. Hwangbo, J. Lee, leggedrobotics, 2018).

Four laws with known answers: energy of elastic bounces, rolling on what slides, no overlap in a heap that falls, energy
of a heap that bounces. Where places are jittered, figures are means over seeds, with the lowest and the highest.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

from jaxrb.accuracy.timing import compiled
from jaxrb.bench.published import BOUNCING, ELASTIC_666, INELASTIC_666, ROLLING, Published
from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import HalfSpace, Sphere
from jaxrb.scene.contact_library import GRAVITY, slab_with_balls, spheres_216
from jaxrb.scene.example import Example
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.scene.status import TOO_MANY_CONTACTS

SAMPLES = 1000  # states of a run that are judged, at most
LENGTHS = ("quick", "default", "long")
ROLLING_GOAL = 1e-12  # (m/s)²
INELASTIC_GOAL, INELASTIC_DT = 1e-8, 1e-3  # m² at this step
_PAIRS = np.triu_indices(216, 1)
_NEAR = 6  # pairs a body that may touch in a step: at dt 1e-2 a falling ball comes as far as half its radius
_METHOD = "RungeKutta4"

Entry = dict[str, Any]
BOUNCING_COLUMNS = {"energy_j2": "mean (E − E₀)² [J²]", "goal": "goal", "verdict": ""}
ROLLING_COLUMNS = {
    "slab": "slab, mean sq. [(m/s)²]",
    "ball": "ball, mean sq. [(m/s)²]",
    "both": "both",
    "goal": "goal",
    "verdict": "",
}
_SPREAD = {"low": "lowest seed", "high": "highest seed", "goal": "goal", "verdict": ""}
INELASTIC_COLUMNS = {"overlap_m2": "mean Σ overlap² [m²]", **_SPREAD}
ELASTIC_COLUMNS = {"energy_j2": "mean (E − E₀)² [J²]", **_SPREAD}


def bouncing_row(length: str = "default") -> Iterator[Entry]:
    """49 balls, 10 kg, dropped from 5 m on the floor without loss, 20 s."""
    yield from (result.entry() for result in BOUNCING)
    ball = Body(10.0, 0.4 * 10.0 * 0.1**2, Sphere(0.1))
    scene = Scene(replicate(ball, 49), (GRAVITY, RigidContact(HalfSpace(), restitution=1.0)))
    start = {"position": [(float(i % 7), float(i // 7), 5.0) for i in range(49)]}
    example = Example("bouncing", "", scene, start, 20.0)
    steps_of = {"quick": (1e-2,), "default": (1e-2, 1e-3), "long": (1e-2, 1e-3, 1e-4)}[length]
    for dt in steps_of:
        run = _Program(example, dt)
        goal = _raisim(BOUNCING, "energy_j2", dt)
        yield from _entries(run, [example.state()], "energy_j2", energy_error, dt, goal, "RaiSim", "20 s")


def rolling_row(length: str = "default") -> Iterator[Entry]:
    """A slab pushed over the ground with 25 balls on it, 4 s: mean squared errors of their velocities."""
    yield from (result.entry() for result in ROLLING)
    duration = 1.0 if length == "quick" else 4.0
    steps_of = (1e-3,) if length == "quick" else (1e-2, 1e-3)
    for name, direction in (("y", (0.0, 1.0)), ("oblique", (0.5, 0.75**0.5))):
        example = slab_with_balls(direction)
        state = example.state()
        for dt in steps_of:
            run = _Program(example, dt, duration)
            path, cpu, wall = run(state)
            slab, ball = rolling_errors(path, np.asarray(direction))
            found = {"slab": slab, "ball": ball, "both": slab + ball}
            goal = ROLLING_GOAL if duration >= 4.0 else None
            verdict, said = _verdict(path, slab + ball, goal), "" if goal is None else f"≤ {goal:.0e}"
            setting = f"{name}, dt {dt:g}, {duration:g} s"
            yield _entry(setting, found, said, verdict, cpu, wall, run.first, state)


def inelastic_row(length: str = "default") -> Iterator[Entry]:
    """216 balls fall on each other and stay, 10 s: time mean of the summed squared overlaps."""
    yield from (result.entry() for result in INELASTIC_666)
    yield from _spheres(
        length, False, "overlap_m2", overlap, lambda dt: (_inelastic_goal(dt), "goal at 1e-3")
    )


def elastic_row(length: str = "default") -> Iterator[Entry]:
    """216 balls bounce on each other without loss, 10 s: mean squared error of the energy."""
    yield from (result.entry() for result in ELASTIC_666)
    goal = lambda dt: (_raisim(ELASTIC_666, "energy_j2", dt), "RaiSim")  # noqa: E731
    yield from _spheres(length, True, "energy_j2", energy_error, goal)


def _inelastic_goal(dt: float) -> float | None:
    return INELASTIC_GOAL if math.isclose(dt, INELASTIC_DT) else None


def _spheres(
    length: str,
    elastic: bool,
    figure: str,
    judge: Callable[[Path], float],
    goal_of: Callable[[float], tuple[float | None, str]],
) -> Iterator[Entry]:
    three = (0, 1, 2)
    plan = {
        "quick": ((1e-2, 2.0, (0,)),),
        "default": ((1e-2, 10.0, three), (1e-3, 10.0, three)),
        "long": ((1e-2, 10.0, three), (1e-3, 10.0, three), (1e-4, 10.0, three)),
    }[length]
    for dt, duration, seeds in plan:
        capacity = _NEAR * 216 if elastic else None
        examples = [spheres_216(elastic, seed, capacity) for seed in seeds]
        run = _Program(examples[0], dt, duration)
        states = [example.state() for example in examples]
        # Over less than the published time a figure is no match for a published one.
        goal, whose = goal_of(dt) if duration >= 10.0 else (None, "")
        setting = f"{duration:g} s, {len(seeds)} seed{'s' if len(seeds) > 1 else ''}"
        yield from _entries(run, states, figure, judge, dt, goal, whose, setting)


class _Program:
    """A run of an example compiled ahead: path, CPU and wall seconds of a call; `first` is the CPU time to compile."""

    def __init__(self, example: Example, dt: float, duration: float | None = None):
        steps = round((duration or example.duration) / dt)
        every = max(1, steps // SAMPLES)

        def run(scene: Scene, state: State) -> Path:
            return rollout(
                scene, state, dt=dt, steps=steps, save_every=every, method=_METHOD, on_error="flag"
            )

        self.scene = example.scene
        self.program, self.first, _ = compiled(jax.jit(run), example.scene, example.state())

    def __call__(self, state: State) -> tuple[Path, float, float]:
        cpu, wall = time.process_time(), time.perf_counter()
        path = jax.block_until_ready(self.program(self.scene, state))
        return path, time.process_time() - cpu, time.perf_counter() - wall


def _entries(
    run: _Program,
    states: Sequence[State],
    figure: str,
    judge: Callable[[Path], float],
    dt: float,
    goal: float | None,
    whose: str,
    setting: str,
) -> Iterator[Entry]:
    """One entry for all seeds: the mean, the lowest and the highest; the verdict is on the highest."""
    values, times, verdict = [], [], "no goal for this"
    for state in states:
        path, cpu, wall = run(state)
        values.append(judge(path))
        times.append((cpu, wall))
        if not verdict.startswith("FAILED") and verdict != "missed":
            verdict = _verdict(path, values[-1], goal)
    found = {figure: float(np.mean(values)), "low": min(values), "high": max(values)}
    cpu, wall = np.mean(times, axis=0)
    said = "" if goal is None else f"≤ {goal:.3g} ({whose})"
    yield _entry(f"dt {dt:g}, {setting}", found, said, verdict, float(cpu), float(wall), run.first, states[0])


def _verdict(path: Path, value: float, goal: float | None) -> str:
    reason = np.asarray(path.status.reason).max()
    if reason:
        return "FAILED: too many contacts" if reason == TOO_MANY_CONTACTS else "FAILED"
    if goal is None:
        return "no goal for this"
    return "met" if value <= goal else "missed"


def _entry(
    setting: str,
    found: dict[str, float],
    goal: str,
    verdict: str,
    cpu: float,
    wall: float,
    first: float,
    state: State,
) -> Entry:
    who = "jaxrb" if np.dtype(state.dtype) == np.float64 else "jaxrb, float32"
    costs = {"cpu_s": cpu, "wall_s": wall, "compile_cpu_s": first}
    return {"who": who, "setting": setting, **found, "goal": goal, "verdict": verdict, **costs}


def _raisim(results: Sequence[Published], figure: str, dt: float) -> float | None:
    """RaiSim's figure at this step, if it was published."""
    found = [
        r.figures[figure]
        for r in results
        if r.who == "RaiSim" and math.isclose(float(r.setting.split()[-1]), dt)
    ]
    return found[0] if found else None


def energy_error(path: Path) -> float:
    """Time mean of (E − E₀)² [J²]."""
    energy = np.asarray(path.diagnostics.energy, float)
    return float(np.mean((energy - energy[0]) ** 2))


def rolling_errors(path: Path, direction: np.ndarray) -> tuple[float, float]:
    """Mean squared velocity errors [(m/s)²] of the slab and of one corner ball.

    The slab (M) slides under the push F, each of N balls (m) rolls on it with 2/7 of its acceleration.
    """
    push, slab, ball, count, friction, gravity = 150.0, 10.0, 1.0, 25, 0.4, 9.81
    pulled = (push - friction * (slab + count * ball) * gravity) / (slab + count * ball * 2.0 / 7.0)
    times, velocity = np.asarray(path.times, float), np.asarray(path.states.velocity, float)
    ahead = times[:, None] * np.append(direction / np.linalg.norm(direction), 0.0)
    slab_off = np.sum((velocity[:, 0] - pulled * ahead) ** 2, axis=-1)
    ball_off = np.sum((velocity[:, 1] - 2.0 / 7.0 * pulled * ahead) ** 2, axis=-1)
    return float(slab_off.mean()), float(ball_off.mean())


def overlap(path: Path) -> float:
    """Time mean of the sum of squared overlaps [m²], of balls with each other and with the floor."""
    return float(np.mean([_overlap_of(p) for p in np.asarray(path.states.position, float)]))


def _overlap_of(position: np.ndarray, radius: float = 0.1) -> float:
    apart = np.linalg.norm(position[_PAIRS[0]] - position[_PAIRS[1]], axis=-1)
    deep = np.clip(2 * radius - apart, 0.0, None), np.clip(radius - position[:, 2], 0.0, None)
    return float(sum(np.sum(d**2) for d in deep))
