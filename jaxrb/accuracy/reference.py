"""The right answer of a run, and how far to trust it: two independent ways that must agree."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body import diagnostics
from jaxrb.body.state import State, finite_per_body
from jaxrb.effects.gravity import UniformGravity
from jaxrb.errors import RunFailed
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Scalar
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.flight import free_flight
from jaxrb.scene.scene import Scene, energy
from jaxrb.scene.solve import solve

FINEST = (
    2**19
)  # steps of the Runge–Kutta check: beyond, round-off of the sum outweighs what a finer step gains
AGREED = 1e-14


@dataclasses.dataclass(frozen=True)
class Errors:
    """How two end states differ: attitude [rad] and position [m] of the worst body, and total energy (relative)."""

    attitude: float
    position: float
    energy: float


@dataclasses.dataclass(frozen=True)
class Reference:
    """An end state in float64 and quaternions. `uncertainty` is how far two independent computations of it differ."""

    state: State
    how: str
    checked_by: str
    uncertainty: Errors

    def as_dict(self) -> dict[str, Any]:
        """Everything but the state, as plain data."""
        return {
            "how": self.how,
            "checked_by": self.checked_by,
            "uncertainty_attitude_rad": self.uncertainty.attitude,
            "uncertainty_position_m": self.uncertainty.position,
            "uncertainty_energy": self.uncertainty.energy,
        }


@jax.jit
def end_state(scene: Scene, state: State, method: Method, duration: Scalar, count: Any) -> State:
    """The state after `count` steps over `duration` [s]. The count is a number of the run: one program serves all."""
    dynamics = scene.prepared(state.dtype)
    dt = duration / count
    start = (state, method.first_carry(dynamics, state))
    return jax.lax.fori_loop(0, count, lambda _, c: method.carried_step(dynamics, c[0], c[1], dt), start)[0]


def reference(scene: Scene, state: State, duration: float) -> Reference:
    """The state `duration` [s] after `state`, in float64 whatever the precision of the run.

    The closed form where nothing but uniform gravity acts; else diffrax's Dopri8 at rtol 1e-13. Either is checked by
    Runge–Kutta 4 with Richardson's extrapolation, refined until the two agree no better; the least disagreement is
    the uncertainty. It bounds what a run can be blamed for: a smaller error than that is not measured.

    Raises:
        RunFailed: the two do not agree at all, or the motion leaves the finite numbers.
    """
    scene = with_own_arrays(scene)
    with jax.enable_x64(True):
        start = in_float64(state)
        answer = closed_form(scene, start, duration)
        how = "closed form"
        if answer is None:
            how = "Dopri8 (diffrax), rtol 1e-13"
            end = float(start.time) + duration
            answer = solve(scene, start, t1=end, rtol=1e-13, atol=1e-15, max_steps=10**6).final
        steps, difference = _checked(scene, start, duration, answer)
        if not difference.attitude < 0.1:
            raise RunFailed(
                f"reference: {how} and Runge–Kutta 4 at {2 * steps} steps differ by {difference.attitude:.2g} rad "
                f"after {duration:g} s: the motion is too long, too fast or chaotic to know; shorten the duration"
            )
        return Reference(
            answer, how, f"RungeKutta4 extrapolated from {steps} and {2 * steps} steps", difference
        )


def closed_form(scene: Scene, state: State, duration: float | Scalar) -> State | None:
    """The exact end state of bodies on which nothing but uniform gravity acts; None for other scenes."""
    if not all(isinstance(effect, UniformGravity) for effect in scene.effects):
        return None
    end = free_flight(Scene(scene.bodies), state, duration)
    fall = scene.prepared(state.dtype).acceleration(state).linear
    if fall is None:
        return end
    position = end.position + 0.5 * fall * duration**2
    return State(position, end.orientation, end.velocity + fall * duration, end.angular_velocity, end.time)


def _checked(scene: Scene, start: State, duration: float, answer: State) -> tuple[int, Errors]:
    """The least disagreement with extrapolated Runge–Kutta runs of ever more steps, and its coarser count."""

    def run(count: int) -> State:
        return end_state(scene, start, RungeKutta4(), jnp.asarray(duration), jnp.asarray(count))

    count = 2048
    coarse, best, at = run(count), Errors(np.inf, np.inf, np.inf), 2048
    while 2 * count <= FINEST:
        fine = run(2 * count)
        found = errors(scene, extrapolated(coarse, fine), answer)
        if found.attitude + found.position < best.attitude + best.position:
            best, at = found, count
        elif best.attitude < 1e-6:
            break
        if best.attitude + best.position < AGREED:
            break
        coarse, count = fine, 2 * count
    return at, best


@jax.jit
def extrapolated(coarse: State, fine: State) -> State:
    """Richardson's extrapolation of two runs of a method of order 4, one with twice the steps of the other."""
    mixed = jax.tree.map(lambda c, f: f + (f - c) / 15.0, coarse, fine)
    return State(
        mixed.position, mixed.orientation.normalise(), mixed.velocity, mixed.angular_velocity, fine.time
    )


def errors(scene: Scene, state: State, exact: State) -> Errors:
    """How an end state of any representation and precision differs from the right one; computed in float64.

    All are infinite where the state is not finite or its orientation is no rotation any more: an angle computed from
    NaN, or from the zero quaternion that a run beyond stability ends in, would look like no error at all.
    """
    scene = with_own_arrays(scene)
    with jax.enable_x64(True):
        return Errors(*(float(x) for x in _errors(scene, in_float64(state), in_float64(exact))))


@jax.jit
def _errors(scene: Scene, state: State, exact: State) -> tuple[Scalar, ...]:
    attitude = jnp.max(exact.orientation.angle_to(state.orientation))
    position = jnp.max(jnp.linalg.norm(state.position - exact.position, axis=-1))
    right = energy(scene, exact)
    moving = jnp.sum(diagnostics.kinetic_energy(scene.prepared(exact.dtype).bodies, exact))
    # Potential energy has an arbitrary zero: where the total vanishes, the kinetic part gives the scale.
    scale = jnp.maximum(jnp.abs(right), moving)
    relative = jnp.abs(energy(scene, state) - right) / jnp.where(scale > 0, scale, 1.0)
    length = jnp.linalg.norm(state.orientation.as_quaternion_array(), axis=-1)
    sound = jnp.all(finite_per_body(state) & (jnp.abs(length - 1.0) < 1e-6))
    return tuple(jnp.where(sound, error, jnp.inf) for error in (attitude, position, relative))


def with_own_arrays(scene: Scene) -> Scene:
    """The same scene in host arrays that no program has seen, for a run in another precision.

    JAX 0.10 keeps, by the array itself, what it made of a host array that a program held as a constant: a scene that
    was built into a program in float32, as `stepper` under `jit` does, could not be run in float64 after it.
    """
    return jax.tree.map(lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, scene)


def in_float64(state: State) -> State:
    """The same state in float64 and unit quaternions; call it where 64-bit numbers are enabled."""
    double = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, np.float64)), state)
    return _in_quaternions(double)


@jax.jit
def _in_quaternions(state: State) -> State:
    turned = Quaternion.from_rotation(state.orientation.normalise())
    return State(state.position, turned, state.velocity, state.angular_velocity, state.time)
