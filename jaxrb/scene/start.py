"""What can be seen of a scene and its first state, before anything runs, that would go wrong in silence. Host side."""

from typing import Any

import jax
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import is_concrete, warn
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import InvalidInput

_RATIO = 1e4  # of masses: beyond it the light body's overlap grows with the heavy one's weight
_DEEP = 0.1  # of the smallest radius of gyration: an overlap that no step of a sound run leaves
_COARSE = 1e-3  # of a body's radius of gyration: places of the positions that contact would notice


def check_start(scene: Any, state: State) -> None:
    """Refuse numbers of the scene that the state's type cannot hold; warn of what contact will not bear well.

    Raises:
        InvalidInput: naming the number of the scene, and the mend.
    """
    _refuse_lost(scene, np.dtype(state.dtype))
    rules = [effect for effect in scene.effects if isinstance(effect, RigidContact)]
    if not rules or not is_concrete(state.position):
        return
    leaves = jax.tree.leaves([(body.mass, body.inertia) for body in scene.bodies])
    if not all(is_concrete(leaf) for leaf in leaves):
        return
    masses = np.concatenate([np.ravel(body.mass) for body in scene.bodies]).astype(float)
    sizes = radii_of_gyration(scene)
    moving = np.repeat(
        *np.transpose([(bool(body.freedom.linear), np.size(body.mass)) for body in scene.bodies])
    )
    meeting = {i for rule in rules if rule.against is None for i in rule.chosen(scene.count)}
    _warn_of_ratio(masses, np.asarray([i for i in sorted(meeting) if moving[i]], int))
    touching = sorted({i for rule in rules for i in rule.chosen(scene.count)})
    _warn_of_distance(np.asarray(state.position), sizes, np.asarray(touching, int))


def warn_of_overlap(scene: Any, report: Any) -> None:
    """Warn of a run whose bodies overlapped deeply: from the start, or since a step carried one into another."""
    if report is None or not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, report))):
        return
    deepest = np.asarray(report.penetration, float)
    if deepest.ndim != 1:
        return  # a batch of worlds
    chosen = {i for e in scene.effects if isinstance(e, RigidContact) for i in e.chosen(scene.count)}
    sizes = radii_of_gyration(scene)[sorted(chosen)]
    smallest = sizes[sizes > 0].min(initial=np.inf)
    if deepest[-1] <= _DEEP * smallest:
        return
    row = int((deepest > _DEEP * smallest).argmax())
    warn(
        f"RigidContact: bodies overlapped by up to {deepest[-1]:.3g} m, beside a radius of gyration of "
        f"{smallest:.3g} m, first seen in saved state {row}; set them apart where the run begins, or take a smaller "
        "step. Overlap is pushed apart no faster than recovery_speed"
    )


def radii_of_gyration(scene: Any) -> np.ndarray:
    """√(tr I / 2m) (n,) [m] of each body: how large it is, told by its inertia; 0 for a point."""
    found = []
    for body in scene.bodies:
        mass = np.asarray(body.mass, float)
        six = np.asarray(body.inertia.six(), float)
        found.append(np.ravel(np.sqrt(np.maximum(six[..., :3].sum(axis=-1), 0.0) / (2.0 * mass))))
    return np.concatenate(found)


def _refuse_lost(scene: Any, dtype: np.dtype) -> None:
    for path, leaf in jax.tree_util.tree_flatten_with_path(scene)[0]:
        if not (isinstance(leaf, (np.ndarray, float)) and np.asarray(leaf).dtype.kind == "f"):
            continue
        host = np.asarray(leaf)
        if host.dtype.itemsize <= dtype.itemsize:
            continue
        with np.errstate(over="ignore", under="ignore"):
            cast = host.astype(dtype)
        name = jax.tree_util.keystr(path)
        too_large = np.isfinite(host) & ~np.isfinite(cast)
        # Of what is divided by, nothing may be left: neither zero nor a number whose inverse is infinite.
        divided = ".bodies" in name and (".mass" in name or ".inertia" in name)
        too_small = (
            (host != 0) & (np.abs(cast) < np.finfo(dtype).tiny) & (divided and ".components" not in name)
        )
        for bad, word in ((too_large, "large"), (too_small, "small")):
            if bad.any():
                raise InvalidInput(
                    f"Scene{name} is {host[bad].ravel()[0].item()!r}, too {word} for a state of {dtype}; use float64 "
                    "(JAX_ENABLE_X64=1), or other units"
                )


def _warn_of_ratio(masses: np.ndarray, chosen: np.ndarray) -> None:
    own = masses[chosen]
    if len(own) < 2 or own.max() <= _RATIO * own.min():
        return
    light, heavy = chosen[own.argmin()], chosen[own.argmax()]
    warn(
        f"RigidContact: body {heavy} has {own.max() / own.min():.2g} times the mass of body {light}; above {_RATIO:g} "
        "the light one may be pressed into what bears it: look at path.contact.penetration and .poor, or hold the "
        "heavy one in place"
    )


def _warn_of_distance(position: np.ndarray, sizes: np.ndarray, chosen: np.ndarray) -> None:
    place = np.spacing(np.abs(position[chosen]).max(axis=-1, initial=0.0)).astype(float)
    coarse = (place > _COARSE * sizes[chosen]) & (sizes[chosen] > 0)
    if not coarse.any():
        return
    body = chosen[coarse.argmax()]
    warn(
        f"RigidContact: body {body} is at {position[body].tolist()} m, where {position.dtype} has steps of "
        f"{place[coarse.argmax()]:.1e} m, too coarse for a body of {sizes[body]:.1e} m to touch anything; move the "
        "origin nearer, or use float64"
    )
