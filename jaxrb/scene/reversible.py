"""A reverse pass that stores nothing: a symmetric method is run backwards instead.

For a method with Φ(−dt) = Φ(dt)⁻¹ the states of the forward run are found again from its end, one step at a time, and
each step is differentiated where it stands. Memory does not grow with the number of steps; the states come back to
round-off (amplified where the motion is unstable), which is the error of the gradient. Forces that depend on velocity
make a step implicit, solved to the method's own order, and so are the states found again then (a brick with drag, steps
of 0.05 s: 7e-7 a step at order 2, 1e-11 at order 4, 4e-15 at order 6).
(Stumm and Walther 2010 for the trade; Hairer, Lubich, Wanner 2006, section V.1, for symmetric methods.)
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State, finite_per_body
from jaxrb.effects.dynamics import Dynamics
from jaxrb.integrators.method import Method
from jaxrb.math.arrays import Array, Scalar, Vector


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))  # pyright: ignore[reportArgumentType]
def reversible_steps(
    method: Method, count: int, dynamics: Dynamics, state: State, dt: Scalar, torque: Vector | None
) -> tuple[State, Array]:
    """The state `count` steps later, and the number (n,) of steps after which each body was finite."""

    def one(_: Any, carry: tuple[State, Array]) -> tuple[State, Array]:
        state, finite = carry
        new = method.step(dynamics, state, dt, torque)
        return new, finite + finite_per_body(new)

    return lax.fori_loop(0, count, one, (state, jnp.zeros(state.position.shape[0], jnp.int32)))


def _forward(method: Method, count: int, *arguments: Any) -> tuple[Any, Any]:
    dynamics, _, dt, torque = arguments
    out: Any = reversible_steps(method, count, *arguments)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return out, (dynamics, out[0], dt, torque)


def _backward(method: Method, count: int, kept: Any, cotangents: Any) -> tuple[Any, ...]:
    dynamics, end, dt, torque = kept
    none_yet = jax.tree.map(jnp.zeros_like, (dynamics, dt, torque))

    def one(_: Any, carry: Any) -> Any:
        state, to_state, gathered = carry
        before = method.step(dynamics, state, -dt, torque)
        _, pull = jax.vjp(lambda d, s, h, t: method.step(d, s, h, t), dynamics, before, dt, torque)
        to_dynamics, to_before, to_dt, to_torque = pull(to_state)
        return before, to_before, jax.tree.map(jnp.add, gathered, (to_dynamics, to_dt, to_torque))

    _, to_start, (to_dynamics, to_dt, to_torque) = lax.fori_loop(
        0, count, one, (end, cotangents[0], none_yet)
    )
    return to_dynamics, to_start, to_dt, to_torque


reversible_steps.defvjp(_forward, _backward)
