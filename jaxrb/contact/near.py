"""Which pairs of bodies may touch in a step, by boxes and balls round them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.contact.surfaces import Meeting
from jaxrb.effects.surfaces import Kind, placed
from jaxrb.geometry.bounds import AxisAlignedBox, bounding_box, bounding_sphere
from jaxrb.geometry.primitives import Box, Cylinder, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Scalar
from jaxrb.math.compaction import first_true
from jaxrb.math.safe import norm
from jaxrb.math.vector import dot

# Beyond what a body moves in a step, contacts are looked for within this share of its size: a push may come.
_SLACK = 0.01


class Near:
    """Boxes and balls round the bodies as they may move, to choose pairs by: balls fit spheres better."""

    def __init__(self, kinds: tuple[Kind, ...], state: State, reach: Scalar):
        low = jnp.full((len(reach), 3), jnp.inf, state.dtype)
        high, middle, radius, size = -low, jnp.zeros_like(low), jnp.zeros_like(reach), jnp.zeros_like(reach)
        for kind in kinds:
            members = np.asarray(kind.members)
            shape, pose = jax.lax.stop_gradient(placed(kind, np.arange(len(members)), state, members))
            box = jax.vmap(bounding_box)(shape, pose)
            slack = reach[members] + _SLACK * norm(box.high - box.low)
            low = low.at[members].set(box.low - slack[:, None])
            high = high.at[members].set(box.high + slack[:, None])
            center = 0.5 * (box.low + box.high)
            ball = _ball_radius(shape, box)
            radius, size = radius.at[members].set(ball + slack), size.at[members].set(ball)
            middle = middle.at[members].set(center)
        self.low, self.high, self.middle, self.radius, self.size = low, high, middle, radius, size

    def choose(self, meeting: Meeting) -> tuple[Any, Any]:
        """Numbers (capacity,) of the pairs whose boxes overlap, ascending, −1 beyond; whether there were more."""
        if not meeting.crowded:
            return np.arange(len(meeting.first)), False
        overlap = jnp.all(
            (self.low[meeting.first] <= self.high[meeting.second])
            & (self.low[meeting.second] <= self.high[meeting.first]),
            axis=-1,
        )
        apart = self.middle[meeting.first] - self.middle[meeting.second]
        touch = self.radius[meeting.first] + self.radius[meeting.second]
        numbers, total = first_true(overlap & (dot(apart, apart) <= touch * touch), meeting.capacity)
        return numbers, total > meeting.capacity


def _ball_radius(shape: Shape, box: AxisAlignedBox) -> Scalar:
    """Of balls about the middles of the boxes."""
    if isinstance(shape, Sphere):
        return shape.radius
    if isinstance(shape, (Box, Cylinder)):
        return jax.vmap(lambda s: bounding_sphere(s).radius)(shape)
    return 0.5 * norm(box.high - box.low)
