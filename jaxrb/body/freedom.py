"""How a body may move: what it cannot do is not integrated, and where no body of a scene can, not compiled.

Components of the velocity are held along the axes of the world, those of the angular velocity about the axes of the
body; bearings and guides do no work, so the energy is kept. A body that turns about one axis has one equation,
I_aa ω̇ = τ_a, whatever its other moments and products are: the bearing takes the rest.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.body.inertia import FullInertia, Inertia, PrincipalInertia, SphericalInertia
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Vector

AXES = "xyz"
_ANGULAR = ("xyz", "x", "y", "z", "")


@dataclasses.dataclass(frozen=True)
class Freedom:
    """The components that can differ from zero: of the velocity, in W, and of the angular velocity, in B.

    `linear`: letters of "xyz", in this order. `angular`: "xyz", one letter, or "": rotations about two axes leave
    neither where it was, so two letters would be no freedom of a bearing.
    """

    linear: str = "xyz"
    angular: str = "xyz"

    def __post_init__(self):
        if not isinstance(self.linear, str) or self.linear != "".join(a for a in AXES if a in self.linear):
            raise WrongStructure(
                f"Freedom.linear: {self.linear!r}; give the world axes along which the body moves: letters of 'xyz', "
                "in this order, each once"
            )
        if self.angular not in _ANGULAR:
            raise WrongStructure(
                f"Freedom.angular: {self.angular!r}; give 'xyz', the one body axis about which it turns, or ''"
            )


FREE = Freedom()
FIXED = Freedom("", "")


def restricted(freedoms: Sequence[Freedom]) -> tuple[Freedom, ...] | None:
    """The freedoms of all bodies, None where every body is free."""
    freedoms = tuple(freedoms)
    return None if all(freedom == FREE for freedom in freedoms) else freedoms


def linear_mask(freedoms: Sequence[Freedom]) -> np.ndarray:
    """Which components (n, 3) of the velocities are free."""
    return np.array([[axis in freedom.linear for axis in AXES] for freedom in freedoms])


def angular_mask(freedoms: Sequence[Freedom]) -> np.ndarray:
    """Which components (n, 3) of the angular velocities are free."""
    return np.array([[axis in freedom.angular for axis in AXES] for freedom in freedoms])


def kept(vector: Vector | None, mask: np.ndarray) -> Vector | None:
    """The free components of forces or torques (n, 3); None where there are none."""
    if vector is None or not mask.any():
        return None
    return vector if mask.all() else jnp.where(mask, vector, 0.0)


def rotating_inertia(inertia: Inertia, freedoms: tuple[Freedom, ...] | None) -> Inertia:
    """The inertia (n bodies) with which bodies of these freedoms turn, once their torques are `kept`.

    About one axis a body turns as a sphere of moment I_aa: torque and rate have that component only, and a sphere has
    no gyroscopic term. A body that does not turn never feels its moment, which is one here: zero has no inverse.
    """
    if freedoms is None or all(freedom.angular == AXES for freedom in freedoms):
        return inertia
    six = jnp.asarray(inertia.six())
    axis = np.array([AXES.index(f.angular) if len(f.angular) == 1 else 0 for f in freedoms])
    turns = np.array([f.angular != "" for f in freedoms])
    moment = jnp.where(turns, six[np.arange(len(axis)), axis], 1.0)
    free = np.array([f.angular == AXES for f in freedoms])
    if not free.any():
        return SphericalInertia(moment)
    if isinstance(inertia, SphericalInertia):
        return SphericalInertia(jnp.where(free, inertia.moment, moment))
    if isinstance(inertia, PrincipalInertia):
        return PrincipalInertia(jnp.where(free[:, None], inertia.moments, moment[:, None]))
    alone = moment[:, None] * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], six.dtype)
    return FullInertia(jnp.where(free[:, None], six, alone))


def turns_freely(freedoms: tuple[Freedom, ...] | None) -> bool:
    """Whether any body turns about more than one axis, or two bodies about different ones."""
    axes = {AXES} if freedoms is None else {freedom.angular for freedom in freedoms} - {""}
    return AXES in axes or len(axes) > 1


def axis_of(freedoms: tuple[Freedom, ...]) -> int | None:
    """The number of the one axis about which those bodies turn that do; None where none does."""
    letters = {freedom.angular for freedom in freedoms} - {""}
    return AXES.index(letters.pop()) if letters else None


def moves(freedoms: tuple[Freedom, ...] | None) -> bool:
    """Whether any centre of mass moves."""
    return freedoms is None or any(freedom.linear for freedom in freedoms)


def name_of(freedom: Freedom) -> str:
    """A freedom in words, for messages."""
    if freedom == FIXED:
        return "is fixed"
    moving = f"moves along {freedom.linear}" if freedom.linear else "does not move"
    about: Any = {"": "does not turn", AXES: "turns freely"}
    return f"{moving} and {about.get(freedom.angular, f'turns about its {freedom.angular} axis')}"
