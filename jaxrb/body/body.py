"""A rigid body: mass, inertia about the centre of mass and, where geometry matters, a shape."""

import dataclasses
import importlib
import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.freedom import FIXED, FREE, Freedom
from jaxrb.body.inertia import Inertia, SphericalInertia
from jaxrb.body.mass_properties import MassProperties, of_particles
from jaxrb.body.validity import check_range, valid_inertia
from jaxrb.checks import Checked, as_array, is_concrete, quantities, quantity, warn
from jaxrb.errors import InvalidInput, LimitExceeded, WrongStructure
from jaxrb.math.arrays import Array, Scalar, Vector

_MAX_BYTES = 16 * 2**30  # of the numbers of replicated bodies


class Body(Checked):
    """A rigid body. Its frame B has the origin at the centre of mass.

    `inertia` [kg m²] is about the centre of mass in the axes of B: a number (spherical), three principal moments, a
    3×3 matrix, or an `Inertia`. `shape` is described in a frame of its own with axes parallel to B, in which the
    centre of mass lies at `center_of_mass` (3,) [m]. `freedom` says how it may move; see `Body.point`, `fixed` and
    `restricted`.

    Raises:
        InvalidInput: a mass that is not positive and finite, an inertia that no distribution of mass has.
    """

    mass: Scalar = quantity(
        (), positive=True, unit="kg", mend="a body that never moves has a mass too: Body(…).fixed()"
    )
    inertia: Any  # pyright: ignore[reportGeneralTypeIssues] - whatever Inertia.of takes; afterwards an Inertia
    shape: Any = None
    center_of_mass: Vector = quantity((3,), unit="m", default=(0.0, 0.0, 0.0))
    name: str = eqx.field(static=True, default="body")
    freedom: Freedom = eqx.field(static=True, default=FREE, kw_only=True)

    def __post_init__(self):
        super().__post_init__()
        if is_concrete(self.mass):
            check_range("Body.mass", np.asarray(self.mass), "kg")
        if self.shape is not None:
            _check_solid("Body.shape", self.shape)
            _doubt_outside(self.shape, self.center_of_mass)
        if self.freedom.angular or not isinstance(self.inertia, Inertia):  # else no equation contains it
            self.inertia = valid_inertia(self.inertia, where="Body.inertia")
        _check_axes(self)
        _share(self)

    @classmethod
    def point(cls, mass: Scalar, shape: Any = None, name: str = "point") -> "Body":
        """A point mass [kg]: it moves, and has no rotation. A scene of such bodies compiles none.

        Raises:
            InvalidInput: a mass that is not positive and finite.
        """
        mass = as_array("Body.mass", mass)
        nothing = SphericalInertia((np if is_concrete(mass) else jnp).zeros_like(mass))
        return cls(mass, nothing, shape, name=name, freedom=Freedom(angular=""))

    def fixed(self) -> "Body":
        """The same body, held where it is: it has a mass (that attracts), shape and place, and no equation."""
        return dataclasses.replace(self, freedom=FIXED)

    def restricted(self, linear: str = "xyz", angular: str = "xyz") -> "Body":
        """The same body, able to move along some axes of the world, and to turn about one axis of its own, or none.

        `linear` holds letters of "xyz"; `angular` is "xyz", one letter, or "". In the plane z = const:
        restricted("xy", "z"); on an axle through the centre of mass: restricted("", "z"); a slider: ("x", "").

        Raises:
            WrongStructure: other letters; a point mass that is to turn.
        """
        freedom = Freedom(linear, angular)
        moment = getattr(self.inertia, "moment", None)
        if angular and is_concrete(moment) and np.any(np.asarray(moment) == 0):
            raise WrongStructure(
                f"Body.restricted: {self.name!r} is a point mass, and has no inertia to turn with; give a Body with one"
            )
        return dataclasses.replace(self, freedom=freedom)

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
        _check_solid("Body.from_shape", shape)
        density = np.asarray(density) if isinstance(density, (list, tuple)) else density
        if is_concrete(density) and np.asarray(density).dtype.kind not in "fiuV":
            raise WrongStructure(f"Body.from_shape: density: {density!r} is not a number [kg/m³]")
        if is_concrete(density) and not (np.isfinite(density).all() and np.all(np.asarray(density) > 0)):
            raise InvalidInput(
                f"Body.from_shape: density is {density!r} kg/m³, but must be positive and finite"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # a mass that is no number is refused as such
            properties = shape.mass_properties(density)
        return cls.from_mass_properties(properties, shape, name)

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
        if not hasattr(mesh, "convex_hull"):
            raise WrongStructure(
                f"Body.from_mesh: {mesh!r} is no mesh; give a TriangleMesh, or the path of a file"
            )
        shape = mesh.convex_hull() if convex_hull else mesh
        return cls.from_shape(shape, density, mesh.name if name is None else name)

    @classmethod
    def from_particles(cls, masses: Array, positions: Array, name: str = "body") -> "Body":
        """The body that point masses (k,) [kg] at (k, 3) [m] form; at least three that do not lie on a line."""
        return cls.from_mass_properties(of_particles(masses, positions), name=name)


def _check_axes(body: Body) -> None:
    """Refuse mass, inertia and centre of mass of different numbers of bodies."""
    moments = np.shape(jax.tree.leaves(body.inertia)[0])
    axes = {
        "mass": np.shape(body.mass),
        "inertia": moments[:-1] if body.inertia.rank else moments,
    }
    if np.ndim(body.center_of_mass) > 1:  # one place serves all bodies
        axes["center_of_mass"] = np.shape(body.center_of_mass)[:-1]
    if len(set(axes.values())) > 1:
        said = ", ".join(f"{name} {axis}" for name, axis in axes.items())
        raise WrongStructure(
            f"Body: the bodies axes differ: {said}; give one body's numbers and use rb.replicate, or the axis to all"
        )


def _share(body: Body) -> None:
    """Give each body of a bodies axis the one centre of mass, and the one simple shape, that serves all of them."""
    axes = np.shape(body.mass)
    if not axes:
        return

    def spread(value: Any, core: tuple[int, ...]) -> Any:
        xp = np if isinstance(value, np.ndarray) else jnp
        return xp.broadcast_to(value, (*axes, *core)) if np.ndim(value) == len(core) else value

    object.__setattr__(body, "center_of_mass", spread(body.center_of_mass, (3,)))
    shape: Any = body.shape
    if not isinstance(shape, Checked) or hasattr(shape, "parts"):
        return
    cores = {field.name: field.metadata["quantity"]["core"] for field in quantities(type(shape))}
    values = {name: value for name in cores if (value := getattr(shape, name)) is not None}
    shared = {name: spread(value, cores[name]) for name, value in values.items()}
    if any(shared[name] is not values[name] for name in shared):
        object.__setattr__(body, "shape", dataclasses.replace(shape, **shared))


def _check_solid(where: str, shape: Any) -> None:
    """Refuse what is no solid; told by what a body needs of it, since shapes are on a floor above this one."""
    if isinstance(shape, type):
        raise WrongStructure(f"{where}: {shape.__name__} is a class; write {shape.__name__}(…)")
    if not hasattr(shape, "mass_properties"):
        raise WrongStructure(f"{where}: {shape!r} is no shape; give one, such as rb.Sphere(0.1)")


def _doubt_outside(shape: Any, center_of_mass: Any) -> None:
    """Warn of a centre of mass that lies farther out than any point of the shape can."""
    lengths = [
        value for field in quantities(type(shape))
        if field.metadata["quantity"]["unit"] == "m" and (value := getattr(shape, field.name)) is not None
    ]  # fmt: skip
    if not lengths or not all(is_concrete(value) for value in (*lengths, center_of_mass)):
        return
    # Of points the farthest; of radii and heights their sum, which no shape exceeds.
    reach = sum(_farthest(value) for value in lengths)
    away = _farthest(center_of_mass)
    if away > reach and not hasattr(shape, "normal"):
        warn(
            f"Body.center_of_mass lies {away:.3g} m from the origin of the {type(shape).__name__}, which reaches "
            f"{reach:.3g} m at most: outside the body; is it given in the shape's frame, in metres?"
        )


def _farthest(points: Any) -> float:
    with np.errstate(over="ignore"):  # what is farther than numbers reach is infinitely far
        return float(np.linalg.norm(np.atleast_1d(np.asarray(points, float)), axis=-1).max())


def replicate(body: Body, count: int) -> Body:
    """`count` equal bodies: one Body whose numbers carry a leading bodies axis."""
    if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
        raise InvalidInput(f"replicate: count is {count!r}, but must be a whole number of at least 1")
    needed = count * sum(getattr(leaf, "nbytes", 8) for leaf in jax.tree.leaves(body))
    if needed > _MAX_BYTES:
        raise LimitExceeded(
            f"replicate: {count} bodies need {needed / 2**30:.0f} GiB, more than {_MAX_BYTES / 2**30:.0f} GiB; "
            "take fewer"
        )

    def repeat(leaf):
        xp = np if isinstance(leaf, np.ndarray) else jnp
        return xp.repeat(xp.asarray(leaf)[None], count, axis=0)

    return jax.tree.map(repeat, body)


def count_of(body: Body) -> int | None:
    """Number of bodies on the bodies axis; None where there is no such axis."""
    shape = np.shape(body.mass)
    return shape[0] if shape else None


def freedoms_of(bodies: tuple[Body, ...]) -> tuple[Freedom, ...]:
    """The freedom of each body, those of a bodies axis one by one."""
    return tuple(body.freedom for body in bodies for _ in range(count_of(body) or 1))


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
