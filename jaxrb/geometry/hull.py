"""Convex polytopes: the hull of given points, with its faces and edges."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body import mass_properties as closed_form
from jaxrb.body.mass_properties import MassProperties
from jaxrb.checks import as_array, is_concrete, quantity
from jaxrb.errors import InvalidInput, JaxrbError, WrongStructure
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import unit_or
from jaxrb.math.vector import cross

# Neighbouring triangles whose unit normals differ by no more than this lie in one face. An arc of normals of this
# length moves a support value by as much of the hull's size, which is round-off.
_SAME_PLANE = 1e-14


class ConvexHull(Shape):
    """The convex hull of points (n, 3) [m], n ≥ 4, in a frame of its own.

    Found once, on the host, in float64 (Barber, Dobkin, Huhdanpaa 1996, "The quickhull algorithm for convex hulls";
    scipy). Points inside are dropped. `vertices` (v, 3) are numbers and carry derivatives; what follows counts vertices
    from 0 and is found again only by constructing another hull, so vertices may be moved (`with_vertices`) as long as
    they stay the hull's corners:

    * `faces` (f, 3): three corners of each plane face, far apart, anticlockwise seen from outside.
    * `edges` (e, 4): both ends of each edge, then the two faces that it joins.
    * `triangles` (t, 3): the whole surface, for volumes and pictures.

    The whole numbers are leaves as well, so that hulls of many kinds can share one program (`stack_hulls`).

    Raises:
        InvalidInput: fewer than four points, points that are not finite or lie in one plane.
    """

    vertices: Array = quantity((), unit="m")
    faces: Array = eqx.field(init=False)
    edges: Array = eqx.field(init=False)
    triangles: Array = eqx.field(init=False)

    def __post_init__(self):
        vertices = as_array("ConvexHull.vertices", self.vertices)
        if np.ndim(vertices) != 2 or np.shape(vertices)[1] != 3:
            raise WrongStructure(
                f"ConvexHull.vertices: the shape is {np.shape(vertices)}, but must be (n, 3); for many hulls make one "
                "of each and join them by `stack_hulls`"
            )
        if not is_concrete(vertices):
            raise WrongStructure(
                "ConvexHull: which points are corners is found on the host and cannot be traced; make the hull outside "
                "of jit, grad and vmap, and move its corners inside by `with_vertices`"
            )
        kept, self.faces, self.edges, self.triangles = _topology(np.asarray(vertices, float))
        self.vertices = vertices[kept]

    def mass_properties(self, density: Scalar) -> MassProperties:
        """Mass, centre of mass and inertia when filled with `density` [kg/m³]: exact, by signed tetrahedra."""
        return closed_form.of_closed_surface(density, self.vertices, self.triangles)  # pyright: ignore[reportArgumentType]

    def support(self, direction: Vector) -> Vector:
        vertices, direction = jnp.asarray(self.vertices), jnp.asarray(direction)
        heights = jax.lax.stop_gradient(jnp.sum(vertices * direction[..., None, :], axis=-1))
        return vertices[..., jnp.argmax(heights, axis=-1), :]

    def with_vertices(self, vertices: Array) -> "ConvexHull":
        """The same faces and edges between moved corners (v, 3); convexity is the caller's promise.

        Raises:
            WrongStructure: another number of corners.
        """
        if np.shape(vertices)[-2:] != np.shape(self.vertices)[-2:]:
            raise WrongStructure(
                f"ConvexHull.with_vertices: the shape is {np.shape(vertices)}, but this hull's corners are "
                f"{np.shape(self.vertices)}"
            )
        return eqx.tree_at(lambda hull: hull.vertices, self, vertices)

    def face_normals(self) -> Array:
        """Unit normals (..., f, 3) of the faces, outward, from the vertices as they are."""
        a, b, c = (jnp.take_along_axis(self.vertices, self.faces[..., i, None], axis=-2) for i in range(3))
        normal = cross(b - a, c - a)
        return unit_or(normal, jnp.zeros_like(normal))


def stack_hulls(hulls: Sequence[ConvexHull]) -> ConvexHull:
    """Many hulls as one whose leaves carry a leading axis, for `jax.vmap`.

    Smaller ones are filled up by repeating their last vertex and face, by triangles without area and by edges between a
    face and itself, which changes no answer.
    """
    if not hulls or not all(isinstance(hull, ConvexHull) for hull in hulls):
        raise WrongStructure("stack_hulls: give at least one ConvexHull, and nothing else")

    def joined(name: str) -> Array:
        leaves = [getattr(hull, name) for hull in hulls]
        if name == "edges":
            leaves = [np.concatenate([edges, edges[-1:, [0, 1, 2, 2]]]) for edges in leaves]
        length = max(len(leaf) for leaf in leaves)
        xp: Any = np if all(isinstance(leaf, np.ndarray) for leaf in leaves) else jnp
        mode = "constant" if name == "triangles" else "edge"
        return xp.stack([xp.pad(leaf, ((0, length - len(leaf)), (0, 0)), mode=mode) for leaf in leaves])

    names = ("vertices", "faces", "edges", "triangles")
    return eqx.tree_at(lambda h: [getattr(h, n) for n in names], hulls[0], [joined(n) for n in names])


def _topology(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of the corners, and faces, edges, triangles counted in these corners."""
    quickhull = _quickhull(points)
    triangles = quickhull.simplices.copy()
    normals = quickhull.equations[:, :3]
    a, b, c = points[triangles[:, 0]], points[triangles[:, 1]], points[triangles[:, 2]]
    backward = np.einsum("ti,ti->t", np.cross(b - a, c - a), normals) < 0
    triangles[backward] = triangles[backward][:, ::-1]
    face_of = _planes(points, triangles, normals, quickhull.neighbors)
    faces = np.array(
        [
            _corners(points, triangles[face_of == f], normals[face_of == f][0])
            for f in range(face_of.max() + 1)
        ]
    )
    # Opposite to its k-th corner a triangle of quickhull has its k-th neighbour.
    first, k = np.nonzero(quickhull.neighbors > np.arange(len(normals))[:, None])
    second = quickhull.neighbors[first, k]
    ends = np.stack(
        [quickhull.simplices[first, (k + 1) % 3], quickhull.simplices[first, (k + 2) % 3]], axis=1
    )
    between = face_of[first] != face_of[second]
    edges = np.concatenate([ends, face_of[first][:, None], face_of[second][:, None]], axis=1)[between]
    kept = np.unique(np.concatenate([faces.ravel(), edges[:, :2].ravel(), triangles.ravel()]))
    number = np.zeros(len(points), np.int32)
    number[kept] = np.arange(len(kept))
    edges[:, :2] = number[edges[:, :2]]
    return kept, number[faces], edges.astype(np.int32), number[triangles]


def _quickhull(points: np.ndarray) -> Any:
    if not np.isfinite(points).all():
        bad = np.argwhere(~np.isfinite(points))[0][0]
        raise InvalidInput(
            f"ConvexHull.vertices: point {bad} is {points[bad].tolist()} m, but must be finite"
        )
    distinct = np.unique(points, axis=0)
    if len(distinct) < 4:
        raise InvalidInput(
            f"ConvexHull.vertices: {len(distinct)} different points enclose no volume; give at least four, not "
            "in one plane"
        )
    try:
        from scipy.spatial import ConvexHull as Quickhull
        from scipy.spatial import QhullError
    except ImportError as error:
        raise JaxrbError("ConvexHull needs scipy: pip install jaxrb[mesh]") from error
    centred = points - distinct.mean(axis=0)
    extent = np.linalg.svd(centred, compute_uv=False)
    if extent[2] <= 1e-14 * extent[0]:
        flat = "on one line" if extent[1] <= 1e-14 * extent[0] else "in one plane"
        raise InvalidInput(
            f"ConvexHull.vertices: all {len(points)} points lie {flat}, so they enclose no volume; give the solid some "
            "thickness, or use a Box or Capsule"
        )
    try:
        return Quickhull(centred / np.abs(centred).max())
    except QhullError as error:
        raise InvalidInput(f"ConvexHull.vertices: no hull was found: {str(error).splitlines()[0]}") from error


def _planes(
    points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, neighbours: np.ndarray
) -> np.ndarray:
    """The number of the plane face of each triangle (t,): neighbours with one normal are one face.

    Where points nearly coincide quickhull joins triangles that are not quite in one plane; such faces are left apart.
    """
    face_of = _joined(normals, neighbours)
    count = face_of.max() + 1
    size = np.abs(points - points.mean(axis=0)).max()
    for face in range(count):
        members = np.nonzero(face_of == face)[0]
        if len(members) == 1:
            continue
        a, b, c = points[_corners(points, triangles[members], normals[members[0]])]
        normal = np.cross(b - a, c - a)
        off = (points[triangles[members]] - a) @ (normal / np.linalg.norm(normal))
        if np.abs(off).max() > 8 * np.finfo(float).eps * size:
            face_of[members[1:]] = np.arange(count, count + len(members) - 1)
            count += len(members) - 1
    return face_of


def _joined(normals: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    face_of = np.full(len(normals), -1)
    count = 0
    for start in range(len(normals)):
        if face_of[start] >= 0:
            continue
        face_of[start] = count
        waiting = [start]
        while waiting:
            here = waiting.pop()
            for there in neighbours[here]:
                # Compared with the first triangle of the face, not the last: a gently curved surface is no plane.
                if face_of[there] < 0 and np.abs(normals[there] - normals[start]).max() <= _SAME_PLANE:
                    face_of[there] = count
                    waiting.append(there)
        count += 1
    return face_of


def _corners(points: np.ndarray, triangles: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Three corners of a face that span its plane well: a long side and the corner farthest from it."""
    corners = np.unique(triangles)
    if len(corners) == 3:
        return triangles[0]
    at = points[corners] - points[corners].mean(axis=0)
    first = np.argmax(np.einsum("vi,vi->v", at, at))
    side = at - at[first]
    second = np.argmax(np.einsum("vi,vi->v", side, side))
    areas = np.cross(side[second], side) @ normal
    third = np.argmax(np.abs(areas))
    triple = corners[[first, second, third]]
    return triple if areas[third] > 0 else triple[[0, 2, 1]]
