"""`jaxrb fit FILE --tosses …`: from options to a search over tosses, and what it found to a table or JSON."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jaxrb.errors import InvalidInput
from jaxrb.fit.tosses import TOSS_UNKNOWNS, TossFit, fit_tosses, solid_on_table
from jaxrb.geometry.primitives import Box, Sphere
from jaxrb.io.recording import Recording

_SUBSTEPS = {True: 40, False: 4}  # a compliant contact is stiff


def tosses_fitted(
    recording: Recording,
    names: Sequence[str],
    half_extents: tuple[float, float, float] | None,
    radius: float | None,
    mass: float,
    rounds: int,
    html: Path | None,
    progress: Callable[[str], None],
) -> TossFit:
    """The numbers of these names for a box or a ball on the table z = 0.

    Raises:
        InvalidInput: a name that is not known or does not go with another, no shape or two, a page.
    """
    if html is not None:
        raise InvalidInput("fit: --html draws the page of an inertia; leave it out with --tosses.")
    for name in names:
        if name not in TOSS_UNKNOWNS:
            raise InvalidInput(f"fit: tosses has {name!r}; known are {', '.join(TOSS_UNKNOWNS)}.")
    if "restitution" in names and "log10_stiffness" in names:
        raise InvalidInput(
            "fit: restitution belongs to rigid contact, log10_stiffness to a compliant one; name one, not both."
        )
    if (half_extents is None) == (radius is None):
        raise InvalidInput("fit: tosses need the body's shape: give one of half-extents or radius [m].")
    shape: Any = Sphere(radius) if half_extents is None else Box(half_extents)
    length = float(radius) if radius is not None else min(half_extents or (1.0,))
    return fit_tosses(
        recording,
        solid_on_table(shape, mass),
        {name: TOSS_UNKNOWNS[name][0] for name in names},
        length=length,
        rounds=rounds,
        substeps=_SUBSTEPS["log10_stiffness" in names],
        progress=progress,
    )
