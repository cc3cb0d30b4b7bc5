"""Joints: how near to exact answers they keep, how closed they stay, and what a step costs.

The pendulum's angle is known by Jacobi's functions (SciPy's); the double pendulum's by Taylor series of 50 digits
(`double_pendulum.py`); the cart's speed by its closed form; Bricard's mechanism and the chain are judged by their
energy. Where a floor takes energy, the drift is the most that it rose between two saved states.
"""

import math
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.timing import cpu_of_first
from jaxrb.bench.double_pendulum import angles_at
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.joints import Hinge
from jaxrb.scene.example import Example
from jaxrb.scene.joint_library import CART_INCLINE, bricard, cart, chain, doll_on_floor, double_pendulum, rod
from jaxrb.scene.joints import joint_error
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.scene.solve import solve

GRAVITY = 9.81
_AMPLITUDE = 1.0  # [rad]


def rows() -> Iterator[dict[str, Any]]:
    """One row for each mechanism; float64 is wanted (JAX_ENABLE_X64=1)."""
    example, rate = pendulum()
    period = 4.0 * _quarter() / rate
    for periods in (10, 100):
        end = periods * period + 0.3
        steps = 4000 * periods + round(0.3 / period * 4000)
        yield _row(
            f"pendulum, {periods} periods, RK4", example, end / steps, steps, _pendulum_error(rate), 0.5
        )
    yield _solved(example, rate, 100 * period + 0.3)
    for seconds in (2.0, 5.0, 10.0):
        name = f"double pendulum from level, {seconds:g} s, RK4"
        yield _row(name, double_pendulum(), 2.5e-4, round(seconds / 2.5e-4), _tip_error, 2.0)
    yield _row("Bricard's mechanism, 10 s, RK4", bricard(), 1e-3, 10_000, None, 1.0, 1e-6)
    yield _row("chain of 50, 60 s, RK4", chain(), 2e-3, 30_000, None, 0.1)
    heavy = chain()
    bodies = jax.tree.map(
        lambda x: np.concatenate([np.asarray(x)[:-1], 1e4 * np.asarray(x)[-1:]]), heavy.scene.bodies
    )
    loaded = Example(
        "loaded", "chain of 50 that bears 1e4 links", Scene(bodies, heavy.scene.effects), heavy.start, 10.0
    )
    # Its tension makes a light link swing at 2000/s.
    yield _row("the same bearing 10 000 links, 2 s", loaded, 5e-4, 4_000, None, 0.1)
    yield _row("cart down an incline, 2 s", cart(), 2e-3, 1000, _cart_error, 0.1)
    yield _row("doll that falls on a floor, 4 s", doll_on_floor(), 2e-3, 2000, None, 0.4)


def pendulum() -> tuple[Example, float]:
    """A rod of 1 m on a hinge, let go at 1 rad; and the rate [1/s] of its small swings."""
    scene = Scene(
        rod(1.0, 1.0),
        (UniformGravity((0.0, 0.0, -GRAVITY)), Hinge((0.0, 1.0, 0.0), (0.0, 0.0, 0.5), bodies=(0, None))),
    )
    half = 0.5 * _AMPLITUDE
    start = {
        "position": [-0.5 * math.sin(_AMPLITUDE), 0.0, -0.5 * math.cos(_AMPLITUDE)],
        "orientation": [math.cos(half), 0.0, math.sin(half), 0.0],
    }
    return Example("pendulum", "rod on a hinge", scene, start, 10.0), math.sqrt(1.5 * GRAVITY)


def _quarter() -> float:
    from scipy.special import ellipk

    return float(ellipk(math.sin(0.5 * _AMPLITUDE) ** 2))


def _exact_angle(rate: float, time: float) -> float:
    from scipy.special import ellipj

    k = math.sin(0.5 * _AMPLITUDE)
    phase = math.fmod(rate * time, 4.0 * _quarter())  # SciPy loses digits at large arguments
    return 2.0 * math.asin(k * float(ellipj(_quarter() - phase, k * k)[0]))


def _pendulum_error(rate: float) -> Any:
    def error(example: Example, path: Path) -> float:
        found = float(example.scene.effects[1].coordinate(path.final))
        return abs(found - _exact_angle(rate, float(path.final.time)))

    return error


def _tip_error(example: Example, path: Path) -> float:
    """Distance [m] of the end of the second rod from where it should be."""
    level = [math.pi / 2, math.pi / 2]
    (a, b), *_ = angles_at([float(path.final.time)], level, GRAVITY)
    tip = np.array([math.sin(a) + math.sin(b), 0.0, -math.cos(a) - math.cos(b)])
    found = path.final.point_position(jnp.asarray([0.0, 0.0, 0.5], path.final.dtype))[1]
    return float(np.linalg.norm(np.asarray(found) - tip))


def _cart_error(example: Example, path: Path) -> float:
    """Error [m/s] of the speed g t sin α m/(m + 4 I/r²) of a cart that rolls from rest."""
    chassis, wheels = example.scene.bodies
    about_axle = float(np.asarray(wheels.inertia.as_matrix())[0, 2, 2])
    total = float(chassis.mass) + float(np.sum(wheels.mass))
    rolling = total + 4.0 * about_axle / float(wheels.shape.radius[0]) ** 2
    exact = GRAVITY * math.sin(math.radians(CART_INCLINE)) * total / rolling * float(path.final.time)
    return abs(float(np.linalg.norm(path.final.velocity[0])) - exact)


def _row(
    name: str, example: Example, dt: float, steps: int, error: Any, link: float, goal: float | None = None
) -> dict[str, Any]:
    state = example.state()

    def run() -> Path:
        return rollout(
            example.scene, state, dt=dt, steps=steps, save_every=max(1, steps // 100), on_error="flag"
        )

    first, seconds = cpu_of_first(run), cpu_of_first(run)
    path = run()
    return _figures(name, example.scene, path, link) | {
        "error": None if error is None else error(example, path),
        "energy goal [J]": goal,
        "a step [CPU µs]": 1e6 * seconds / steps,
        "to begin [CPU s]": first - seconds,
        "status": "ok" if bool(path.status.ok) else "failed",
        "poor": None if path.contact is None else int(path.contact.poor[-1]),
    }


def _solved(example: Example, rate: float, end: float) -> dict[str, Any]:
    path = solve(example.scene, example.state(), t1=end, rtol=1e-12, atol=1e-12)
    return _figures("pendulum, 100 periods, rb.solve", example.scene, path, 0.5) | {
        "error": _pendulum_error(rate)(example, path), "energy goal [J]": None, "a step [CPU µs]": None,
        "to begin [CPU s]": None, "status": "ok", "poor": None,
    }  # fmt: skip


def _drift(scene: Scene, energy: np.ndarray) -> float:
    """How far energy went; with contact, which may take it, how far it ever rose."""
    if any(isinstance(effect, RigidContact) for effect in scene.effects):
        return float(np.diff(energy).max())
    return float(np.abs(energy - energy[0]).max())


def _figures(name: str, scene: Scene, path: Path, link: float) -> dict[str, Any]:
    energy = np.asarray(path.diagnostics.energy, float)
    gap = jax.jit(jax.vmap(lambda state: joint_error(scene, state).gap.max()))(path.states)
    return {
        "mechanism": name,
        "joint gap / link": float(gap.max()) / link,
        "energy drift [J]": _drift(scene, energy),
    }
