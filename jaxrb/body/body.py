"""A rigid body: mass, inertia about the centre of mass and, where geometry matters, a shape."""

import importlib
import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.mass_properties import MassProperties, of_particles
from jaxrb.body.validity import check_range, valid_inertia
from jaxrb.checks import Checked, is_concrete, quantity
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.math.arrays import Array, Scalar, Vector


class Body(Checked):
    """A rigid body. Its frame B has the origin at the centre of mass.

    `inertia` [kg m²] is about the centre of mass in the axes of B: a number (spherical), three principal moments, a
    3×3 matrix, or an `Inertia`. `shape` is described in a frame of its own with axes parallel to B, in which the
    centre of mass lies at `center_of_mass` (3,) [m].

    Raises:
        InvalidInput: a mass that is not positive and finite, an inertia that no distribution of mass has.
    """

    mass: Scalar = quantity(
        (), positive=True, unit="kg", mend="fix what never moves to the world instead of making it a body"
    )
    inertia: Any  # pyright: ignore[reportGeneralTypeIssues] - whatever Inertia.of takes; afterwards an Inertia
    shape: Any = None
    center_of_mass: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))
    name: str = eqx.field(static=True, default="body")

    def __post_init__(self):
        super().__post_init__()
        if is_concrete(self.mass):
            check_range("Body.mass", np.asarray(self.mass), "kg")
        self.inertia = valid_inertia(self.inertia, where="Body.inertia")

    @classmethod
    def from_mass_properties(
        cls, properties: MassProperties, shape: Any = None, name: str = "body"
    ) -> "Body":
        """The body with this mass and inertia; its frame sits at the centre of mass."""
        host = jax.tree.map(lambda x: np.asarray(x) if is_concrete(x) else x, properties)
        return cls(host.mass, host.inertia, shape, host.center_of_mass, name)

    @classmethod
    def from_shape(cls, shape: Any, density: Scalar, name: str = "body") -> "Body":
        """The body that fills `shape` with `density` [kg/m³].

        Raises:
            InvalidInput: a density that is not positive and finite.
        """
        if is_concrete(density) and not (np.isfinite(density) and density > 0):
            raise InvalidInput(
                f"Body.from_shape: density is {density!r} kg/m³, but must be positive and finite"
            )
        return cls.from_mass_properties(shape.mass_properties(density), shape, name)

    @classmethod
    def from_mesh(
        cls,
        mesh: Any,
        density: Scalar,
        name: str | None = None,
        *,
        convex_hull: bool = False,
        **reading: Any,
    ) -> "Body":
        """The body that fills a closed triangle mesh with `density` [kg/m³].

        Args:
            mesh: a `TriangleMesh`, or the path of an STL, OBJ, PLY or GLB file.
            name: by default that of the mesh.
            convex_hull: fill the mesh's convex hull instead, which also an open surface has.
            reading: for a file, options of `jaxrb.io.read_mesh`, such as unit="mm".

        Raises:
            InvalidInput: a file or a surface that cannot be right, a surface without an inside. LimitExceeded.
        """
        if isinstance(mesh, (str, os.PathLike)):
            # Named, not imported: files are read on a floor far above this one, and only who has a file needs it.
            mesh = importlib.import_module("jaxrb.io.mesh").read_mesh(mesh, **reading)
        elif reading:
            raise WrongStructure(
                f"Body.from_mesh: {', '.join(reading)} is for reading a file; a mesh was given"
            )
        shape = mesh.convex_hull() if convex_hull else mesh
        return cls.from_shape(shape, density, mesh.name if name is None else name)

    @classmethod
    def from_particles(cls, masses: Array, positions: Array, name: str = "body") -> "Body":
        """The body that point masses (k,) [kg] at (k, 3) [m] form; at least three that do not lie on a line."""
        return cls.from_mass_properties(of_particles(masses, positions), name=name)


def replicate(body: Body, count: int) -> Body:
    """`count` equal bodies: one Body whose numbers carry a leading bodies axis."""
    if not isinstance(count, (int, np.integer)) or count < 1:
        raise InvalidInput(f"replicate: count is {count!r}, but must be a whole number of at least 1")

    def repeat(leaf):
        xp = np if isinstance(leaf, np.ndarray) else jnp
        return xp.repeat(xp.asarray(leaf)[None], count, axis=0)

    return jax.tree.map(repeat, body)


def count_of(body: Body) -> int | None:
    """Number of bodies on the bodies axis; None where there is no such axis."""
    shape = np.shape(body.mass)
    return shape[0] if shape else None


def stacked(bodies: tuple[Body, ...]) -> MassProperties:
    """What the dynamics needs of many bodies, with a bodies axis, in the most general of their kinds of inertia.

    Each body may carry a bodies axis of its own (`replicate`). A kind is generalised because another body's type
    demands it, never guessed from values.
    """
    rank = max(body.inertia.rank for body in bodies)
    parts = []
    for body in bodies:
        part = MassProperties(body.mass, body.center_of_mass, body.inertia.generalised(rank))
        parts.append(part if count_of(body) is not None else jax.tree.map(lambda x: x[None], part))
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
