"""How accurate a run was, told by the run itself.

Beside the run with step dt, two cheaper ones with 2 dt and 4 dt start from the same state. With a method of order p the
error of the run is about its distance from the second divided by 2^p − 1 (Richardson 1911); the distance of the third
from the second tells whether that may be trusted: it should be 2^p times larger. Where it is not, because round-off
rules or because the steps are too coarse for the order to show, the ratio that was seen takes the place of 2^p, and
`reliable` says so. The two runs cost three quarters of the run, and estimate the global error, which an embedded pair
of methods does not.

With contact the order is 1 and hardly shows, since each impact, stick and slip falls elsewhere into its step: of 12
tosses of a cube the two runs told the error to a factor of 10 in 7. There a run of `solve_contact` judges; where it
cannot (a torque, a `Composite`, crowds), the mean of what both distances tell, and `reliable` says no more than that
the runs have not lost each other.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import norm, safe_sqrt
from jaxrb.scene.scene import Scene, energy

# Places along the run at which the runs are compared; more would cost memory, fewer would miss a passing maximum.
MOST_PLACES = 256
# Beyond this distance [rad] of the coarse runs, attitudes are so far apart that no order can show.
LOST = 0.5


class Certificate(eqx.Module):
    """Estimated errors of a run, for each body (n,).

    attitude_error [rad] and position_error [m] at the end, and their largest values on the way (`..._max`);
    attitude_drift (n, 3) [rad] is the rotation vector in the body frame by which the run is off at the end: along
    the angular velocity positive means ahead. energy_error [J] is of the whole scene at the end, with its sign:
    positive means that the run has gained energy. `order_seen` (n,) is the order at which the attitude converges,
    `reliable` (n,) whether that is near the method's, or the error is mere round-off. `met` (n,) is whether the
    largest attitude error [rad] and position error [m] are reliably below `tolerance`; None where none was stated.
    """

    attitude_error: Scalar
    attitude_error_max: Scalar
    attitude_drift: Vector
    position_error: Scalar
    position_error_max: Scalar
    energy_error: Scalar
    order_seen: Scalar
    reliable: Array
    tolerance: Scalar | None
    met: Array | None


@jax.jit
def certificate_between(
    scene: Scene, states: State, judge: State, reason: Array, tolerance: Scalar | None
) -> Certificate:
    """The certificate of a run by a more accurate one: states (k, …) of both at the same times, the last the end.

    `reason` (n,): not zero where one of the two went wrong. `order_seen` is NaN: of one difference there is none.
    """
    scene, states, judge, tolerance = lax.stop_gradient((scene, states, judge, tolerance))
    turn = _turns(judge, states)
    round_off = jnp.finfo(states.dtype).eps
    attitude = norm(turn) + round_off
    position = norm(states.position - judge.position)
    largest, farthest = jnp.max(attitude, axis=0), jnp.max(position, axis=0)
    energies = [energy(scene, jax.tree.map(lambda leaf: leaf[-1], run)) for run in (states, judge)]
    reliable = (largest <= LOST) & (reason == 0) & jnp.isfinite(farthest)
    met = None
    if tolerance is not None:
        met = (1.25 * largest <= tolerance) & (1.25 * farthest <= tolerance) & reliable
    return Certificate(
        attitude[-1], largest, turn[-1], position[-1], farthest, energies[0] - energies[1],
        jnp.full_like(largest, jnp.nan), reliable, tolerance, met,
    )  # fmt: skip


def stride_of(steps: int, save_every: int) -> int:
    """Saves from one place of comparison to the next: a multiple of four steps, at most `MOST_PLACES` places."""
    fewest = next(g for g in (1, 2, 4) if (g * save_every) % 4 == 0)
    blocks = steps // (fewest * save_every)
    return fewest * max(1, -(-blocks // MOST_PLACES))


def check_certifiable(torque: Any, steps: int, save_every: int) -> None:
    """Refuse runs that cannot be compared with coarser ones."""
    if torque is not None and torque.ndim == 3:
        raise WrongStructure(
            "certify: a torque given step by step is another problem for other steps; use the effect PrescribedTorque "
            "with times"
        )
    if steps < stride_of(steps, save_every) * save_every:
        raise InvalidInput(
            f"certify: {steps} steps with save_every = {save_every} leave nothing to compare; take at least "
            f"{stride_of(steps, save_every) * save_every} steps, or save_every = 1"
        )


def certificate_of(
    scene: Scene,
    states: State,
    torque: Vector | None,
    dt: Scalar,
    method: Method,
    steps: int,
    save_every: int,
    tolerance: float | None,
) -> Certificate:
    """The certificate of a run of `steps` steps whose saved states are `states` (k, …), the start among them."""
    check_certifiable(torque, steps, save_every)
    if torque is None and any(isinstance(effect, RigidContact) for effect in scene.effects):
        from jaxrb.scene.adaptive import (
            judged,
            takes,
        )  # with the collision floor: few runs are certified in contact

        if takes(scene, states):
            return judged(scene, states, tolerance)
    stride = stride_of(steps, save_every)
    places = jax.tree.map(lambda leaf: leaf[::stride], states)
    return _certify(scene, places, torque, dt, method, jnp.asarray(stride * save_every), tolerance)


@jax.jit
def _certify(
    scene: Scene,
    states: State,
    torque: Vector | None,
    dt: Scalar,
    method: Method,
    stride_steps: Array,
    tolerance: Scalar | None,
) -> Certificate:
    scene, states, torque, dt = lax.stop_gradient((scene, states, torque, dt))
    coarse = _coarser_runs(scene, states, torque, dt, method, stride_steps)
    twice, fourfold = (jax.tree.map(lambda leaf, i=i: leaf[i], coarse) for i in (0, 1))
    fine = jax.tree.map(lambda leaf: leaf[1:], states)
    touches = any(isinstance(effect, RigidContact) for effect in scene.effects)
    order = 1 if touches else method.order
    expected = 2.0**order
    # What round-off does to a run that amplifies nothing; where it is amplified, the distances show it.
    steps = (states.time.shape[0] - 1) * stride_steps.astype(states.dtype)
    round_off = jnp.finfo(states.dtype).eps * jnp.sqrt(steps)

    turn, turn_coarse = _turns(fine, twice), _turns(twice, fourfold)
    attitude, ratio = _errors(norm(turn), norm(turn_coarse), expected)
    position, _ = _errors(
        norm(twice.position - fine.position), norm(fourfold.position - twice.position), expected
    )
    energies = [jax.vmap(energy, in_axes=(None, 0))(scene, run) for run in (fine, twice, fourfold)]
    energy_gap = (energies[1] - energies[0])[-1]
    energy_ratio = _ratio(
        jnp.abs(energies[1] - energies[0])[:, None], jnp.abs(energies[2] - energies[1])[:, None]
    )
    lost = jnp.max(norm(turn_coarse), axis=0) > LOST
    if touches:
        attitude = _irregular(norm(turn), norm(turn_coarse))
        position = _irregular(norm(twice.position - fine.position), norm(fourfold.position - twice.position))
        lost = jnp.max(norm(turn), axis=0) > LOST
    attitude = attitude + round_off
    largest = jnp.max(attitude, axis=0)
    order_seen = jnp.log2(jnp.maximum(ratio, 1.0))
    regular = touches | (order_seen > order - 0.5) | (largest < 1e3 * round_off)
    reliable = regular & ~lost
    met = None
    if tolerance is not None:
        # A quarter of room: the estimate is good to some ten per cent where the order shows.
        met = (1.25 * largest <= tolerance) & (1.25 * jnp.max(position, axis=0) <= tolerance) & reliable
    return Certificate(
        attitude[-1],
        largest,
        # The run with double steps errs in the same direction; "ahead" is the run against the truth.
        turn[-1] / (_clipped(ratio, expected) - 1.0)[:, None],
        position[-1],
        jnp.max(position, axis=0),
        energy_gap / (_clipped(energy_ratio, 2.0 * expected)[0] - 1.0),
        order_seen,
        reliable,
        tolerance,
        met,
    )


def _coarser_runs(
    scene: Scene, states: State, torque: Vector | None, dt: Scalar, method: Method, stride_steps: Array
) -> State:
    """States (2, k − 1, …) at the same places, run with 2 dt and 4 dt by one program."""
    dynamics = scene.prepared(states.dtype)
    start = jax.tree.map(lambda leaf: leaf[0], states)

    def run(factor: Array) -> State:
        step = dt * factor.astype(dt.dtype)
        count = stride_steps // factor

        def one(_: Any, carry: Any) -> Any:
            return method.carried_step(dynamics, carry[0], carry[1], step, torque)

        def to_next_place(carry: Any, time: Scalar) -> tuple[Any, State]:
            end, memory = lax.fori_loop(0, count, one, carry)
            end = State(end.position, end.orientation, end.velocity, end.angular_velocity, time)
            return (end, memory), end

        return lax.scan(to_next_place, (start, method.first_carry(dynamics, start)), states.time[1:])[1]

    return lax.map(run, jnp.asarray([2, 4]))


def _irregular(distance: Array, coarse_distance: Array) -> Array:
    """Errors (k, n) where they are of order 1 on the mean, and not in each case."""
    return safe_sqrt(distance * 0.5 * coarse_distance)


def _turns(a: State, b: State) -> Vector:
    """Rotation vectors (k, n, 3) [rad], in the body frame, from the attitudes of a to those of b."""
    return (a.orientation.normalise().inverse() @ b.orientation.normalise()).log()


def _ratio(distance: Array, coarse_distance: Array) -> Array:
    """By how much the error grows when the step doubles: of the largest distances along the run, for each body."""
    near, far = jnp.max(distance, axis=0), jnp.max(coarse_distance, axis=0)
    return jnp.where(near > 0, far / jnp.where(near > 0, near, 1.0), 1.0)


def _clipped(ratio: Array, expected: float) -> Array:
    # Never below 2: then the distance itself is the estimate, as it should be where round-off rules.
    return jnp.clip(ratio, 2.0, expected)


def _errors(distance: Array, coarse_distance: Array, expected: float) -> tuple[Array, Array]:
    """Estimated errors (k, n) and the ratio (n,)."""
    ratio = _ratio(distance, coarse_distance)
    return distance / (_clipped(ratio, expected) - 1.0), ratio
