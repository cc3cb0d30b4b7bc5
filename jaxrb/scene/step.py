"""One step of a scene."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxrb.body.state import State
from jaxrb.checks import raise_if_overflowed
from jaxrb.compilation import jit
from jaxrb.errors import WrongStructure
from jaxrb.integrators.method import Method, contact_report
from jaxrb.integrators.names import method_of
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import applied_torque, check_positive, check_representation
from jaxrb.scene.status import TOO_MANY


def step(
    scene: Scene,
    state: State,
    torque: Vector | None = None,
    dt: Scalar | float = 1e-3,
    *,
    method: Method | str = RungeKutta4(),  # noqa: B008 - an immutable value
) -> State:
    """The state one step of `dt` [s] later: a pure function of all its arguments.

    Args:
        scene: bodies and effects; differentiate and `vmap` over its numbers as you like.
        state: of this scene.
        torque: applied torque in the body frame [N m], (n, 3) or (3,); None is none, and costs nothing.
        dt: step [s].
        method: how to advance.

    Raises:
        LimitExceeded: more bodies are near each other than `RigidContact` has room for. A step that is being traced
            cannot raise: its positions are then NaN.
    """
    method = method_of(method)
    check_fit(scene, state)
    check_representation(method, state)
    check_positive("dt", dt)
    if method.first_remainder(state) is not None:
        raise WrongStructure(
            f"step: {type(method).__name__}(compensated=True) carries a remainder from step to step, which a single "
            "step would lose; use rb.rollout, or compensated=False"
        )
    new, overflow = _step(scene, state, applied_torque(torque, state), jnp.asarray(dt, state.dtype), method)
    raise_if_overflowed(overflow, f"step: {TOO_MANY}")
    return new


def stepper(scene: Scene, dt: float, *, method: Method | str = RungeKutta4()) -> Callable[..., State]:  # noqa: B008
    """`step(state, torque=None) -> state` with the scene, the step `dt` [s] and the method built in.

    The result is pure: `jax.jit`, `jax.vmap` and `jax.grad` it. Under `jit` the scene's numbers are constants of the
    program; use `rb.step` to differentiate with respect to them.
    """
    method = method_of(method)
    check_positive("dt", dt)

    def step_of_scene(state: State, torque: Any = None) -> State:
        return step(scene, state, torque, dt, method=method)

    return step_of_scene


@jit
def _step(
    scene: Scene, state: State, torque: Vector | None, dt: Scalar, method: Method
) -> tuple[State, Array | bool]:
    dynamics = scene.prepared(state.dtype)
    carry = method.first_carry(dynamics, state)
    new, carry = method.carried_step(dynamics, state, carry, dt, torque)
    report = contact_report(carry)
    if report is None:
        return new, False
    overflow = report.overflow >= 0
    lost = jnp.where(overflow, jnp.nan, new.position)
    return eqx.tree_at(lambda s: s.position, new, lost), overflow
