"""What of a scene can be seen: each body's parts, what stands still, and bounding volumes."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import count_of
from jaxrb.body.inertia import principal_axes
from jaxrb.errors import JaxrbError
from jaxrb.geometry.bounds import bounding_sphere, oriented_box
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.mesh import TriangleMesh
from jaxrb.geometry.primitives import Box, Composite, HalfSpace, Pose, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.matrix import RotationMatrix
from jaxrb.scene.scene import Scene
from jaxrb.view.viewer_surfaces import Part, matrix_of, parts_of, placed, quaternion_of

_FALLBACK = 0.05  # [m], of a body that has neither a shape nor an inertia to take a size from


@dataclass
class Seen:
    """A body or something that stands still. `parts` in the body's frame, or in the world's.

    `note` says what is drawn where that is not the shape itself; `plane` (4,) is normal and offset of a half-space.
    `ball` (4,) is centre and radius, `box` (10,) centre, orientation wxyz and half extents, `hull` (e, 2, 3) the edges
    of the convex hull of what is not convex, all [m] in the frame of `parts`.
    """

    name: str
    parts: list[Part]
    note: str = ""
    plane: np.ndarray | None = None
    ball: np.ndarray | None = None
    box: np.ndarray | None = None
    hull: np.ndarray | None = None
    shape: Any = field(default=None, repr=False)
    center: Any = field(default=None, repr=False)


def bodies_of(scene: Scene) -> list[Seen]:
    """Each body of a scene, in its order."""
    single = [(body.name, one) for body in scene.bodies for one in _one_by_one(body)]
    names = [name for name, _ in single]
    found = []
    for i, (name, body) in enumerate(single):
        label = name if names.count(name) == 1 else f"{name} {i}"
        found.append(_body(label, body))
    return found


def obstacles_of(scene: Scene) -> list[Seen]:
    """What stands still for the scene's contacts, each once."""
    found, known = [], set()
    for effect in scene.effects:
        for shape, pose in getattr(effect, "against", None) or ():
            key = str(
                [(type(shape), *(np.asarray(leaf).tolist() for leaf in jax.tree.leaves((shape, pose))))]
            )
            if key in known:
                continue
            known.add(key)
            where = Pose.identity() if pose is None else pose
            if isinstance(shape, HalfSpace):
                turned = matrix_of(quaternion_of(where.orientation))
                normal = turned @ np.asarray(shape.normal, float)
                offset = float(shape.offset) + float(normal @ np.asarray(where.position, float))
                found.append(Seen("half-space", [], plane=np.append(normal, offset)))
            else:
                parts = [placed(part, where) for part in parts_of(shape)]
                found.append(Seen(type(shape).__name__, parts, _inexact(parts)))
    return found


def _one_by_one(body: Any) -> Iterator[Any]:
    """The bodies on a bodies axis."""
    count = count_of(body)
    if count is None:
        yield body
        return
    host = jax.tree.map(np.asarray, body)
    for i in range(count):
        yield jax.tree.map(lambda leaf, i=i: leaf[i], host)


def _body(name: str, body: Any) -> Seen:
    center = np.broadcast_to(np.asarray(body.center_of_mass, float), (3,))
    shape = body.shape
    if not isinstance(shape, Shape) or isinstance(shape, HalfSpace):
        return _without_shape(name, body)
    away = Pose(-center, RotationMatrix(np.eye(3)))
    parts = [placed(part, away) for part in parts_of(shape)]
    return Seen(name, parts, _inexact(parts), shape=shape, center=center)


def _inexact(parts: list[Part]) -> str:
    return "" if all(part.exact for part in parts) else "drawn as its bounding box"


def _without_shape(name: str, body: Any) -> Seen:
    """The homogeneous box with the body's mass and inertia; a small ball for a point mass."""
    moments, axes = (np.asarray(x, float) for x in principal_axes(body.inertia))
    squares = 1.5 / float(body.mass) * (moments.sum() - 2.0 * moments)  # of half edges: I₁ = m (b² + c²)/3
    if not moments.max() > 0 or not np.isfinite(squares).all():
        (part,) = parts_of(Sphere(_FALLBACK))
        return Seen(name, [part], "no shape: drawn as a small ball")
    thin = 0.01 * np.sqrt(squares.max())  # of a flat or thin body, so that there is something to see
    half = np.maximum(np.sqrt(np.maximum(squares, 0.0)), thin)
    (part,) = parts_of(Box(half))
    part = placed(part, Pose(np.zeros(3), RotationMatrix(axes)))
    box = np.concatenate([np.zeros(3), part.orientation, half])
    return Seen(name, [part], "no shape: drawn as the box of the same mass and inertia", box=box)


def add_bounds(bodies: list[Seen]) -> str:
    """Give each body with a shape its bounding sphere, oriented box and hull; returns what is missing, and why."""
    groups: dict[Any, list[Seen]] = {}
    for seen in bodies:
        if seen.shape is not None:
            leaves, structure = jax.tree.flatten(seen.shape)
            groups.setdefault((structure, tuple(np.shape(leaf) for leaf in leaves)), []).append(seen)
    missing = ""
    for members in groups.values():
        if isinstance(members[0].shape, (ConvexHull, TriangleMesh, Composite)):
            missing = _bounds_of_points(members) or missing
        else:
            _bounds_of_primitives(members)
    return missing


@jax.jit
@jax.vmap
def _both(shape: Any) -> Any:
    return bounding_sphere(shape), oriented_box(shape)


def _bounds_of_primitives(members: list[Seen]) -> None:
    shapes = jax.tree.map(lambda *leaves: np.stack(leaves), *(seen.shape for seen in members))
    try:
        ball, box = jax.tree.map(lambda x: np.asarray(x, float), _both(shapes))
    except JaxrbError:
        return  # a shape of a kind of one's own: no sphere or box of it is known
    for i, seen in enumerate(members):
        turn = quaternion_of(RotationMatrix(jnp.asarray(box.pose.orientation.as_matrix()[i])))
        _take(seen, ball.center[i], ball.radius[i], box.pose.position[i], turn, box.half_extents[i])


def _bounds_of_points(members: list[Seen]) -> str:
    """Found on the host, so once for all that are equal; needs scipy."""
    known: dict[bytes, Any] = {}
    for seen in members:
        key = b"".join(np.asarray(leaf, float).tobytes() for leaf in jax.tree.leaves(seen.shape))
        try:
            if key not in known:
                known[key] = bounding_sphere(seen.shape), oriented_box(seen.shape), _hull_edges(seen.shape)
        except JaxrbError as error:
            return f"bounding volumes of {type(seen.shape).__name__} are not there: {error}"
        ball, box, edges = known[key]
        turn = quaternion_of(box.pose.orientation)
        _take(seen, ball.center, ball.radius, box.pose.position, turn, box.half_extents)
        seen.hull = None if edges is None else edges - seen.center
    return ""


def _hull_edges(shape: Any) -> np.ndarray | None:
    if isinstance(shape, ConvexHull):
        return None
    hull = ConvexHull(np.concatenate([part.points() for part in parts_of(shape)]))
    return np.asarray(hull.vertices, float)[np.asarray(hull.edges)[:, :2]]


def _take(seen: Seen, middle: Any, radius: Any, corner: Any, turn: Any, half: Any) -> None:
    seen.ball = np.append(np.asarray(middle, float) - seen.center, float(radius))
    seen.box = np.concatenate([np.asarray(corner, float) - seen.center, turn, np.asarray(half, float)])
