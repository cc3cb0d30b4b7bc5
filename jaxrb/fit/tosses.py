"""Friction, restitution, stiffness, metric scale, size and inertia from tosses onto a table, by whole predictions.

Each toss is predicted from its first recorded state, and the mean errors of position and attitude over all tosses are
made small. Not by gradients: which face a body comes to rest on is a jump, and the mean over tosses is full of them.

Source of the search: the cross-entropy method, Rubinstein 1999.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.inertia import FullInertia
from jaxrb.draws import drawn
from jaxrb.effects.compliant_contact import CompliantContact
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import InvalidInput
from jaxrb.fit.metre import METRIC_SCALE
from jaxrb.fit.predictions import Recorded, Scenes, recorded, toss_errors
from jaxrb.geometry.primitives import HalfSpace
from jaxrb.geometry.shape import Shape
from jaxrb.io.recording import Recording
from jaxrb.scene.scene import Scene

_BOOTSTRAPS = 400


class Search(NamedTuple):
    """Where a number is looked for: the middle and width to begin with, and its bounds."""

    middle: float
    width: float
    least: float
    most: float


# What `jaxrb fit --tosses` looks for: name, where, and what it is.
TOSS_UNKNOWNS: dict[str, tuple[Search, str]] = {
    "friction": (Search(0.3, 0.2, 0.0, 2.0), "of the body on the table [1]"),
    "restitution": (Search(0.3, 0.2, 0.0, 1.0), "of impacts [1]"),
    "log10_stiffness": (
        Search(4.5, 1.0, 2.0, 8.0),
        "of a compliant contact, k in N/m^1.5, in place of rigid",
    ),
    METRIC_SCALE: (Search(0.0, 0.03, -0.3, 0.3), "relative error of the recorded lengths [1]"),
    "size": (Search(1.0, 0.02, 0.7, 1.3), "of the body over the size given [1]"),
    "inertia": (Search(1.2, 0.2, 0.3, 2.0), "over that of the filled shape [1]"),
}


@dataclass(frozen=True)
class TossFit:
    """Numbers with the least mean error; standard errors by a bootstrap over tosses, and by how fine the search was.

    `position_error` (n,) [m, as recorded] and `attitude_error` (n,) [rad] are the means over each toss; `runs` counts
    the sets of numbers tried. The bars are as coarse as the tried numbers lie, and know nothing of a wrong model.
    """

    values: dict[str, float]
    standard_errors: dict[str, float]
    position_error: np.ndarray
    attitude_error: np.ndarray
    runs: int

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for JSON."""
        return {
            "values": self.values,
            "standard_errors": self.standard_errors,
            "position_error_mean_m": float(self.position_error.mean()),
            "attitude_error_mean_rad": float(self.attitude_error.mean()),
            "tosses": len(self.position_error),
            "runs": self.runs,
        }

    def summary(self) -> str:
        """A few lines of text."""
        rows = [
            f"  {name:16s}{value:10.4f} ± {self.standard_errors[name]:.2g}  {TOSS_UNKNOWNS.get(name, ('', ''))[1]}"
            for name, value in self.values.items()
        ]
        place, angle = 1e3 * self.position_error, np.rad2deg(self.attitude_error)
        return "\n".join(
            [
                f"From {len(place)} tosses, {self.runs} sets of numbers tried:",
                *rows,
                f"Predicted from their first state they are off by {place.mean():.1f} mm and {angle.mean():.1f}° "
                f"(median {np.median(place):.1f} mm, {np.median(angle):.1f}°).",
            ]
        )


def fit_tosses(
    tosses: Recording | tuple[Recorded, float],
    scene: Scenes,
    search: Mapping[str, Search],
    *,
    length: float,
    rounds: int = 6,
    samples: int = 12,
    substeps: int = 4,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> TossFit:
    """The numbers of a scene of one body with the least mean error of prediction over all tosses.

    Args:
        tosses: with position, velocity, orientation and angular velocity at one even rate, or what `recorded` made.
        scene: from the numbers by name to the body, its contact and what else acts, such as `solid_on_table`.
        search: where to look, by name. "metric_scale" is the recording's: its lengths are (1 + s) times too long.
        length: [m] what an error of position is divided by, to be added to the attitude's in radians: half a side.
        rounds, samples: sets of numbers in each round; the better half leads to the next.
        substeps: steps between two samples.
        seed: of the search.
        progress: called with a line of text now and then.

    Raises:
        InvalidInput: a quantity that is missing, samples that are not even, nothing to look for.
    """
    data, rate = recorded(tosses) if isinstance(tosses, Recording) else tosses
    if not search or rounds < 1 or samples < 2:
        raise InvalidInput(
            f"fit_tosses: {len(search)} numbers to look for, {rounds} rounds of {samples}; give at least 1, 1 and 2."
        )
    random, names = drawn(seed), tuple(search)
    middle, first, least, most = np.array([search[name] for name in names], float).T
    width = first
    tried: list[tuple[float, np.ndarray, np.ndarray]] = []
    for round_ in range(rounds):
        for numbers in np.clip(middle + width * random.standard_normal((samples, len(names))), least, most):
            position, angle = toss_errors(data, rate, scene, dict(zip(names, numbers)), substeps)
            each = position / length + angle
            # A run that is no number is the worst of all, and stays on the list.
            each = np.where(np.isfinite(each), each, np.inf)
            tried.append((float(each.mean()), numbers, each))
        tried.sort(key=lambda entry: entry[0])
        best = np.stack([numbers for _, numbers, _ in tried[: max(3, samples // 2)]])
        middle, width = best.mean(axis=0), np.maximum(best.std(axis=0), 0.1 * first)
        if progress is not None:
            progress(f"round {round_ + 1} of {rounds}: error {tried[0][0]:.4g}")
    if not np.isfinite(tried[0][0]):
        raise InvalidInput("fit_tosses: no set of numbers gave a finite prediction; take more substeps.")
    found = {name: float(value) for name, value in zip(names, tried[0][1])}
    errors = dict(zip(names, _scatter(tried, random).tolist()))
    return TossFit(found, errors, *toss_errors(data, rate, scene, found, substeps), runs=len(tried))


def solid_on_table(shape: Shape, mass: float = 1.0) -> Scenes:
    """A filled shape of `mass` [kg] over a table z = 0, from numbers by the names of `TOSS_UNKNOWNS`.

    Rigid contact does not know the mass; a compliant one does.
    """

    def build(numbers: Mapping[str, Any]) -> Scene:
        size = numbers.get("size", 1.0)
        sized = jax.tree.map(lambda leaf: size * leaf, shape)
        whole = sized.mass_properties(1.0)
        six = FullInertia.from_matrix(whole.inertia.as_matrix()).six() * (
            mass / whole.mass * numbers.get("inertia", 1.0)
        )
        body = Body(mass, FullInertia(six), sized, whole.center_of_mass)
        friction = numbers.get("friction", 0.0)
        if "log10_stiffness" in numbers:
            stiffness = 10.0 ** numbers["log10_stiffness"]
            contact = CompliantContact(HalfSpace(), stiffness=stiffness, friction=friction, slip_speed=0.01)
        else:
            contact = RigidContact(HalfSpace(), friction, numbers.get("restitution", 0.0))
        return Scene(body, (UniformGravity(), contact))

    return build


def _scatter(tried: list[tuple[float, np.ndarray, np.ndarray]], random: np.random.Generator) -> np.ndarray:
    """Scatter of the best numbers when tosses are drawn again, with repetition, and of the best three of the search.

    `tried` is sorted. The second part is how fine the search was: few tosses always choose the same run.
    """
    numbers, each = np.stack([entry[1] for entry in tried]), np.stack([entry[2] for entry in tried])
    count = each.shape[1]
    drawn = random.multinomial(count, np.full(count, 1.0 / count), size=_BOOTSTRAPS)
    finite = np.all(np.isfinite(each), axis=1)
    again = numbers[finite][np.argmin(drawn @ each[finite].T, axis=1)].std(axis=0)
    return np.hypot(again, numbers[:3].std(axis=0))
