"""States from a user's numbers: checked on the host, in one floating type, with a bodies axis."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import as_array, check_quantity, is_concrete, warn
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation

# Numbers typed or stored with seven digits are exact as far as their owner knows; beyond, a repair is announced.
_ROUNDED = 1e-6
_REPAIRABLE = 1e-3


def initial_state(
    count: int,
    position: Any,
    orientation: Any,
    velocity: Any,
    angular_velocity: Any,
    time: Any,
    rotation: type[Rotation],
    dtype: Any,
) -> State:
    """See `Scene.state`."""
    if not (isinstance(rotation, type) and issubclass(rotation, Rotation)):
        raise WrongStructure(
            f"state: rotation={rotation!r} is no representation; use Quaternion, RotationMatrix or EulerAngles"
        )
    given = jax.tree.leaves((position, orientation, velocity, angular_velocity))
    dtype = _dtype(given, dtype)
    vectors = [
        _vector(name, unit, value, count, dtype)
        for name, unit, value in (
            ("position", "m", position),
            ("velocity", "m/s", velocity),
            ("angular_velocity", "rad/s", angular_velocity),
        )
    ]
    attitude = _orientation(orientation, count, rotation, dtype)
    time = as_array("state.time", time)
    if np.ndim(time) != 0:
        raise WrongStructure(f"state.time: shape {np.shape(time)}; give one number [s] for all bodies")
    check_quantity("state.time", time, unit="s")
    return State(vectors[0], attitude, vectors[1], vectors[2], _cast("state.time", "s", time, dtype))


def _dtype(given: list[Any], dtype: Any) -> Any:
    default = jax.dtypes.canonicalize_dtype(float)
    if dtype is not None:
        try:
            wanted = np.dtype(dtype)
        except TypeError as error:
            raise WrongStructure(f"state: dtype {dtype!r} is no type; use float32 or float64") from error
        if wanted not in _TYPES:
            raise WrongStructure(
                f"state: dtype {wanted} is not a floating type of a run; use float32 or float64"
            )
        if jax.dtypes.canonicalize_dtype(wanted) != wanted:
            warn(f"state: dtype {wanted} was asked for while JAX runs without it; {default} is used. {_X64}")
        return jax.dtypes.canonicalize_dtype(wanted)
    kinds = []
    for leaf in given:
        if not hasattr(leaf, "dtype") or isinstance(leaf, np.generic):  # a single number, as in a list
            continue
        if leaf.dtype.kind in "iu":
            warn(f"state: an array of {leaf.dtype} was given; its numbers are used as floating numbers")
        elif leaf.dtype in _TYPES:
            kinds.append(leaf.dtype)
        elif jnp.issubdtype(leaf.dtype, jnp.floating):
            warn(f"state: an array of {leaf.dtype} was given; a run needs float32 at least, which is used")
            kinds.append(np.dtype(np.float32))
    if not kinds:
        return default
    wanted = np.result_type(*kinds)
    usable = jax.dtypes.canonicalize_dtype(wanted)
    if usable != wanted:
        warn(f"state: arrays of {wanted} were given while JAX runs without it; {usable} is used. {_X64}")
    return usable


_TYPES = (np.dtype(np.float32), np.dtype(np.float64))
_X64 = "Start Python with JAX_ENABLE_X64=1, or call jax.config.update('jax_enable_x64', True) first"


def _cast(where: str, unit: str, value: Any, dtype: Any) -> jax.Array:
    if not is_concrete(value):
        return jnp.asarray(value, dtype)
    host = np.asarray(value)
    with np.errstate(over="ignore"):
        cast = host.astype(dtype)
    lost = np.isfinite(host) & ~np.isfinite(cast)
    if lost.any():
        raise InvalidInput(
            f"{where} is {host[lost].ravel()[0].item()!r} {unit}, too large for {np.dtype(dtype)}; "
            "use float64 or larger units"
        )
    return jnp.asarray(cast)


def _vector(name: str, unit: str, value: Any, count: int, dtype: Any) -> jax.Array:
    where = f"state.{name}"
    if value is None:
        return jnp.asarray(np.zeros((count, 3), dtype))
    value = as_array(where, value)
    if value.shape not in ((3,), (count, 3)):
        raise WrongStructure(f"{where}: shape {value.shape}; give {(count, 3)}, or (3,) for all bodies")
    check_quantity(where, value, core=(3,), unit=unit)
    if value.ndim == 1:
        # On the host where that is possible: a device call here would compile a program for it.
        value = (np if isinstance(value, np.ndarray) else jnp).broadcast_to(value, (count, 3))
    return _cast(where, unit, value, dtype)


def _orientation(value: Any, count: int, rotation: type[Rotation], dtype: Any) -> Rotation:
    if value is None:
        attitude: Rotation = Quaternion(np.asarray([1.0, 0.0, 0.0, 0.0], dtype))
    elif isinstance(value, Rotation):
        attitude = value
    else:
        attitude = _from_numbers(value)
    attitude = jax.tree.map(lambda leaf: _cast("state.orientation", "", leaf, dtype), attitude)
    attitude = _checked(attitude)
    if not isinstance(attitude, rotation):
        attitude = _converted(attitude, rotation)
    core = {Quaternion: 1, RotationMatrix: 2}.get(rotation, 1)
    (leaf,) = jax.tree.leaves(attitude)
    if leaf.ndim not in (core, core + 1) or (leaf.ndim == core + 1 and leaf.shape[0] != count):
        raise WrongStructure(
            f"state.orientation: shape {leaf.shape} for {count} bodies; give one for each, or one for all"
        )
    if leaf.ndim == core + 1:
        return attitude
    xp = np if is_concrete(leaf) else jnp
    return jax.tree.map(lambda x: jnp.asarray(xp.broadcast_to(x, (count, *leaf.shape[-core:]))), attitude)


def _from_numbers(value: Any) -> Rotation:
    array = as_array("state.orientation", value)
    if array.shape[-2:] == (3, 3):
        return RotationMatrix(array)
    if array.shape[-1:] == (4,):
        return Quaternion(array)
    raise WrongStructure(
        f"state.orientation: shape {array.shape}; give a Rotation, wxyz (..., 4) or matrices (..., 3, 3)"
    )


def _checked(attitude: Rotation) -> Rotation:
    """Refuse what is no rotation; normalise, with a warning, what nearly is one."""
    (leaf,) = jax.tree.leaves(attitude)
    if not is_concrete(leaf):
        return attitude
    numbers = np.asarray(leaf, float)
    if not np.isfinite(numbers).all():
        raise InvalidInput(
            f"state.orientation has a number {numbers[~np.isfinite(numbers)][0].item()!r}; all must be finite"
        )
    if isinstance(attitude, Quaternion):
        defect = np.linalg.norm(numbers, axis=-1) - 1.0
        kind = "the norm of the quaternion"
    elif isinstance(attitude, RotationMatrix):
        gram = np.swapaxes(numbers, -1, -2) @ numbers - np.eye(3)
        defect = np.abs(gram).max(axis=(-1, -2))
        kind = "RᵀR"
        mirrored = np.linalg.det(numbers) < 0
        if mirrored.any():
            raise InvalidInput(
                f"state.orientation: the determinant of the matrix{_of_body(mirrored)} is negative: a reflection, "
                "not a rotation; swap the sign of one axis"
            )
    else:
        return attitude
    worst = np.unravel_index(np.abs(defect).argmax(), defect.shape) if defect.ndim else ()
    off = float(np.abs(defect[worst] if defect.ndim else defect))
    if off <= _ROUNDED:
        return attitude
    message = (
        f"state.orientation{f' of body {worst[0]}' if worst else ''}: {kind} differs from 1 by {off:.3g}"
    )
    if off > _REPAIRABLE:
        raise InvalidInput(
            f"{message}: {numbers[worst].tolist()} is no rotation; normalise it if that is what is meant"
        )
    warn(f"{message}; it was normalised")
    return jax.jit(lambda rotation: rotation.normalise())(attitude)


def _of_body(bad: np.ndarray) -> str:
    return f" of body {np.argwhere(bad)[0][0]}" if bad.ndim else ""


def _converted(attitude: Rotation, rotation: type[Rotation]) -> Rotation:
    return jax.jit(rotation.from_rotation)(attitude)


def check_held(given: State, placed: State) -> None:
    """Refuse positions that contradict a fixed point."""
    if not (is_concrete(given.position) and is_concrete(placed.position)):
        return
    here, there = np.asarray(given.position, float), np.asarray(placed.position, float)
    distance = np.linalg.norm(here - there, axis=-1)
    allowed = 1e-4 * (1.0 + np.abs(there).max())
    if (distance > allowed).any():
        body = int(distance.argmax())
        raise InvalidInput(
            f"state.position of body {body} is {here[body].tolist()} m, but its constraint holds it at "
            f"{there[body].tolist()} m; leave the position out, or move the constraint"
        )
