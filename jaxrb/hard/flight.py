"""Hard cases of free rotation: two independent computations, forward and gradient, against each other.

All bodies fly in one scene, so that one program serves all cases: 1e4 steps of the symmetric three-axis splitting, and
the closed form. The answer is the closed form in float64 of the numbers as the run's precision holds them; in float64
itself the comparison is of the two methods with each other.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.bench.peers import mujoco_run
from jaxrb.body.body import Body
from jaxrb.body.state import State
from jaxrb.hard.case import QUICK, Case, Measured, precision, rounded
from jaxrb.hard.contact_peers import Flight
from jaxrb.integrators.three_axis_splitting import ThreeAxisSplitting4
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.scene.flight import free_flight
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

DT, STEPS = 5e-4, 10_000
LONG_DT, LONG_STEPS, VERY_LONG_STEPS = 0.02, 100_000, 10_000_000
SAVES = 100

# Name: what is hard, principal moments [kg m²], spin [rad/s].
BODIES: dict[str, tuple[str, tuple[float, ...], tuple[float, ...]]] = {
    "beside the unstable axis": ("small errors grow e-fold in a radian", (1, 2, 3), (1e-3, 1, 1e-3)),
    "on the separatrix": ("the period is infinite, elliptic functions end", (2, 5, 6), (0.75, 0.5, 0.75)),
    "beside the separatrix": ("the modulus is 1 to round-off", (2, 5, 6), (0.75, 0.5, 0.75 + 1e-9)),
    "needle of inertia 1e-6": ("moments of ratio 1e6", (1e-6, 1, 1 + 5e-7), (10, 1, 0.5)),
    "disc of thickness 1e-6": ("the triangle of moments is flat", (1, 1 + 1e-6, 2), (0.5, 0.2, 1)),
    "sphere but for 1e-12": ("differences of moments cancel", (1, 1, 1 + 1e-12), (0.3, 0.9, 0.2)),
    "two equal moments": ("the axes are not determined", (1, 1, 2), (0.3, -0.2, 1)),
    "three equal moments": ("no axis is determined", (2, 2, 2), (0.3, 0.9, 0.2)),
    "no spin": ("the direction of the momentum is 0/0", (1, 2, 3), (0, 0, 0)),
    "a tiny spin": ("its square is no number of float32", (1, 2, 3), (1e-25, 3e-25, 2e-25)),
    "spin about the unstable axis": ("the separatrix is left for ever", (1, 2, 3), (0, 1, 0)),
    "spin about the longest axis": ("momentum along one axis, zero elsewhere", (1, 2, 3), (1, 0, 0)),
}
FAST = ("5000 rad in one flight", (1, 2, 3), (300, 900, 316))  # 1000 rad/s
_NAMES = (*BODIES, "1000 rad/s")
_ALL = (*BODIES.values(), FAST)


def _scene_and_state() -> tuple[Scene, State]:
    kind = precision()
    scene = Scene(tuple(Body(1.0, np.asarray(moments, kind)) for _, moments, _ in _ALL))
    return scene, scene.state(angular_velocity=np.asarray([spin for _, _, spin in _ALL], kind))


def _look(state: State) -> Scalar:
    """A number a body that depends on the whole attitude: a row of each Rᵀ seen along a fixed direction, (n,)."""
    dtype = state.dtype
    seen = state.orientation.rotate(
        jnp.broadcast_to(jnp.asarray([0.48, 0.6, 0.64], dtype), state.position.shape)
    )
    return seen @ jnp.asarray([0.36, -0.48, 0.8], dtype)


def _spun(state: State, omega: Vector) -> State:
    return State(state.position, state.orientation, state.velocity, omega, state.time)


# No torque couples the bodies: the gradient of the sum has each body's own in its row.
@jax.jit
@functools.partial(jax.value_and_grad, has_aux=True)
def _stepped(omega: Vector, scene: Scene, state: State) -> tuple[Scalar, State]:
    method = ThreeAxisSplitting4()
    start = _spun(state, omega)
    final = rollout(scene, start, dt=DT, steps=STEPS, save_every=STEPS, method=method, on_error="flag").final
    return jnp.sum(_look(final)), final


@functools.partial(jax.jit, compiler_options=QUICK)
@functools.partial(jax.value_and_grad, has_aux=True)
def _closed(omega: Vector, scene: Scene, state: State, t: Scalar) -> tuple[Scalar, State]:
    final = free_flight(scene, _spun(state, omega), t)
    return jnp.sum(_look(final)), final


def _host(answer: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Attitude wxyz (n, 4), spin (n, 3) and gradient (n, 3), on the host in float64."""
    (_, final), gradient = answer
    parts = (final.orientation.wxyz, final.angular_velocity, gradient)
    q, omega, gradient = (np.asarray(part, np.float64) for part in parts)
    return q, omega, gradient


@functools.cache
def flights(kind: str) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The flights by steps, by the closed form, and the answer; `kind` is the precision that is switched on."""
    scene, state = _scene_and_state()
    omega, t = state.angular_velocity, jnp.asarray(DT * STEPS, state.dtype)
    found = {
        "steps": _host(_stepped(omega, scene, state)),
        "closed form": _host(_closed(omega, scene, state, t)),
    }
    if kind == "float64":
        return found | {"answer": found["closed form"]}
    with jax.enable_x64(True):
        numbers = (omega, scene, state, t)
        exact = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64), numbers)
        answer = _host(_closed(exact[0], exact[1], exact[2], exact[3]))
    return found | {"answer": answer}


def _apart(q: np.ndarray, other: np.ndarray) -> float:
    """2 min |q ∓ q′| [rad]; NaN stays NaN."""
    return float(2 * np.minimum(np.linalg.norm(q - other), np.linalg.norm(q + other)))


def _against_answer(body: int, ways: tuple[str, ...]) -> tuple[float, float]:
    """The worst attitude error of `ways` [rad], and the worst error of the gradient relative to its length."""
    found = flights(precision())
    q, _, gradient = (part[body] for part in found["answer"])
    length = max(np.linalg.norm(gradient), 1e-30)
    attitude = [_apart(found[way][0][body], q) for way in ways]
    slope = [float(np.linalg.norm(found[way][2][body] - gradient) / length) for way in ways]
    return float(np.max(attitude)), float(np.max(slope))


def _tumble(body: int) -> Measured:
    found = flights(precision())
    error, slope = _against_answer(body, ("steps", "closed form"))
    both = [found[way][2][body] for way in ("steps", "closed form")]
    return Measured(error, both, slope)


def _separatrix() -> Measured:
    """ω_mid = W tanh, ω_outer ∝ sech of W t √((I₂−I₁)(I₃−I₂)/(I₁I₃)) (Landau and Lifshitz, "Mechanics", §37)."""
    body = _NAMES.index("on the separatrix")
    found = flights(precision())
    _, (i1, i2, i3), spin = BODIES["on the separatrix"]
    start = np.asarray(spin)
    momentum = np.linalg.norm(np.asarray((i1, i2, i3)) * start)
    w = momentum / i2
    phase = np.arctanh(start[1] / w)
    # The sign: I₂ ω₂′ = (I₃ − I₁) ω₃ ω₁ is positive here.
    later = phase + w * np.sqrt((i2 - i1) * (i3 - i2) / (i1 * i3)) * DT * STEPS
    fade = np.cosh(phase) / np.cosh(later)
    exact = np.asarray([start[0] * fade, w * np.tanh(later), start[2] * fade])
    tumble = _tumble(body)
    error = [float(np.abs(found[way][1][body] - exact).max()) for way in ("steps", "closed form")]
    return Measured(max(*error, tumble.figure), tumble.gradient, tumble.gradient_error)


def _fast() -> Measured:
    """The closed form alone: half a radian a step is too much for steps to be compared with."""
    body = _NAMES.index("1000 rad/s")
    found = flights(precision())
    error, slope = _against_answer(body, ("closed form",))
    if precision() == "float64":
        error, slope = _slower_for_longer(body), _slope_by_differences(body)
    stepped, _ = _against_answer(body, ("steps",))
    note = (
        f"in steps of half a radian ThreeAxisSplitting4 is off by {stepped:.1g} rad; its gradient is finite"
    )
    return Measured(error, [found[way][2][body] for way in ("steps", "closed form")], slope, note=note)


def _slower_for_longer(body: int) -> float:
    """The same flight at a thousandth of the spin for a thousand times as long must end the same."""
    scene, state = _scene_and_state()
    t = jnp.asarray(DT * STEPS * 1000, state.dtype)
    q, _, _ = _host(_closed(state.angular_velocity / 1000, scene, state, t))
    return _apart(q[body], flights(precision())["answer"][0][body])


def _slope_by_differences(body: int) -> float:
    """The gradient of the closed form against central differences, relative to its length."""
    scene, state = _scene_and_state()
    t, h = DT * STEPS, 1e-5
    slope = []
    for axis in range(3):
        ends = []
        for sign in (1, -1):
            omega = state.angular_velocity.at[body, axis].add(sign * h)
            (_, final), _ = _closed(omega, scene, state, t)
            ends.append(float(_look(final)[body]))
        slope.append((ends[0] - ends[1]) / (2 * h))
    gradient = flights(precision())["closed form"][2][body]
    return float(np.linalg.norm(gradient - slope) / np.linalg.norm(gradient))


def _kept(scene: Scene, state: State, dt: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest relative errors of energy and of the vector of momentum in the world, a body each."""
    path = rollout(scene, state, dt=dt, steps=steps, save_every=steps // SAVES, method=ThreeAxisSplitting4())
    moments = np.stack([rounded(moments) for _, moments, _ in _ALL])
    omega = np.asarray(path.states.angular_velocity, np.float64)
    matrix = np.asarray(path.states.orientation.as_matrix(), np.float64)
    momentum = np.einsum("knij,knj->kni", matrix, moments * omega)
    energy = (moments * omega**2).sum(-1)
    scale = np.linalg.norm(momentum[0], axis=-1)
    alive = scale > 1e-20
    off = np.linalg.norm(momentum - momentum[0], axis=-1).max(0)
    drift = np.abs(energy - energy[0]).max(0)
    return np.where(alive, drift / np.where(alive, energy[0], 1), 0), off / np.where(alive, scale, 1)


def long_flip(steps: int = LONG_STEPS) -> Measured:
    """The intermediate-axis flip over many steps."""
    scene, state = _scene_and_state()
    slow = _spun(state, state.angular_velocity.at[_NAMES.index("1000 rad/s")].multiply(1e-3))
    energy, momentum = _kept(scene, slow, LONG_DT, steps)
    body = _NAMES.index("beside the unstable axis")
    return Measured(
        float(max(energy[body], momentum[body])),
        note=f"{steps:.0e} steps of {LONG_DT} s, 50 a radian",
    )


def _half_turn_steps() -> Measured:
    """Every body at a spin of nearly π a step."""
    scene, state = _scene_and_state()
    omega = np.asarray(state.angular_velocity, np.float64)
    speed = np.linalg.norm(omega, axis=-1, keepdims=True)
    scaled = jnp.asarray(np.where(speed > 1e-20, omega / np.where(speed > 1e-20, speed, 1), 0), state.dtype)
    _, momentum = _kept(scene, _spun(state, scaled), 0.999 * np.pi, LONG_STEPS)
    return Measured(
        float(momentum.max()),
        note="the attitude means nothing at such steps, and a warning says so",
    )


def _mujoco(body: int) -> float:
    """The attitude error [rad] of MuJoCo's RK4 with the same steps, in float64 whatever the precision."""
    _, moments, spin = _ALL[body]
    moments, spin = rounded(moments), rounded(spin)
    run = mujoco_run(1.0, moments, (0, 0, 0), spin.tolist(), dt=DT, steps=STEPS, integrator="RK4", repeats=1)
    return _apart(run.orientation[-1], flights(precision())["answer"][0][body])


def _flight(body: int) -> Flight:
    """The same for other engines, with the numbers of float64."""
    _, moments, spin = _ALL[body]
    inertia = [[*map(float, moments), 0.0, 0.0, 0.0]]
    return Flight("free", [1.0], (1, 1, 1), [(0, 0, 0)], spins=[spin], inertia=inertia, dt=DT, steps=STEPS)


def _other(body: int, states: np.ndarray) -> float:
    """The attitude error [rad] of states (k, 1, 13) that another engine gave."""
    return _apart(states[-1, 0, 3:7], flights(precision())["answer"][0][body])


def _case(body: int, name: str, hard: str) -> Case:
    run, gradient = functools.partial(_tumble, body), {"float64": 1e-9, "float32": 2e-2}
    figure = {"float64": 1e-10, "float32": 2e-3}
    stable = f"attitude after {STEPS} steps and by the closed form [rad]; gradients by the spin agree"
    if name == "on the separatrix":
        run, stable = _separatrix, stable + "; the spin follows tanh and sech"
    if name == "1000 rad/s":
        run, gradient = _fast, {"float64": 1e-5, "float32": 2e-2}
        stable = "attitude by the closed form [rad], also flown slower for longer; gradient right"
    return Case(name, hard, stable, figure, run, gradient, peer=functools.partial(_mujoco, body),
        flight=_flight(body), of_peer=functools.partial(_other, body),
    )  # fmt: skip


def cases() -> tuple[Case, ...]:
    """The cases of this file."""
    single = tuple(_case(i, name, body[0]) for i, (name, body) in enumerate(zip(_NAMES, _ALL, strict=True)))
    return (
        *single,
        Case(
            "intermediate-axis flip, long",
            "1e5 steps of a motion that amplifies errors (--long: 1e7)",
            "relative error of energy and of the vector of angular momentum at any time; at most ε a step",
            {kind: LONG_STEPS * float(np.finfo(kind).eps) for kind in ("float64", "float32")},
            long_flip,
        ),
        Case(
            "half a turn a step",
            "ω·dt = 0.999 π: a step sees the motion hardly at all",
            "relative error of the vector of angular momentum in 1e5 steps; at most ε a step",
            {kind: LONG_STEPS * float(np.finfo(kind).eps) for kind in ("float64", "float32")},
            _half_turn_steps,
            warns="more than a quarter turn",
        ),
    )
