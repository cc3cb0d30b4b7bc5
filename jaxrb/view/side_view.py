"""Bodies seen from the side, drawn flat: outlines of their shapes, those behind first."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import count_of
from jaxrb.body.state import State
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.mesh import TriangleMesh
from jaxrb.geometry.primitives import HalfSpace
from jaxrb.geometry.shape import Shape
from jaxrb.scene.scene import Scene

_DIRECTIONS = 96  # in which the outline's farthest point is asked for


def outlines(scene: Scene, state: State, across: int = 0) -> list[np.ndarray | None]:
    """Outline (k, 2) [m] of each body in the plane of `across` (0: x, 1: y) and z: that of its convex hull.

    None for a body that has no shape with an outline.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False) + 1e-3
    directions = np.zeros((_DIRECTIONS, 3))
    directions[:, across], directions[:, 2] = np.cos(angles), np.sin(angles)
    looked = jnp.asarray(directions, state.dtype)
    found: list[np.ndarray | None] = []
    start = 0
    for body in scene.bodies:
        count = count_of(body)
        rows = np.arange(start, start + (count or 1))
        start += len(rows)
        if not isinstance(body.shape, Shape) or isinstance(body.shape, (TriangleMesh, HalfSpace)):
            found += [None] * len(rows)
            continue
        shape, center = body.shape, body.center_of_mass
        if count is None:
            shape, center = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (shape, center))
        center = jnp.broadcast_to(jnp.asarray(center, state.dtype), (len(rows), 3))
        place = jax.tree.map(lambda leaf, rows=rows: leaf[rows], (state.position, state.orientation))
        points = np.asarray(_farthest(shape, center, *place, looked))
        found += list(points[..., [across, 2]])
    return found


@jax.jit
def _farthest(shape: Any, center: Any, position: Any, orientation: Any, directions: Any) -> Any:
    def of_one(shape: Any, center: Any, position: Any, orientation: Any) -> Any:
        def along(direction: Any) -> Any:
            return position + orientation.rotate(shape.farthest(orientation.unrotate(direction)) - center)

        return jax.vmap(along)(directions)

    return jax.vmap(of_one)(shape, center, position, orientation)


def side_of(scene: Scene, states: State) -> int:
    """The horizontal axis along which more is to be seen: 0 for x, 1 for y."""
    reach = np.ptp(np.asarray(states.position, float).reshape(-1, 3), axis=0)
    return int(reach[1] > 1.01 * reach[0])


def draw_side(axes: Any, scene: Scene, state: State, across: int = 0) -> None:
    """Bodies, and the half-spaces that are seen edge on."""
    from matplotlib.collections import PolyCollection

    shapes = outlines(scene, state, across)
    position = np.asarray(state.position, float)
    behind = np.argsort(-position[:, 1 - across] if across == 0 else position[:, 1 - across], kind="stable")
    order = [i for i in behind if shapes[i] is not None]
    polygons = [np.asarray(shapes[i]) for i in order]
    colours = [f"C{i % 10}" for i in order]
    axes.add_collection(
        PolyCollection(polygons, facecolors=colours, edgecolors="k", linewidths=0.5, alpha=0.85)
    )
    without = [i for i, shape in enumerate(shapes) if shape is None]
    axes.plot(position[without, across], position[without, 2], "o", markersize=4)
    corners = np.concatenate([*polygons, position[:, [across, 2]]])
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = 0.08 * max(float((high - low).max()), 1e-6)
    axes.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    axes.set_aspect("equal")
    axes.set(xlabel=f"{'xy'[across]} [m]", ylabel="z [m]")
    for plane in _planes(scene, across):
        _draw_plane(axes, plane, across)


def _planes(scene: Scene, across: int) -> list[HalfSpace]:
    obstacles = [
        (shape, pose)
        for effect in scene.effects
        if isinstance(effect, RigidContact)
        for shape, pose in effect.against or ()
    ]
    return [
        shape
        for shape, pose in obstacles
        if isinstance(shape, HalfSpace) and pose is None and abs(float(shape.normal[1 - across])) < 1e-9
    ]


def _draw_plane(axes: Any, plane: HalfSpace, across: int) -> None:
    normal = np.asarray(plane.normal, float)[[across, 2]]
    through = float(plane.offset) * normal
    axes.axline(through, through + np.array([normal[1], -normal[0]]), color="0.4", linewidth=1.2, zorder=0)
