"""A body whose motion is given: a shaker, a crank, a planet on its known orbit."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxrb.body.state import State
from jaxrb.body.unturned import Unturned
from jaxrb.effects.effect import Effect, check_indices
from jaxrb.errors import WrongStructure
from jaxrb.geometry.primitives import Pose
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.quaternion import Quaternion


class PrescribedMotion(Effect):
    """Moves a body as `function(time, parameters) -> Pose` says, whatever pushes it: `time` () [s], the pose in W.

    Velocity and angular velocity are the pose's derivatives, found by differentiating the function, so they always
    agree with it. Other effects see the body where it is at each stage of a step; nothing acts on it, and what drives
    it gives or takes any energy. `parameters` is any tree of arrays and may be differentiated. `body` is its number.
    In a state of the scene leave out what the function determines, or give it as the function does. Define the
    function once: a new function object means a new trace.
    """

    function: Callable[..., Pose] = eqx.field(static=True)
    parameters: Any = None
    body: int = eqx.field(static=True, default=0, kw_only=True)

    def __post_init__(self):
        super().__post_init__()
        if not callable(self.function):
            raise WrongStructure(
                f"PrescribedMotion.function: {self.function!r} is no function; give function(time, parameters) -> Pose"
            )

    def check(self, count: int) -> None:
        check_indices("PrescribedMotion", "body", (self.body,), count)

    def complete(self, state: State) -> State:
        """The state with the body where it is at `state.time`, and as fast."""
        with jax.named_scope("PrescribedMotion"):
            (place, wxyz), (velocity, rate) = jax.jvp(
                lambda time: self._course(time, state.dtype), (state.time,), (jnp.ones_like(state.time),)
            )
            i, orientation = self.body, state.orientation
            if not isinstance(orientation, Unturned):  # a method's own, in the middle of a step
                turned = type(orientation).from_rotation(Quaternion(wxyz))
                orientation = jax.tree.map(lambda all_, one: all_.at[i].set(one), orientation, turned)
            return State(
                state.position.at[i].set(place),
                orientation,
                state.velocity.at[i].set(velocity),
                state.angular_velocity.at[i].set(_body_rate(wxyz, rate)),
                state.time,
            )

    def _course(self, time: Scalar, dtype: Any) -> tuple[Vector, Any]:
        pose = self.function(time, self.parameters)
        if not isinstance(pose, Pose):
            raise WrongStructure(
                f"PrescribedMotion: {self.function} returned {type(pose).__name__}; return rb.Pose(position, "
                "orientation)"
            )
        wxyz = pose.orientation.normalise().as_quaternion_array()
        return jnp.asarray(pose.position, dtype), jnp.asarray(wxyz, dtype)


def _body_rate(wxyz: Any, rate: Any) -> Vector:
    """ω in B from q and q̇: the vector part of 2 q* ⊗ q̇."""
    w, x, y, z = components(wxyz)
    dw, dx, dy, dz = components(rate)
    return stack(
        2.0 * (w * dx - x * dw - y * dz + z * dy),
        2.0 * (w * dy + x * dz - y * dw - z * dx),
        2.0 * (w * dz - x * dy + y * dx - z * dw),
    )
