"""Checks of run settings that all runs share."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import check_count as check_count
from jaxrb.checks import check_tolerance as check_tolerance
from jaxrb.checks import is_concrete, warn
from jaxrb.errors import InvalidInput, LimitExceeded, WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.math.euler_angles import EulerAngles
from jaxrb.scene.scene import Scene

ON_ERROR = ("raise", "flag")
DEFAULT_MAX_BYTES = 8 * 2**30


def check_numbers(name: str, value: Any) -> None:
    """Refuse what does not consist of real numbers."""
    kind = value.dtype if hasattr(value, "dtype") else np.asarray(value).dtype
    if isinstance(value, bool) or kind.kind not in "fiuV":  # V: NumPy's letter of bfloat16
        raise WrongStructure(f"{name}: {value!r} is not a number")


def check_number(name: str, value: Any) -> None:
    """Refuse what is not one real number."""
    if np.ndim(value) != 0:
        raise WrongStructure(f"{name}: shape {np.shape(value)}; give one number")
    check_numbers(name, value)


def check_positive(name: str, value: Any, unit: str = "s") -> None:
    """Refuse what is not a positive finite number."""
    check_number(name, value)
    if is_concrete(value) and not (np.isfinite(value) and value > 0):
        raise InvalidInput(f"{name} is {value!r} {unit}, but must be positive and finite")


def check_struck(where: str, state: State, method: Method) -> None:
    """Refuse what impacts between steps cannot change: Euler angles, and remainders carried from step to step."""
    if isinstance(state.orientation, EulerAngles):
        raise WrongStructure(
            f"{where}: Euler angles cannot be turned by impacts; make the state with rotation=Quaternion"
        )
    if method.first_remainder(state) is not None:
        raise WrongStructure(
            f"{where}: {type(method).__name__}(compensated=True) carries a remainder that impacts would make wrong; "
            "use compensated=False"
        )


def check_steps(name: str, steps: int) -> None:
    """Refuse more steps than a run's counter holds."""
    if steps >= 2**31:
        raise InvalidInput(f"steps is {steps}, but one {name} counts to 2^31 − 1; continue from path.final")


def check_choice(name: str, value: Any, choices: tuple[str, ...]) -> None:
    """Refuse a word that is not among the choices."""
    if value not in choices:
        raise WrongStructure(f"{name}={value!r}: choose {' or '.join(repr(choice) for choice in choices)}")


def check_representation(method: Method, state: State) -> None:
    """Refuse Euler angles for methods that multiply rotations."""
    if method.needs_group and isinstance(state.orientation, EulerAngles):
        raise WrongStructure(
            f"{type(method).__name__} works on quaternions and matrices, not on Euler angles; make the state with "
            "rotation=Quaternion or RotationMatrix"
        )


def check_adjoint(adjoint: str, method: Method, torque: Any) -> None:
    """Refuse to run a method backwards that cannot be."""
    check_choice("adjoint", adjoint, ("checkpoint", "reversible"))
    if adjoint == "reversible" and not method.symmetric:
        raise WrongStructure(
            "adjoint='reversible' needs a method whose steps can be undone, such as ImplicitMidpoint or "
            f"ThreeAxisSplitting4; {type(method).__name__} is not symmetric in time: use adjoint='checkpoint'"
        )
    if adjoint == "reversible" and torque is not None and torque.ndim == 3:
        raise WrongStructure("adjoint='reversible' takes a constant torque; use 'checkpoint' for one a step")


def check_saved_bytes(state: State, saves: int, max_bytes: int) -> None:
    """Refuse a run whose saved states would not fit."""
    a_state = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(state))
    wanted = a_state * saves
    if wanted > max_bytes:
        raise LimitExceeded(
            f"rollout: {saves} saved states of {a_state} bytes need {wanted / 2**30:.1f} GiB, more than "
            f"max_bytes = {max_bytes / 2**30:.1f} GiB; raise save_every or max_bytes"
        )


def applied_torque(torque: Any, state: State, steps: int | None = None) -> jax.Array | None:
    """The applied torque as (n, 3), or (steps, n, 3) where `steps` is given and the torque varies."""
    if torque is None:
        return None
    count = state.position.shape[0]
    torque = jnp.asarray(torque, state.dtype)
    if torque.shape in ((3,), (count, 3)):
        _finite_torque(torque)
        return jnp.broadcast_to(torque, (count, 3))
    if steps is not None and torque.shape == (steps, count, 3):
        _finite_torque(torque)
        return torque
    more = "" if steps is None else f", or {(steps, count, 3)} for one a step"
    raise WrongStructure(f"torque: shape {torque.shape}; give {(count, 3)} [N m] in the body frame{more}")


def _finite_torque(torque: jax.Array) -> None:
    if is_concrete(torque) and not np.isfinite(np.asarray(torque)).all():
        raise InvalidInput("torque: a number is not finite; all must be finite [N m]")


def _check_step_in_type(state: State, dt: Any) -> None:
    """Refuse a step that the state's type makes 0 or infinite; warn of one after which the time is the same."""
    dtype = np.dtype(state.dtype)
    with np.errstate(over="ignore", under="ignore"):
        step, time = np.asarray(dt).astype(dtype), np.asarray(state.time)
        if step == 0 or not np.isfinite(step):
            raise InvalidInput(f"dt is {dt!r} s, too {'large' if step else 'small'} for a state of {dtype}")
        if time + step == time:
            warn(
                f"dt = {float(dt):.3g} s is lost beside the time {float(time):.6g} s in {dtype}: effects that look at "
                "the time will see it stand still; count from a later start"
            )


def warn_of_coarse_steps(scene: Scene, state: State, dt: Any, method: Method) -> None:
    """Warn where a step turns a body by more than a quarter turn, or an effect's rate is beyond the method's limit.

    Raises:
        InvalidInput: a step that the state's floating type cannot hold.
    """
    values = (state.position, state.velocity, state.angular_velocity, dt, scene)
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves(values)):
        return
    _check_step_in_type(state, dt)
    spin = np.linalg.norm(np.asarray(state.angular_velocity, float), axis=-1)
    angle = float(dt) * float(spin.max(initial=0.0))
    if angle > np.pi / 2:
        warn(
            f"dt = {float(dt):.3g} s turns body {int(spin.argmax())} by {angle:.2f} rad a step, more than a quarter "
            f"turn; a dt of {0.1 / float(spin.max()):.2g} s would resolve it"
        )
    bodies = None
    for effect in scene.effects:
        bodies = scene.stacked() if bodies is None else bodies
        rate = float(np.max(effect.rate(bodies, state)))
        if rate * float(dt) > method.stability_limit:
            warn(
                f"dt = {float(dt):.3g} s is beyond the stability of {type(method).__name__} for "
                f"{type(effect).__name__} (rate {rate:.3g} /s); take dt below {method.stability_limit / rate:.2g} s"
            )


def check_jointed(scene: Scene, where: str, mend: str) -> None:
    """Refuse a scene with joints where their forces are not known."""
    if scene.jointed:
        raise WrongStructure(f"{where}: the scene has joints, which {where} does not take; {mend}")
