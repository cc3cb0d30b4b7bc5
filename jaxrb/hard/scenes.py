"""Hard cases of whole scenes: stiffness, scale, distance from the origin, and inputs that no run can go on with."""

import functools
import operator
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.effects.central_gravity import MutualGravity
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.spring import SpringDamper
from jaxrb.effects.thruster import BodyThruster
from jaxrb.hard.case import QUICK, Case, Measured, precision, rounded, unannounced
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Scalar
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

SPRING_STEPS = 200
REST, STRETCH = 1.0, 0.125
FLIGHT_STEPS, FLIGHT_DT = 10_000, 1e-3
OFFSETS = (0.0, 1e4, 1e7)


def _spring_scene(masses: tuple[float, float], stiffness: float) -> tuple[Scene, State]:
    """Two bodies on a line, the spring between them stretched, at rest."""
    kind = precision()
    bodies = tuple(Body(np.asarray(mass, kind), 1.0) for mass in masses)
    scene = Scene(bodies, SpringDamper(np.asarray(stiffness, kind), rest_length=REST, body_b=1))
    return scene, scene.state(np.asarray([(0, 0, 0), (REST + STRETCH, 0, 0)], kind))


def _run(scene: Scene, state: State, dt: float) -> Path:
    return rollout(scene, state, dt=dt, steps=SPRING_STEPS, on_error="flag")


@functools.partial(jax.jit, compiler_options=QUICK)
@functools.partial(jax.value_and_grad, has_aux=True)
def _final_stretch(stiffness: Scalar, scene: Scene, state: State, dt: Scalar) -> tuple[Scalar, State]:
    (spring,) = scene.effects
    stiffer = SpringDamper(stiffness, rest_length=spring.rest_length, body_b=1)
    path = rollout(Scene(scene.bodies, stiffer), state, dt=dt, steps=SPRING_STEPS, on_error="flag")
    final = path.final
    return final.position[1, 0] - final.position[0, 0] - REST, final


def _exact_stretch(masses: tuple[float, float], stiffness: float, dt: float) -> tuple[float, float]:
    """What Runge–Kutta 4 gives in exact arithmetic: Re R(iωdt)ⁿ times the start, R the first five terms of the
    exponential series; and its derivative by the stiffness, with dω/dk = ω/2k."""
    z = 1j * np.sqrt(stiffness * sum(1 / m for m in masses)) * dt
    growth = 1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))
    slope = 1 + z * (1 + z / 2 * (1 + z / 3))
    n = SPRING_STEPS
    by_stiffness = n * growth ** (n - 1) * slope * z / (2 * stiffness)
    return float(STRETCH * (growth**n).real), float(STRETCH * by_stiffness.real)


def _spring(masses: tuple[float, float], stiffness: float, phase: float) -> Measured:
    """A spring with a step of `phase` radians of its oscillation."""
    scene, state = _spring_scene(masses, stiffness)
    rate = np.sqrt(stiffness * sum(1 / m for m in masses))
    dt = float(rounded(phase / rate))
    path = _run(scene, state, dt)
    numbers = (scene.effects[0].stiffness, scene, state, jnp.asarray(dt, state.dtype))
    (value, final), slope = _final_stretch(*numbers)
    exact, exact_slope = _exact_stretch(masses, float(rounded(stiffness)), dt)
    # Largest slope that the phase of the end could have given: the end may lie at a turning point.
    scale = max(abs(exact_slope), STRETCH / stiffness)
    momentum = np.abs(np.asarray(masses) @ np.asarray(final.velocity, float)).max() / (
        STRETCH * rate * min(masses)
    )
    error = abs(float(value) - exact) / STRETCH
    status = "ok" if bool(path.status.ok) else "flagged"
    return Measured(max(error, float(momentum)), slope, abs(float(slope) - exact_slope) / scale, status)


def _spring_beyond() -> Measured:
    scene, state = _spring_scene((1.0, 1.0), 1e6)
    return Measured(*_parts(_run(scene, state, 5.0 / np.sqrt(2e6))))


def _parts(path: Path) -> tuple[float, None, None, str]:
    """The arguments of `Measured` of a run that is to end with a status."""
    count, status = unannounced(path)
    return count, None, None, status


def _one_place() -> Measured:
    scene = Scene(replicate(Body(1.0, 1.0), 2), MutualGravity())
    path = rollout(scene, scene.state(), dt=1e-3, steps=3, on_error="flag")
    return Measured(*_parts(path))


def _overflow(of: str) -> Measured:
    size = {"float64": 1e300, "float32": 1e38}[precision()]
    body = Body(0.01, (1.0, 2.0, 3.0))
    torque = None
    effects: tuple = ()
    if of == "torque":
        torque = np.asarray((size, size, size), precision())
    else:
        effects = (BodyThruster(force=(0.0, 0.0, size)),)
    scene = Scene(body, effects)
    # A long step: the square of the speed overflows in the first, or the position in one of the next.
    path = rollout(scene, scene.state(), dt=1e7, steps=3, torque=torque, on_error="flag")
    return Measured(*_parts(path))


def _zero_quaternion() -> Measured:
    scene = Scene(Body(1.0, 1.0))
    scene.state(orientation=(0.0, 0.0, 0.0, 0.0))
    return Measured(np.nan)  # not reached: the state is refused


def _zero_quaternion_by_hand() -> Measured:
    scene = Scene(Body(1.0, (1.0, 2.0, 3.0)))
    good = scene.state(angular_velocity=(0.1, 0.2, 0.3))
    nothing = Quaternion(jnp.zeros_like(good.orientation.as_quaternion_array()))
    bad = State(good.position, nothing, good.velocity, good.angular_velocity, good.time)
    path = rollout(scene, bad, dt=1e-3, steps=3, on_error="flag")
    return Measured(*_parts(path))


def _poisoned_world() -> Measured:
    """Four worlds of two bodies on a spring; then the same with NaN in the position of world 2."""
    scene, state = _spring_scene((1.0, 3.0), 100.0)
    worlds = jax.tree.map(lambda leaf: jnp.stack([leaf] * 4), state)
    spins = jnp.arange(24.0).reshape(4, 2, 3).astype(state.dtype)
    worlds = State(worlds.position, worlds.orientation, worlds.velocity, spins, worlds.time)
    poisoned = State(
        worlds.position.at[2, 0, 1].set(jnp.nan),
        worlds.orientation,
        worlds.velocity,
        worlds.angular_velocity,
        worlds.time,
    )
    run = jax.jit(jax.vmap(lambda s: rollout(scene, s, dt=1e-2, steps=20, on_error="flag")))
    clean, dirty = run(worlds), run(poisoned)
    others = np.asarray([0, 1, 3])
    changed = sum(
        int((np.asarray(a)[others] != np.asarray(b)[others]).sum())
        for a, b in zip(jax.tree.leaves(clean.states), jax.tree.leaves(dirty.states), strict=True)
    )
    announced = np.asarray(dirty.status.reason != 0).any(axis=1).tolist() == [False, False, True, False]
    return Measured(float(changed), status="flagged" if announced else "ok")


def _thrown(method: RungeKutta4) -> tuple[Callable, Scene, State]:
    """One throw from each offset, and a run of it that gives where it ends and the derivative by the velocity."""
    scene = Scene(replicate(Body(1.0, (1.0, 2.0, 3.0)), len(OFFSETS)), UniformGravity())
    start = [(offset, 0.0, 0.0) for offset in OFFSETS]
    state = scene.state(start, velocity=(1.0, 2.0, 50.0), angular_velocity=(0.1, 1.0, 0.2))

    def end(velocity: jax.Array) -> tuple[Scalar, State]:
        thrown = State(state.position, state.orientation, velocity, state.angular_velocity, state.time)
        path = rollout(
            scene,
            thrown,
            dt=FLIGHT_DT,
            steps=FLIGHT_STEPS,
            save_every=FLIGHT_STEPS,
            method=method,
            on_error="flag",
        )
        return jnp.sum(path.final.position[:, 0]), path.final

    return jax.jit(jax.value_and_grad(end, has_aux=True)), scene, state


@functools.cache
def _throws(kind: str, compensated: bool) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the way along x [m] from each offset, and derivatives by the velocity along x [s]."""
    run, _, state = _thrown(RungeKutta4(compensated=compensated))
    (_, final), slope = run(state.velocity)
    way = np.asarray(final.position[:, 0], np.float64) - np.asarray(state.position[:, 0], np.float64)
    return np.abs(way - FLIGHT_DT * FLIGHT_STEPS), np.asarray(slope[:, 0], np.float64)


def _far(offset: float) -> Measured:
    """The error of the way in units of the last place of the offset, with compensated sums."""
    at = OFFSETS.index(offset)
    kind = precision()
    place = float(np.spacing(np.asarray(offset, kind)))
    error, slope = (part[at] for part in _throws(kind, True))
    plain = _throws(kind, False)[0][at]
    seconds = FLIGHT_DT * FLIGHT_STEPS
    return Measured(
        float(error) / place,
        slope,
        abs(float(slope) - seconds) / seconds,
        note=f"a place is {place:.1e} m: of a way of {seconds:g} m in {FLIGHT_STEPS} steps plain sums lose "
        f"{plain:.1e} m, compensated ones {error:.1e} m",
    )


_NONE = {"float64": 0.0, "float32": 0.0}
_ANNOUNCED = "states that are not finite, or no rotations, without a status that says so"


def _stiff_cases() -> tuple[Case, ...]:
    stable = "error of the stretch against exact arithmetic, and of the momentum, relative to the amplitude"
    figure = {"float64": 1e-12, "float32": 3e-4}
    slope = {"float64": 1e-10, "float32": 1e-2}
    return (
        Case(
            "spring near the limit of stability",
            "ω·dt = 2.8: undamped swings are stable up to 2.83, and the warning starts at 2.78",
            stable,
            figure,
            functools.partial(_spring, (1.0, 1.0), 1e6, 2.8),
            slope,
            warns="beyond the stability of RungeKutta4",
        ),
        Case(
            "mass ratio 1e6 on a spring",
            "a step of 0.05 rad of the light body's swing",
            stable,
            figure,
            functools.partial(_spring, (1.0, 1e6), 1e4, 0.05),
            slope,
        ),
        Case(
            "spring beyond the limit of stability",
            "ω·dt = 5: the swing grows at every step",
            _ANNOUNCED,
            _NONE,
            _spring_beyond,
            ends="flagged",
            warns="beyond the stability of RungeKutta4",
        ),
    )


def _ended_cases() -> tuple[Case, ...]:
    announced = functools.partial(Case, stable=_ANNOUNCED, limit=_NONE, ends="flagged")
    return (
        announced(
            "two bodies in one place",
            "mutual gravity is infinite",
            run=_one_place,
            warns="beyond the stability",
        ),
        announced(
            "torque of 1e300 N m", "ω² overflows (float32: 1e38)", run=functools.partial(_overflow, "torque")
        ),
        announced(
            "force of 1e300 N", "the way overflows (float32: 1e38)", run=functools.partial(_overflow, "force")
        ),
        announced("quaternion zero by hand", "a run would normalise 0/0", run=_zero_quaternion_by_hand),
        Case(
            "quaternion of length zero",
            "it is no rotation",
            "refused when the state is made",
            _NONE,
            _zero_quaternion,
            ends="InvalidInput",
        ),
        Case(
            "NaN in one world of four",
            "worlds share every vector instruction",
            "numbers of the other worlds that differ in any bit; the status names the world",
            _NONE,
            _poisoned_world,
            ends="flagged",
        ),
    )


def cases() -> tuple[Case, ...]:
    """The cases of this file."""
    far = tuple(
        Case(
            f"{offset:.0e} m from the origin".replace("e+0", "e"),
            f"a step moves {FLIGHT_DT:g} m beside numbers of {offset:g} m",
            "error of the way in units of the last place of the offset, in 1e4 steps with compensated sums",
            {"float64": 2.0, "float32": 2.0},
            functools.partial(_far, offset),
            {"float64": 1e-10, "float32": 1e-3},
        )
        for offset in OFFSETS[1:]
    )
    return functools.reduce(operator.add, (_stiff_cases(), _ended_cases(), far))
