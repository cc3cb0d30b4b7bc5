"""Shapes of a scene's bodies as contact sees them: sorted by kind, in their place, beside what stands still."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, count_of
from jaxrb.errors import WrongStructure
from jaxrb.geometry.mesh import TriangleMesh
from jaxrb.geometry.primitives import HalfSpace, Pose
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Vector


class Kind(eqx.Module):
    """Bodies whose shapes are of one kind: leaves of `shape` and `center` (m, 3) [m] run over the `members`.

    The shape's own frame has its origin at −`center` in the body's.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    shape: Shape
    center: Vector

    def rows(self, bodies: np.ndarray) -> np.ndarray:
        """Places of body numbers among the members."""
        return np.searchsorted(np.asarray(self.members), bodies)


def kinds_of(owner: str, bodies: tuple[Body, ...], wanted: set[int]) -> list[Kind]:
    """The shapes of the wanted bodies, sorted into kinds. Messages name the effect, `owner`.

    Raises:
        WrongStructure: a body without a shape, or with one that is not convex or has no end.
    """
    found: dict[Any, list[tuple[range, Shape, Any]]] = {}
    start = 0
    for body in bodies:
        count = count_of(body)
        numbers = range(start, start + (count or 1))
        start = numbers.stop
        if not wanted & set(numbers):
            continue
        _check_shape(owner, body, numbers.start)
        shape, center = body.shape, body.center_of_mass
        if count is None:
            shape, center = jax.tree.map(lambda x: jnp.asarray(x)[None], (shape, center))
        center = jnp.broadcast_to(jnp.asarray(center), (len(numbers), 3))
        leaves, structure = jax.tree.flatten(shape)
        key = (structure, tuple(np.shape(leaf)[1:] for leaf in leaves))
        found.setdefault(key, []).append((numbers, shape, center))
    kinds = []
    for parts in found.values():
        shape, center = jax.tree.map(lambda *x: jnp.concatenate(x), *[part[1:] for part in parts])
        members = tuple(i for part in parts for i in part[0])
        kinds.append(Kind(members, shape, center))
    return kinds


def _check_shape(owner: str, body: Body, number: int) -> None:
    name = f"body {number} ({body.name!r})"
    if not isinstance(body.shape, Shape):
        raise WrongStructure(
            f"{owner}: {name} has no shape; make it by Body.from_shape, give shape=…, or leave it out by bodies=…"
        )
    if isinstance(body.shape, TriangleMesh):
        raise WrongStructure(
            f"{owner}: the mesh of {name} is not convex; use Body.from_mesh(…, convex_hull=True), or a Composite "
            "from rb.convex_decomposition"
        )
    if isinstance(body.shape, HalfSpace):
        raise WrongStructure(f"{owner}: {name} is a half-space; give it as against=…")


def placed(
    kind: Kind, rows: Array | np.ndarray, state: Any, bodies: Array | np.ndarray
) -> tuple[Shape, Pose]:
    """Shapes and poses of bodies of one kind; arrays run over the bodies."""
    shape, center = jax.tree.map(lambda leaf: leaf[rows], (kind.shape, kind.center))
    orientation = jax.tree.map(lambda leaf: leaf[bodies], state.orientation)
    return shape, Pose(state.position[bodies] - orientation.rotate(center), orientation)


def standing(pose: Pose | None, state: Any) -> Pose:
    """The pose of what stands still, in the state's representation and floating type; None is the world's own frame."""
    if pose is None:
        return Pose(jnp.zeros(3, state.dtype), type(state.orientation).identity(state.dtype))
    turned = type(state.orientation).from_rotation(pose.orientation)
    return Pose(jnp.asarray(pose.position, state.dtype), turned)


def obstacles_of(owner: str, against: Any) -> tuple[tuple[Shape, Pose | None], ...] | None:
    """What stands still, as pairs of a shape and its pose; None where the bodies meet each other.

    Raises:
        WrongStructure: something that is no convex shape.
    """
    if against is None:
        return None
    if isinstance(against, Shape):
        against = ((against, None),)
    elif isinstance(against, tuple) and len(against) == 2 and isinstance(against[1], Pose):
        against = (against,)
    if not isinstance(against, (tuple, list)):
        against = (against,)
    pairs = tuple(item if isinstance(item, (tuple, list)) else (item, None) for item in against)
    for item in pairs:
        if len(item) != 2 or not isinstance(item[0], Shape) or not isinstance(item[1], (Pose, type(None))):
            raise WrongStructure(
                f"{owner}.against: {item!r}; give a Shape, a pair (Shape, Pose), or a tuple of these"
            )
        if isinstance(item[0], TriangleMesh):
            raise WrongStructure(
                f"{owner}.against: a TriangleMesh is not convex; give its convex_hull(), or a Composite from "
                "rb.convex_decomposition"
            )
    return tuple((shape, pose) for shape, pose in pairs)
