"""Free flight: the closed form of motion without forces."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State, finite_per_body
from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, RunFailed, WrongStructure
from jaxrb.integrators.free_flight import free_rotation
from jaxrb.math.arrays import Scalar
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.status import OK, sound


def free_flight(scene: Scene, state: State, t: Scalar | float) -> State:
    """The state `t` seconds later of bodies on which nothing acts: exact to round-off for any time, at one price.

    Positions move as p + v t. Rotations follow Euler's equations in closed form (Jacobi's elliptic functions and
    Carlson's integral of the third kind; Whittaker, "Analytical Dynamics", §69): no steps, so no step error, and 1000
    revolutions cost what one costs. The angle error grows with the angle only by the round-off of the input.

    Works under `jit` and `vmap` (over worlds, or over many times), and in any representation. First derivatives with
    respect to state, inertia and `t`, forward and reverse, are the solved variational equation: right at equal moments,
    pure spin, rest and the separatrix too. Second derivatives are refused.

    Args:
        scene: bodies of any inertia, without effects; they do not touch.
        state: of this scene, with its bodies axis.
        t: () duration [s], counted from `state.time`; negative for the past.

    Raises:
        WrongStructure: the scene has effects; `t` is not one number; a second derivative is asked for.
        InvalidInput: `t` is not finite.
        RunFailed: the state is not finite, or its orientation is no rotation (not while being traced).
    """
    check_fit(scene, state)
    if scene.effects:
        names = ", ".join(type(effect).__name__ for effect in scene.effects)
        raise WrongStructure(
            f"free_flight: the scene has effects ({names}), but the closed form holds for free bodies only; use "
            "rb.rollout or rb.solve, or rb.Scene(bodies=scene.bodies) to leave the effects out"
        )
    _check_duration(t)
    final, reason = _flown(scene, state, jnp.asarray(t, state.dtype))
    if is_concrete(reason):
        _raise_if_bad(np.asarray(reason))
    return final


def _check_duration(t: Any) -> None:
    if isinstance(t, (bool, str)) or t is None:
        raise WrongStructure(f"free_flight: t is {t!r}, but must be a number [s]")
    if np.ndim(t) != 0:
        raise WrongStructure(
            f"free_flight: t has shape {np.shape(t)}; give one number [s], and for many times use "
            "jax.vmap(lambda t: rb.free_flight(scene, state, t))(times)"
        )
    if is_concrete(t) and not np.isfinite(t):
        raise InvalidInput(f"free_flight: t is {t!r} s, but must be finite")


def _raise_if_bad(reason: np.ndarray) -> None:
    if (reason == OK).all():
        return
    body = int((reason != OK).argmax())
    raise RunFailed(
        f"free_flight: body {body}: its state is not finite, before the flight or after it, or its orientation is no "
        "rotation; look at state.position, .velocity, .angular_velocity and .orientation.drift() of this body"
    )


@jax.jit
def _flown(scene: Scene, state: State, t: Scalar) -> tuple[State, jax.Array]:
    with jax.named_scope("free_flight"):
        inertia = scene.prepared(state.dtype).inertia.inertia
        turn, omega = jax.vmap(free_rotation, in_axes=(0, 0, None))(inertia, state.angular_velocity, t)
        final = State(
            state.position + state.velocity * t,
            _turned(state, turn).renormalise(),
            state.velocity,
            omega,
            state.time + t,
        )
        reason = jnp.where(finite_per_body(final), sound(state, True), 1)
        return final, jax.lax.stop_gradient(reason)


def _turned(state: State, turn: Quaternion) -> Any:
    orientation = state.orientation
    return orientation @ type(orientation).from_rotation(turn)
