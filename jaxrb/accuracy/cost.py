"""What each effect of a scene costs, and what leaving it out would change."""

import dataclasses
import functools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.differences import Difference, difference
from jaxrb.accuracy.reference import end_state
from jaxrb.accuracy.timing import compiled, interleaved
from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.errors import WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import check_count, check_positive, check_representation
from jaxrb.tables import table

# A run for the clock lasts so long [s] that its start and end do not count.
_SAMPLE = 4e-3


@dataclasses.dataclass(frozen=True)
class Size:
    """A compiled step: equations of its jaxpr, operations of the optimised program, CPU seconds to compile, scratch
    memory [B], and CPU seconds a step of the whole scene."""

    equations: int
    operations: int
    compile_seconds: float
    bytes: int
    step_seconds: float


@dataclasses.dataclass(frozen=True)
class EffectCost:
    """One effect: what the step would be without it, and what would change.

    `size` is that of the scene without the effect. `share` of the step goes when it goes. `difference` is how far the
    motion without it is from the motion with it, at most, over the horizon; None where the scene cannot do without it.
    """

    name: str
    index: int
    size: Size
    share: float
    difference: Difference | None


@dataclasses.dataclass(frozen=True)
class CostReport:
    """The cost of a scene: `whole`, `bare` (no effects: free flight by the same method), and each effect."""

    method: str
    bodies: int
    precision: str
    dt: float
    steps: int
    whole: Size
    bare: Size
    effects: tuple[EffectCost, ...]

    @property
    def share_of_motion(self) -> float:
        """The part of the step that the bodies take without any effect."""
        return self.bare.step_seconds / self.whole.step_seconds

    @property
    def shares_add_up_to(self) -> float:
        """Motion and effects together, over the measured step: 1 where effects do not share work."""
        return self.share_of_motion + sum(effect.share for effect in self.effects)

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        more = {"share_of_motion": self.share_of_motion, "shares_add_up_to": self.shares_add_up_to}
        return dataclasses.asdict(self) | more

    def summary(self) -> str:
        """The report in words and a table, the dearest effect first."""
        return "\n".join(
            [
                f"{self.bodies} bodies, {self.method}, {self.precision}: {1e6 * self.whole.step_seconds:.3g} CPU µs a "
                f"step, {self.whole.compile_seconds:.2g} CPU s to compile. Without each effect the step has less, and "
                f"the motion differs over {self.steps} steps of {self.dt:g} s by as much as:",
                table([*(_row(self.whole, effect) for effect in self.effects), *_other_rows(self)]),
            ]
        )


def cost(
    scene: Scene,
    state: State,
    *,
    dt: float = 1e-3,
    steps: int = 1000,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
    rounds: int = 31,
) -> CostReport:
    """What each effect of a scene adds to the program, to the time and to the answer; the dearest first.

    The scene is compiled and run whole, without any effect, and without each of them in turn. Times are CPU times of
    this process, medians of runs taken in turns. Two effects that share work (the compiler forms a common part once)
    each seem to cost less than both together: `shares_add_up_to` tells.

    Args:
        scene, state: as for `rb.step`.
        dt, steps: the run [s] in which the answers with and without an effect are compared.
        method: how to advance.
        rounds: readings of the clock for each program.

    Raises:
        WrongStructure: called while being traced.
    """
    method = method_of(method)
    check_fit(scene, state)
    check_representation(method, state)
    check_positive("cost: dt", dt)
    steps = check_count("cost: steps", steps, 1)
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, state))):
        raise WrongStructure("cost: cannot measure inside jit, grad or vmap; call it outside")
    scenes = [scene, without(scene, range(len(scene.effects)))]
    scenes += [without(scene, [i]) for i in range(len(scene.effects))]
    whole, bare, *rest = _sizes(scenes, state, method, dt, rounds)
    effects = [
        EffectCost(
            name, i, size, 1.0 - size.step_seconds / whole.step_seconds,
            difference(scene, without(scene, [i]), state, dt, steps, method),
        )
        for i, (name, size) in enumerate(zip(names(scene), rest, strict=True))
    ]  # fmt: skip
    effects.sort(key=lambda effect: -effect.share)
    return CostReport(
        type(method).__name__, scene.count, np.dtype(state.dtype).name, float(dt), steps, whole, bare, tuple(effects)
    )  # fmt: skip


def without(scene: Scene, dropped: Any) -> Scene:
    """The scene without the effects of these numbers."""
    return Scene(scene.bodies, tuple(e for i, e in enumerate(scene.effects) if i not in set(dropped)))


def names(scene: Scene) -> list[str]:
    """A name for each effect: its class, numbered where there are several of a kind."""
    kinds = [type(effect).__name__ for effect in scene.effects]
    return [
        kind if kinds.count(kind) == 1 else f"{kind} {kinds[: i + 1].count(kind)}"
        for i, kind in enumerate(kinds)
    ]


def _sizes(scenes: list[Scene], state: State, method: Method, dt: float, rounds: int) -> list[Size]:
    span = jnp.asarray(dt, state.dtype)
    runs, counts, abouts = [], [], []
    for scene in scenes:
        arguments = (*jax.device_put((scene, state)), method)
        program, seconds, memory = compiled(end_state, *arguments, span, jnp.asarray(1))
        jaxpr = jax.make_jaxpr(lambda s, y: method.step(s.prepared(y.dtype), y, span))(scene, state)
        abouts.append((count_equations(jaxpr.jaxpr), count_operations(program.as_text()), seconds, memory))
        run = functools.partial(_run, program, arguments, span)
        counts.append(_steps_for_a_sample(run))
        runs.append(functools.partial(run, counts[-1]))
    seconds = interleaved(runs, rounds)
    return [
        Size(about[0], about[1], about[2], about[3], t / count)
        for about, t, count in zip(abouts, seconds, counts, strict=True)
    ]


def _run(program: Any, arguments: Any, span: Any, count: int) -> State:
    return program(*arguments, span * count, jnp.asarray(count))


def _steps_for_a_sample(run: Any) -> int:
    count = 64
    while True:
        once = interleaved([functools.partial(run, count)], rounds=1, least=0.0)[0]
        if once > 0.25 * _SAMPLE or count > 2**22:
            return max(64, int(count * _SAMPLE / max(once, 1e-9)))
        count *= 4


def count_equations(jaxpr: Any) -> int:
    """Equations of a jaxpr, those of inner ones included."""
    total = 0
    for equation in jaxpr.eqns:
        inner = [
            getattr(value, "jaxpr", value)
            for parameter in equation.params.values()
            for value in (parameter if isinstance(parameter, (tuple, list)) else (parameter,))
            if hasattr(getattr(value, "jaxpr", value), "eqns")
        ]
        total += sum(count_equations(i) for i in inner) if inner else 1
    return total


def count_operations(text: str) -> int:
    """Operations of a compiled program, from its text; parameters and constants do not count."""
    lines = re.findall(r"^\s+(?:ROOT )?%?[\w.\-]+ = .*?[\]})] ([\w\-]+)\(", text, re.MULTILINE)
    return sum(kind not in ("parameter", "constant") for kind in lines)


def _row(whole: Size, effect: EffectCost) -> dict[str, Any]:
    gone = effect.difference
    return {
        "effect": effect.name,
        "share": f"{100 * effect.share:.1f} %",
        "a step [ns]": 1e9 * (whole.step_seconds - effect.size.step_seconds),
        "equations": whole.equations - effect.size.equations,
        "operations": whole.operations - effect.size.operations,
        "compile [CPU s]": whole.compile_seconds - effect.size.compile_seconds,
        "bytes": whole.bytes - effect.size.bytes,
        "attitude [rad]": "" if gone is None else f"{gone.attitude:.1e}",
        "position [m]": "" if gone is None else f"{gone.position:.1e}",
        "velocity [m/s]": "" if gone is None else f"{gone.velocity:.1e}",
    }


def _other_rows(report: CostReport) -> list[dict[str, Any]]:
    """What is not any one effect's: what several share (less than nothing where they get in each other's way)."""
    bare, shared = report.bare, 1.0 - report.shares_add_up_to
    blank = dict.fromkeys(_row(report.whole, report.effects[0]), "") if report.effects else {}
    return [
        blank
        | {
            "effect": "(shared by several)",
            "share": f"{100 * shared:.1f} %",
            "a step [ns]": 1e9 * shared * report.whole.step_seconds,
        },
        blank
        | {
            "effect": "(the motion itself)",
            "share": f"{100 * report.share_of_motion:.1f} %",
            "a step [ns]": 1e9 * bare.step_seconds,
            "equations": bare.equations,
            "operations": bare.operations,
            "compile [CPU s]": bare.compile_seconds,
            "bytes": bare.bytes,
        },
    ]
