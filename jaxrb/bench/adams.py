"""Heavy tops by stabilised Adams, beside heyoka's adaptive Taylor series, diffrax and RK4: error against CPU time.

1000 asymmetric tops, 20 s; the error is the largest attitude error [rad] over all of them, against Adams of order 12
at steps so fine that only round-off is left. heyoka (https://bluescarni.github.io/heyoka.py) is optional: its rows are
left out where it is not installed. Everything is measured twice: as XLA comes, and in a second process in which it may
compile a whole loop to one kernel, which halves the time of the Adams method.

    jaxrb bench --what adams
"""

import functools
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, replicate
from jaxrb.draws import drawn
from jaxrb.effects.custom import CustomForce
from jaxrb.effects.effect import Wrench
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.effects.gravity import UniformGravity
from jaxrb.math.vector import cross
from jaxrb.scene.adams import solve_smooth
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.scene.solve import solve

WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=10000000"
BODIES, SPAN, GRAVITY = 1000, 20.0, 9.81
MOMENTS, MGR = np.array([1.0, 1.5, 2.0]), np.array([0.3, 0.2, 1.0])
# Order and steps; the pilot's choice varies with the tolerance, a table wants fixed points.
ADAMS = ((6, 600), (8, 340), (8, 400), (10, 500), (10, 600), (11, 800), (12, 1000), (12, 1200))
ADAMS_WIDE = ((6, 900), (8, 900), (8, 1200), (10, 1200), (10, 1600), (11, 2000), (12, 2600), (12, 3200))


def _constant(body: Any, state: Any, moment: Any) -> Wrench:
    up = jnp.asarray([0.0, 0.0, 1.0], state.angular_velocity.dtype)
    return Wrench(torque=cross(state.orientation.unrotate(up), moment))


def _varying(body: Any, state: Any, moment: Any) -> Wrench:
    """Gravity whose direction turns about x, with a damper: a field of space and time."""
    angle = 0.7 * state.time
    up = jnp.stack([jnp.zeros_like(angle), jnp.sin(angle), jnp.cos(angle)])
    return Wrench(torque=cross(state.orientation.unrotate(up), moment) - 0.05 * state.angular_velocity)


def scenes() -> dict[str, Scene]:
    """The tops with their torque given directly, held at a point under gravity, and in the varying field."""
    r = MGR / GRAVITY
    about_center = np.diag(MOMENTS) - (r @ r * np.eye(3) - np.outer(r, r))
    principal, held = replicate(Body(1.0, MOMENTS), BODIES), replicate(Body(1.0, about_center), BODIES)
    moment = jnp.asarray(MGR)
    return {
        "top, torque given": Scene(principal, CustomForce(_constant, moment)),
        "top, held by FixedPoint": Scene(held, (UniformGravity((0, 0, -GRAVITY)), FixedPoint(-r))),
        "varying field": Scene(principal, CustomForce(_varying, moment)),
    }


def start(wide: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Attitudes (n, 4) and angular velocities (n, 3) [rad/s]: scattered about one top, or all over.

    All over, the fastest top sets the step of all, which a method that adapts to each group does not pay for.
    """
    random = drawn(0)
    if wide:
        q = random.normal(size=(BODIES, 4))
        return q / np.linalg.norm(q, axis=1, keepdims=True), random.normal(size=(BODIES, 3))
    q = np.tile(np.array([np.sqrt(7.0), 1.0, 0.0, 0.0]) / np.sqrt(8.0), (BODIES, 1))
    return q, np.array([0.3, -0.2, 2.0]) + 0.1 * random.normal(size=(BODIES, 3))


def timed(run: Callable[[], Any], repeats: int) -> tuple[Any, float, float]:
    """Result, median CPU seconds of a call, and those of the first call on top."""
    seconds = []
    for _ in range(repeats + 1):
        before = time.process_time()
        result = jax.block_until_ready(run())
        seconds.append(time.process_time() - before)
    median = float(np.median(seconds[1:]))
    return result, median, seconds[0] - median


def _error(found: np.ndarray, exact: np.ndarray) -> float:
    found = found / np.linalg.norm(found, axis=1, keepdims=True)
    distance = [np.linalg.norm(found - sign * exact, axis=1) for sign in (1, -1)]
    return float(2 * np.max(np.minimum(*distance)))


def heyoka_runs(varying: bool, wide: bool = False) -> dict[float, Callable[[], np.ndarray]]:
    """Tolerance to a run of all bodies in heyoka's batch mode (8 lanes), returning quaternions (n, 4)."""
    import heyoka as hy

    w, x, y, z, a, b, c = variables = hy.make_vars("w", "x", "y", "z", "a", "b", "c")
    angle = 0.7 * hy.time
    u2, u3 = (hy.sin(angle), hy.cos(angle)) if varying else (0.0, 1.0)
    g = [
        2 * (x * y + w * z) * u2 + 2 * (x * z - w * y) * u3,
        (w * w - x * x + y * y - z * z) * u2 + 2 * (y * z + w * x) * u3,
        2 * (y * z - w * x) * u2 + (w * w - x * x - y * y + z * z) * u3,
    ]
    if not varying:
        g = [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]
    torque = [g[(i + 1) % 3] * MGR[(i + 2) % 3] - g[(i + 2) % 3] * MGR[(i + 1) % 3] for i in range(3)]
    if varying:
        torque = [t - 0.05 * rate for t, rate in zip(torque, (a, b, c), strict=True)]
    i1, i2, i3 = (float(m) for m in MOMENTS)
    right = [
        0.5 * (-x * a - y * b - z * c), 0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c), 0.5 * (w * c + x * b - y * a),
        ((i2 - i3) * b * c + torque[0]) / i1, ((i3 - i1) * c * a + torque[1]) / i2,
        ((i1 - i2) * a * b + torque[2]) / i3,
    ]  # fmt: skip
    system, width = list(zip(variables, right, strict=True)), 8
    groups = np.concatenate(start(wide), axis=1).reshape(-1, width, 7).transpose(0, 2, 1)

    def run(integrator: Any) -> np.ndarray:
        ends = np.empty_like(groups)
        for i, group in enumerate(groups):
            integrator.set_time(0.0)
            integrator.state[:] = group
            integrator.propagate_until([SPAN] * width)
            ends[i] = integrator.state
        return ends.transpose(0, 2, 1).reshape(-1, 7)[:, :4]

    return {
        tol: functools.partial(run, hy.taylor_adaptive_batch(system, groups[0].copy(), tol=tol))
        for tol in (1e-5, 1e-7, 1e-9, 1e-12, 1e-15)
    }


def rows() -> Iterator[dict[str, Any]]:
    """The table, a row at a time: field, method, setting, error [rad], µs a body, CPU seconds of the first call."""
    with jax.enable_x64(True):
        for row in measured():
            yield row | {"xla": "as it comes"}
    code = "import jax, json; from jaxrb.bench.adams import measured; jax.config.update('jax_enable_x64', True)\n"
    code += "for row in measured(): print(json.dumps(row))"
    environment = os.environ | {"XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {WHOLE_LOOPS}".strip()}
    child = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    for line in child.stdout.splitlines():
        yield json.loads(line) | {"xla": "whole loops"}


def measured(repeats: int = 5, wide: bool = False) -> Iterator[dict[str, Any]]:
    """The rows of this process."""
    q, omega = start(wide)
    for field, scene in scenes().items():
        state = scene.state(orientation=q, angular_velocity=omega)
        exact = solve_smooth(
            scene, state, t1=SPAN, steps=6000, order=12
        ).final.orientation.as_quaternion_array()
        runs: dict[tuple[str, str], Callable[[], Any]] = {}
        for order, steps in ADAMS_WIDE if wide else ADAMS:
            run = functools.partial(
                solve_smooth, scene, state, t1=SPAN, steps=steps, order=order, on_error="flag"
            )
            runs["jaxrb Adams", f"order {order}, {steps} steps"] = run
        for tolerance in (1e-6, 1e-9):
            run = functools.partial(solve_smooth, scene, state, t1=SPAN, tolerance=tolerance)
            runs["jaxrb Adams with pilot", f"tolerance {tolerance:g}"] = run
        if field != "top, held by FixedPoint":
            try:
                found = heyoka_runs(field == "varying field", wide)
            except ImportError:
                found = {}
            runs |= {("heyoka, batch 8", f"tolerance {tol:g}"): run for tol, run in found.items()}
            for rtol in (1e-6, 1e-9):
                run = functools.partial(solve, scene, state, t1=SPAN, rtol=rtol, atol=rtol)
                runs["diffrax Dopri8", f"tolerance {rtol:g}"] = run
            run = functools.partial(rollout, scene, state, dt=SPAN / 2000, steps=2000, save_every=2000)
            runs["jaxrb RK4", "2000 steps"] = run
        for (method, setting), run in runs.items():
            result, median, first = timed(run, repeats)
            wxyz = (
                result
                if isinstance(result, np.ndarray)
                else np.asarray(result.final.orientation.as_quaternion_array())
            )
            error = _error(wxyz, np.asarray(exact))
            yield {
                "field": field,
                "method": method,
                "setting": setting,
                "error_rad": error if math.isfinite(error) else float("inf"),
                "us_a_body": 1e6 * median / BODIES,
                "first_call_cpu_s": first,
            }
