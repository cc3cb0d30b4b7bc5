"""Many steps of a scene in one program."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State
from jaxrb.body.unturned import shown
from jaxrb.compilation import jit
from jaxrb.integrators.method import Method, contact_report
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.kept import KEEP_FOUND
from jaxrb.scene import watch
from jaxrb.scene.certificate import certificate_of
from jaxrb.scene.path import Path
from jaxrb.scene.reversible import reversible_steps
from jaxrb.scene.scene import Scene, check_fit, refuse_contact
from jaxrb.scene.settings import (
    DEFAULT_MAX_BYTES,
    ON_ERROR,
    applied_torque,
    check_adjoint,
    check_choice,
    check_count,
    check_jointed,
    check_positive,
    check_representation,
    check_saved_bytes,
    check_steps,
    check_tolerance,
    warn_of_coarse_steps,
)
from jaxrb.scene.status import Status, sound, status_after, with_contact

# Of each step a reverse pass keeps what it began with and what was searched for, and forms the rest again: a program
# that keeps all stores and reads hundreds of small arrays a step, and takes longer to compile and to run. (Against
# keeping all of rows of steps, the gradient of a box on a floor, 1000 steps: to compile 8.1 s to 5.6, time over that of
# the run 9.8 to 5.6; of sixteen boxes 41 s to 31, 4.2 to 3.1; of a double pendulum 41 s to 24, 30 to 10; of 1000 free
# bodies 0.9 s to 0.8, 5.3 to 4.4. Memory a half to a tenth. Sixteen boxes once more, faces and corners found again in
# the reverse pass or kept: 25 s or 21.)
# Runs of more steps times bodies are cut into blocks, and what their steps begin with is formed again as well.
_IN_ONE = 16384
_ROW = 64  # steps between saved states up to which these are the blocks


def rollout(
    scene: Scene,
    state: State,
    *,
    dt: Scalar | float,
    steps: int,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
    torque: Any = None,
    save_every: int = 1,
    adjoint: str = "checkpoint",
    certify: bool = False,
    tolerance: float | None = None,
    on_error: str = "raise",
    max_bytes: int = DEFAULT_MAX_BYTES,
) -> Path:
    """`steps` steps of `dt` [s] in one program; keeps the initial and every `save_every`-th state.

    The public `rb.rollout` (`accuracy/rollout.py`) is this and the choice of a step; all arguments are told there.
    """
    method = method_of(method)
    check_fit(scene, state)
    check_representation(method, state)
    check_positive("dt", dt)
    check_choice("on_error", on_error, ON_ERROR)
    steps, save_every = check_count("steps", steps, 0), check_count("save_every", save_every, 1)
    check_saved_bytes(state, steps // save_every + 1, max_bytes)
    check_steps("rollout", steps)
    torque = applied_torque(torque, state, steps)
    check_adjoint(adjoint, method, torque)
    if adjoint == "reversible":
        refuse_contact(
            scene, "adjoint='reversible'", "use adjoint='checkpoint': no impact can be run backwards"
        )
        check_jointed(scene, "adjoint='reversible'", "use adjoint='checkpoint': projections cannot be undone")
    warn_of_coarse_steps(scene, state, dt, method)
    times, states, final, status, contact = _run(
        scene,
        state,
        torque,
        jnp.asarray(dt, state.dtype),
        method,
        steps=steps,
        save_every=save_every,
        adjoint=adjoint,
    )
    certificate = None
    if certify or tolerance is not None:
        if tolerance is not None:
            check_tolerance("tolerance", tolerance)
        certificate = certificate_of(
            scene, states, torque, jnp.asarray(dt, state.dtype), method, steps, save_every, tolerance
        )
    path = Path(times, states, final, status, scene, certificate, contact)
    if on_error == "raise":
        path.raise_if_bad()
    return path


def _run_steps(
    scene: Scene,
    state: State,
    torque: Vector | None,
    dt: Scalar,
    method: Method,
    *,
    steps: int,
    save_every: int,
    adjoint: str,
) -> tuple[Scalar, State, State, Status, Any]:
    dynamics = scene.prepared(state.dtype)
    start = state.time
    varying = torque is not None and torque.ndim == 3

    def one(carry: tuple, given: Vector | None) -> tuple[tuple, None]:
        state, memory, finite_steps, done = carry
        given = given if varying else torque
        new, memory = method.carried_step(dynamics, timed(state, done), memory, dt, given)
        return (at(start, new), memory, watch.counted(finite_steps, state, new), done + 1), None

    one = jax.checkpoint(one, prevent_cse=False, policy=KEEP_FOUND)

    def timed(state: State, done: Array) -> State:
        # The time is counted, not added up: 1e6 additions in float32 would lose the third digit. It is formed where it
        # is asked for, not carried: a step that does not look at it then has no loop over worlds for it.
        return at(start + done.astype(dt.dtype) * dt, state)

    def at(time: Scalar, state: State) -> State:
        return State(state.position, state.orientation, state.velocity, state.angular_velocity, time)

    def advance(carry: tuple, given: Vector | None, count: int) -> tuple:
        if adjoint == "checkpoint":
            return _in_blocks(one, carry, given, count) if long else _in_row(one, carry, given, count)
        state, memory, finite_steps, done = carry
        reversed_run: Any = reversible_steps  # custom_vjp hides its signature from type checkers
        new, finite = reversed_run(method, count, dynamics, timed(state, done), dt, torque)
        return at(start, new), memory, finite_steps + finite, done + count

    def stretch(carry: tuple, given: Vector | None) -> tuple[tuple, Any]:
        carry = advance(carry, given, save_every)
        return carry, (shown(timed(carry[0], carry[3])), contact_report(carry[1]))

    saves = steps // save_every
    long = steps * len(state.position) > _IN_ONE
    bad = sound(state, method.renormalise)
    held = state if adjoint == "reversible" else method.held(dynamics, state)
    finite_steps = jnp.zeros_like(bad)
    if adjoint == "checkpoint":
        finite_steps = watch.opened(finite_steps, held)
    carry = (held, method.first_carry(dynamics, state), finite_steps, jnp.zeros((), jnp.int32))
    regular, rest = None, None
    if torque is not None and varying:
        regular = torque[: saves * save_every].reshape(saves, save_every, *torque.shape[1:])
        rest = torque[saves * save_every :]
    if adjoint == "checkpoint" and long and save_every <= _ROW:
        # Longer stretches are cut by themselves; twice would be another copy of the step's program to compile.
        stretch = jax.checkpoint(stretch, prevent_cse=False, policy=KEEP_FOUND)
    carry, saved = lax.scan(stretch, carry, regular, length=saves)
    if steps > saves * save_every:
        carry = advance(carry, rest, steps - saves * save_every)
    first = (state, contact_report(method.first_carry(dynamics, state)))
    states, contact = jax.tree.map(lambda one, later: jnp.concatenate([one[None], later]), first, saved)
    final = shown(timed(carry[0], carry[3]))
    finite_steps = watch.closed(carry[2], carry[0]) if adjoint == "checkpoint" else carry[2]
    status = status_after(bad, finite_steps, steps, final, method.renormalise)
    status = with_contact(status, contact_report(carry[1]))
    return states.time, states, final, status, contact


_run = jit(_run_steps, static_argnames=("steps", "save_every", "adjoint"))


def _in_row(one: Any, carry: tuple, given: Vector | None, length: int) -> tuple:
    if length == 1:
        return one(carry, None if given is None else given[0])[0]
    return lax.scan(one, carry, given, length=length)[0]


def _in_blocks(one: Any, carry: tuple, given: Vector | None, length: int) -> tuple:
    """`length` steps; long stretches in blocks of about √length."""
    if length <= _ROW:
        return _in_row(one, carry, given, length)
    block = _block(length)
    blocks = length // block

    def run_block(carry: tuple, given: Vector | None) -> tuple[tuple, None]:
        return lax.scan(one, carry, given, length=block)[0], None

    regular, rest = None, None
    if given is not None:
        regular = given[: blocks * block].reshape(blocks, block, *given.shape[1:])
        rest = given[blocks * block :]
    carry, _ = lax.scan(
        jax.checkpoint(run_block, prevent_cse=False, policy=KEEP_FOUND), carry, regular, length=blocks
    )
    if length > blocks * block:
        carry = _in_row(one, carry, rest, length - blocks * block)
    return carry


def _block(length: int) -> int:
    """A divisor of `length` near its root where there is one: a remainder costs a second copy of the step's program."""
    root = math.isqrt(length)
    divisors = [d for d in range(max(root // 4, 2), 4 * root) if length % d == 0]
    return min(divisors, key=lambda d: abs(math.log(d / root)), default=root)
