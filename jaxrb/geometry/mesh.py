"""Solids bounded by triangles."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxrb.body import mass_properties as closed_form
from jaxrb.body.mass_properties import MassProperties
from jaxrb.checks import as_array, is_concrete
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.geometry import mesh_repair
from jaxrb.geometry.connectivity import Connectivity
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector

_FARTHEST = 1e30  # [m]; the fifth power of a length, which inertia is, must be a number


class TriangleMesh(Shape):
    """A surface of triangles in a frame of its own, wound anticlockwise seen from outside.

    `vertices` (n, 3) [m] are numbers like any other: mass, bounds and distances have derivatives in them. `triangles`
    (m, 3), vertex numbers from 0, are structure; another set of triangles is another program.

    What can be mended is mended with a `JaxrbWarning`: triangles without area or twice there are dropped, vertices
    of no triangle too; neighbours wound in opposite senses and pieces turned inside out are turned over. A surface
    with holes has a hull, bounds and contacts, but no mass.

    Raises:
        InvalidInput: a vertex that is not finite, a triangle that names a vertex which is not there, vertices that
            all lie in one point, line or plane. WrongStructure: other shapes than (n, 3) and (m, 3).
    """

    vertices: Array
    triangles: Any = eqx.field(static=True)  # whole numbers (m, 3); afterwards a Connectivity
    name: str = eqx.field(static=True, default="mesh")

    def __post_init__(self):
        where = f"TriangleMesh {self.name!r}"
        vertices = as_array(f"{where}: vertices", self.vertices)
        if np.ndim(vertices) != 2 or np.shape(vertices)[1] != 3:
            raise WrongStructure(f"{where}: vertices have the shape {np.shape(vertices)}; give (n, 3)")
        triangles = Connectivity.checked(where, self.triangles, len(vertices))
        if is_concrete(vertices):
            _check_numbers(where, np.asarray(vertices, float))
        triangles = mesh_repair.without_repeats(where, triangles)
        if is_concrete(vertices):
            triangles = mesh_repair.without_slivers(where, triangles, np.asarray(vertices, float))
        used, renumbered = np.unique(triangles.triangles, return_inverse=True)
        if len(used) < len(vertices):
            mesh_repair.warn_of_unused(where, len(vertices), used)
            vertices, triangles = vertices[used], Connectivity(renumbered.reshape(-1, 3))
        triangles = mesh_repair.wound_alike(where, triangles)
        if is_concrete(vertices):
            host = np.asarray(vertices, float)
            mesh_repair.check_extent(where, host)
            triangles = mesh_repair.turned_outward(where, triangles, host)
        self.vertices, self.triangles = vertices, triangles

    @classmethod
    def from_corners(cls, corners: Any, name: str = "mesh") -> "TriangleMesh":
        """From the corners (m, 3, 3) [m] of each triangle; corners that are equal to the last digit are one vertex."""
        corners = np.asarray(as_array(f"TriangleMesh {name!r}: corners", corners))
        if corners.ndim != 3 or corners.shape[1:] != (3, 3):
            raise WrongStructure(
                f"TriangleMesh {name!r}: corners have the shape {corners.shape}; give (m, 3, 3)"
            )
        vertices, triangles = merged(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
        return cls(vertices, triangles, name)

    @property
    def is_closed(self) -> bool:
        """Whether the surface has an inside: no holes, two triangles at each edge, wound alike."""
        return self.triangles.is_closed

    def corners(self) -> Array:
        """The corners (m, 3, 3) [m] of each triangle."""
        return self.vertices[..., self.triangles.triangles, :]

    def convex_hull(self) -> ConvexHull:
        """The smallest convex solid around it (needs the extra [mesh])."""
        return ConvexHull(self.vertices)

    def support(self, direction: Vector) -> Vector:
        raise WrongStructure(
            f"TriangleMesh {self.name!r} need not be convex, so it has no support map; use mesh.convex_hull(), or "
            "jaxrb.geometry.decomposition for its convex parts"
        )

    def mass_properties(self, density: Scalar) -> MassProperties:
        """Mass, centre of mass and inertia when filled with `density` [kg/m³]: exact, by signed tetrahedra.

        Numbers that are there are summed in float64 whatever the setting of JAX.

        Raises:
            InvalidInput: a surface with holes, with edges of three or more triangles, without an inside.
        """
        self._check_inside()
        return closed_form.of_closed_surface(density, self.vertices, self.triangles.triangles)

    def _check_inside(self) -> None:
        where = f"TriangleMesh {self.name!r}"
        faces = self.triangles
        for edges, problem, mend in (
            (faces.open_edges, "belong to one triangle only (the surface is open)", "close the holes"),
            (faces.crowded_edges, "belong to three or more triangles (no manifold)", "delete inner walls"),
            (
                faces.disputed_edges,
                "cannot be wound alike on both sides (a one-sided surface)",
                "model the solid's two sides",
            ),
        ):
            if len(edges):
                raise InvalidInput(
                    f"{where} has no mass: {len(edges)} edges {problem}, first between vertices {edges[0].tolist()}; "
                    f"{mend}, or fill its convex hull: Body.from_mesh(..., convex_hull=True)"
                )
        if not is_concrete(self.vertices):
            return
        corners = np.asarray(self.vertices, float)[faces.triangles]
        volume = float(closed_form.tetrahedra(np, corners - corners.mean(axis=(0, 1)))[0].sum())
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = 0.5 * float(np.linalg.norm(sides, axis=-1).sum())
        if volume <= 1e-10 * area**1.5:
            raise InvalidInput(
                f"{where} has no mass: its triangles of {area:.3g} m² enclose {volume:.3g} m³; "
                "give a plate its thickness, for instance as a Box"
            )


def merged(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices equal to the last digit made one: files repeat them for each triangle or for the sake of colours."""
    rows = np.ascontiguousarray(vertices + 0.0)  # −0 and 0 are the same place
    keys = rows.view(np.dtype((np.void, rows.dtype.itemsize * 3))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    # In the order in which the file names them, which is what messages speak of.
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[inverse.ravel()][triangles]


def _check_numbers(where: str, vertices: np.ndarray) -> None:
    for bad, mend in (
        (~np.isfinite(vertices), "every vertex must be finite"),
        (
            np.abs(vertices) > _FARTHEST,
            f"beyond {_FARTHEST:g} m volumes leave the floating range; choose larger units",
        ),
    ):
        if bad.any():
            row, axis = np.argwhere(bad)[0]
            raise InvalidInput(f"{where}: vertex {row} has {'xyz'[axis]} = {vertices[row, axis]} m; {mend}")
