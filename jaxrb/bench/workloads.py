"""Speed of free bodies: cost per step, start-up, gradient. Figures for this machine, in one run."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.integrators.midpoint import ImplicitMidpoint
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.integrators.three_axis_splitting import ThreeAxisSplitting4
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

BODIES, STEPS = 1000, 2000
_FULL = np.array([[1.0, 0.1, 0.05], [0.1, 2.0, 0.1], [0.05, 0.1, 2.5]])


def cpu_median(run: Callable[[], Any], repeats: int = 7) -> tuple[float, float]:
    """Median CPU seconds of a call, and those of the first call on top of it (trace and compile)."""

    def timed() -> float:
        start = time.process_time()
        jax.block_until_ready(run())
        return time.process_time() - start

    first = timed()
    median = float(np.median([timed() for _ in range(repeats)]))
    return median, max(first - median, 0.0)


def free_bodies(inertia: Any, rotation: type[Rotation], renormalise: bool, dtype: Any) -> tuple[float, float]:
    """RK4 of 1000 bodies in one scene: ns a body-step, and compile seconds."""
    random = drawn(0)
    scene = Scene(replicate(Body(1.0, inertia), BODIES))
    state = scene.state(
        *(random.normal(size=(BODIES, 3)).astype(dtype) if k != 1 else None for k in range(4)),
        rotation=rotation,
    )
    method = RungeKutta4(renormalise=renormalise)
    run = lambda: rollout(scene, state, dt=1e-3, steps=STEPS, save_every=STEPS, method=method).final  # noqa: E731
    seconds, first = cpu_median(run)
    return 1e9 * seconds / (BODIES * STEPS), first


def worlds(dtype: Any) -> tuple[float, float]:
    """RK4 of 1000 worlds of one body under the user's own `jax.vmap`: ns a body-step, and compile seconds."""
    random = drawn(0)
    scene = Scene(Body(1.0, (1.0, 2.0, 2.5)))

    def start(omega: Any) -> State:
        at_rest = jnp.zeros((1, 3), dtype)
        return State(at_rest, Quaternion(jnp.eye(1, 4, dtype=dtype)), at_rest, omega, jnp.zeros((), dtype))

    states = jax.vmap(start)(random.normal(size=(BODIES, 1, 3)).astype(dtype))
    run = jax.jit(jax.vmap(lambda s: rollout(scene, s, dt=1e-3, steps=STEPS, save_every=STEPS).final))
    seconds, first = cpu_median(lambda: run(states))
    return 1e9 * seconds / (BODIES * STEPS), first


def gradient(
    method: Any = RungeKutta4(),  # noqa: B008 - an immutable value
    adjoint: str = "checkpoint",
    bodies: int = 64,
    steps: int = 10_000,
) -> dict[str, float]:
    """Reverse mode through 1e4 steps with respect to all masses and inertias: time against forward, and memory."""
    random = drawn(0)
    scene = Scene(replicate(Body(1.0, (1.0, 2.0, 2.5)), bodies))
    state = scene.state(angular_velocity=random.normal(size=(bodies, 3)))

    def loss(scene: Scene) -> Any:
        path = rollout(scene, state, dt=1e-3, steps=steps, save_every=steps, method=method, adjoint=adjoint)
        final = path.final
        return jnp.sum(final.orientation.as_quaternion_array())

    forward, backward = jax.jit(loss), jax.jit(jax.grad(loss))
    forward_seconds, _ = cpu_median(lambda: forward(scene), 3)
    backward_seconds, first = cpu_median(lambda: backward(scene), 3)
    memory = backward.lower(scene).compile().memory_analysis()
    return {
        "forward_seconds": forward_seconds,
        "gradient_over_forward": backward_seconds / forward_seconds,
        "gradient_compile_seconds": first,
        "gradient_memory_mb": getattr(memory, "temp_size_in_bytes", float("nan")) / 1e6,
    }


_ADJOINTS = (
    (RungeKutta4(), "checkpoint"),
    (ThreeAxisSplitting4(), "checkpoint"),
    (ThreeAxisSplitting4(), "reversible"),
    (ImplicitMidpoint(), "reversible"),
)

_START = """
import time
import jax
before = time.process_time()
import jaxrb as rb
imported = time.process_time()
scene = rb.Scene(rb.Body(1.0, (1.0, 2.0, 2.5)))
rb.rollout(scene, scene.state(angular_velocity=(0, 5, 0.1)), dt=1e-3, steps=1000).final.position.block_until_ready()
print(imported - before, time.process_time())
"""


def start_up(repeats: int = 5) -> dict[str, float]:
    """CPU seconds of `import jaxrb` beyond `import jax`, and from Python's start to the end of a first rollout."""
    lines = [
        subprocess.run(
            [sys.executable, "-c", _START], check=True, capture_output=True, text=True
        ).stdout.split()
        for _ in range(repeats)
    ]
    imports, totals = np.array(lines, float).T
    return {"import_seconds": float(np.median(imports)), "first_rollout_seconds": float(np.median(totals))}


def rows() -> Iterator[dict[str, Any]]:
    """The benchmark, a row at a time: what, figure, unit, goal."""
    yield row("import jaxrb beyond import jax", (start := start_up())["import_seconds"], "CPU s", 0.3)
    yield row("Python start to end of first rollout", start["first_rollout_seconds"], "CPU s", 2.5)
    principal = (1.0, 2.0, 2.5)
    for dtype in (np.float64, np.float32):
        kind = np.dtype(dtype).name
        cases: list[tuple[str, Any, type[Rotation], bool, float]] = [
            ("quaternion", principal, Quaternion, True, 25.0),
            ("quaternion, not renormalised", principal, Quaternion, False, 25.0),
            ("quaternion, full inertia", _FULL, Quaternion, True, 40.0),
            ("matrix", principal, RotationMatrix, True, 50.0),
            ("matrix, not renormalised", principal, RotationMatrix, False, 50.0),
        ]
        for name, inertia, rotation, renormalise, goal in cases:
            cost, first = free_bodies(inertia, rotation, renormalise, dtype)
            yield row(f"RK4, 1000 bodies, {kind}, {name}", cost, "ns/body-step", goal, first)
        cost, first = worlds(dtype)
        yield row(f"RK4, 1000 worlds of one body, {kind}, quaternion", cost, "ns/body-step", 25.0, first)
    for method, adjoint in _ADJOINTS:
        found, name = gradient(method, adjoint), f"{type(method).__name__}, {adjoint}"
        yield row(
            f"reverse pass through 1e4 steps, 64 bodies, {name}", found["gradient_over_forward"], "× forward", 12.0,
            found["gradient_compile_seconds"],
        )  # fmt: skip
        yield row("its memory", found["gradient_memory_mb"], "MB", None)


def row(
    what: str, figure: float, unit: str, goal: float | str | None, compile_seconds: float | None = None
) -> dict:
    return {
        "what": what,
        "figure": figure,
        "unit": unit,
        "goal": "" if goal is None else goal,
        "compile_cpu_s": "" if compile_seconds is None else compile_seconds,
    }


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    import os
    import platform

    device = jax.devices()[0]
    return {
        "device": f"{device.platform} {device.device_kind}",
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "system": f"{platform.system()} {platform.machine()}",
    }
