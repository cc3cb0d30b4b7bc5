"""Row E of the scoreboard: the rigid-body problem of the ODE literature, as a body that exists.

    y₁' = −2 y₂y₃,  y₂' = 1.25 y₁y₃,  y₃' = −0.5 y₁y₂ + 0.25 sin² t,   y(0) = (1, 0, 0.9),  t 0…10

(E. Hairer, S. P. Nørsett, G. Wanner, "Solving Ordinary Differential Equations I", 1993, II.0; SciMLBenchmarks, "Rigid
body".) The moments (0.5, 2, 3) that these factors suggest belong to no body: 0.5 + 2 < 3. But ω_i = s_i y_i of a body
with moments (2, 3, 4) obeys the same equations for the scales s below, exactly, so the engine runs it unchanged.
"""

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.reference import end_state
from jaxrb.accuracy.timing import compiled, cpu_of_first
from jaxrb.bench.timing import both_clocks
from jaxrb.body.body import Body
from jaxrb.body.state import State
from jaxrb.effects.custom import CustomForce
from jaxrb.effects.effect import Wrench
from jaxrb.integrators import METHODS
from jaxrb.scene.library import Example
from jaxrb.scene.scene import Scene
from jaxrb.scene.solve import solve

FACTORS = np.array([-2.0, 1.25, -0.5])
MOMENTS = np.array([2.0, 3.0, 4.0])
START, DURATION = (1.0, 0.0, 0.9), 10.0
_EULER = (np.roll(MOMENTS, -1) - np.roll(MOMENTS, -2)) / MOMENTS  # ω₁' = (I₂ − I₃)/I₁ ω₂ω₃ and so on round
_RATIO = FACTORS / _EULER  # must be s_j s_k / s_i, whence s_i = √(ratio_j ratio_k)
SCALES = np.sqrt(np.roll(_RATIO, -1) * np.roll(_RATIO, -2))


def _drive(body: Any, state: State, strength: Any) -> Wrench:
    """I₃ s₃ · 0.25 sin² t about the third axis [N m]."""
    push = strength * jnp.sin(state.time) ** 2
    return Wrench(torque=jnp.stack([jnp.zeros_like(push), jnp.zeros_like(push), push]))


def problem() -> Example:
    """The problem as a scene; y = ω / SCALES."""
    scene = Scene(Body(1.0, MOMENTS), CustomForce(_drive, np.float64(0.25 * MOMENTS[2] * SCALES[2])))
    start = {"angular_velocity": (SCALES * np.array(START)).tolist()}
    return Example("rigid_body_problem", "rigid-body problem of the ODE literature", scene, start, DURATION)


def right_hand_side(t: float, y: np.ndarray) -> np.ndarray:
    """The equations as the literature writes them."""
    return FACTORS * np.roll(y, -1) * np.roll(y, -2) + np.array([0.0, 0.0, 0.25 * np.sin(t) ** 2])


def exact_end() -> np.ndarray:
    """y(10) by SciPy's DOP853 on the bare equations, outside of the engine; good to about 1e-12."""
    from scipy.integrate import solve_ivp

    path = solve_ivp(right_hand_side, (0.0, DURATION), START, method="DOP853", rtol=3e-14, atol=1e-15)
    return path.y[:, -1]


def rigid_body_problem() -> Iterator[dict[str, Any]]:
    """Largest error of y(10). The engine also carries the attitude, which the other solvers here do not."""
    exact = exact_end()
    yield from _scipy(exact)
    example = problem()
    state = example.state()
    span = jnp.asarray(DURATION, state.dtype)
    for name, kind in METHODS.items():
        method = kind()
        program, first, _ = compiled(end_state, example.scene, state, method, span, jnp.asarray(1))
        for count in (100, 1000, 10_000):

            def run(count: int = count, program: Any = program, method: Any = method) -> State:
                return program(example.scene, state, method, span, jnp.asarray(count))

            cpu, wall = both_clocks(run)
            error = _error(run(), exact)
            who, setting = _name(f"jaxrb {name}", state), f"dt {DURATION / count:g}"
            yield _entry(who, setting, error, cpu, wall, first)
    yield from _diffrax(example, state, exact)


def _scipy(exact: np.ndarray) -> Iterator[dict[str, Any]]:
    from scipy.integrate import solve_ivp

    for solver in ("RK45", "DOP853", "LSODA"):
        for rtol in (1e-6, 1e-9):
            run = lambda s=solver, r=rtol: solve_ivp(  # noqa: E731
                right_hand_side, (0.0, DURATION), START, method=s, rtol=r, atol=1e-2 * r
            )
            cpu, wall = both_clocks(lambda run=run: run().y)
            error = float(np.abs(run().y[:, -1] - exact).max())
            yield _entry(f"SciPy {solver}, 3 equations", f"rtol {rtol:g}, here", error, cpu, wall, None)


def _diffrax(example: Example, state: State, exact: np.ndarray) -> Iterator[dict[str, Any]]:
    import diffrax

    tight = 1e-10 if np.dtype(state.dtype) == np.float64 else 1e-6
    for solver in (diffrax.Tsit5(), diffrax.Dopri8()):
        first = None
        for rtol in (1e-5, tight):

            def run(solver: Any = solver, rtol: float = rtol) -> State:
                return solve(
                    example.scene, state, t1=DURATION, solver=solver, rtol=rtol, atol=1e-2 * rtol
                ).final

            if first is None:
                first = cpu_of_first(run)
            cpu, wall = both_clocks(run)
            who = _name(f"jaxrb solve, diffrax {type(solver).__name__}", state)
            yield _entry(who, f"rtol {rtol:g}", _error(run(), exact), cpu, wall, first)


def _error(state: State, exact: np.ndarray) -> float:
    return float(np.abs(np.asarray(state.angular_velocity, float)[0] / SCALES - exact).max())


def _name(who: str, state: State) -> str:
    return who if np.dtype(state.dtype) == np.float64 else f"{who}, float32"


def _entry(
    who: str, setting: str, error: float, cpu: float, wall: float, first: float | None
) -> dict[str, Any]:
    costs = {"cpu_s": cpu, "wall_s": wall} | ({} if first is None else {"compile_cpu_s": first})
    return {"who": who, "setting": setting, "error_at_end": error, **costs}
