"""A hard case, what it measures, and the verdict on it."""

import dataclasses
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from jaxrb.errors import JaxrbError, JaxrbWarning
from jaxrb.hard.contact_peers import Flight
from jaxrb.scene.path import Path

Limits = Mapping[str, float]
# Programs that run once on a handful of numbers: their compile time is what a case costs.
QUICK = {"xla_backend_optimization_level": 0}


@dataclasses.dataclass(frozen=True)
class Measured:
    """What one run of a case gave: the figure that is limited, the gradient (None where there is none), its relative
    error (None where nothing is known to compare with), how the run ended and what is worth saying about it."""

    figure: float
    gradient: Any = None
    gradient_error: float | None = None
    status: str = "ok"
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Case:
    """A hard case.

    `hard` says what is hard, `stable` what stability means here: the measure that `limit` bounds, by precision.
    `ends` is the status that is right: "ok", "flagged" by the run's status, or the name of the error that must refuse
    the input. `warns` is part of the warning that must be given; any other warning of jaxrb is a failure.
    `peer`, if given, is the measure of the same flight in MuJoCo; `flight` is that flight for other engines, and
    `of_peer` the measure of the states (k, n, 13) that they give.
    """

    name: str
    hard: str
    stable: str
    limit: Limits
    run: Callable[[], Measured]
    gradient_limit: Limits | None = None
    ends: str = "ok"
    warns: str | None = None
    peer: Callable[[], float] | None = None
    flight: Flight | None = None
    of_peer: Callable[[np.ndarray], float] | None = None


@dataclasses.dataclass(frozen=True)
class Verdict:
    """The outcome of a case in one precision; `reason` is empty where it passed."""

    name: str
    precision: str
    figure: float
    limit: float
    status: str
    gradient_finite: bool | None
    gradient_error: float | None
    gradient_limit: float | None
    passed: bool
    reason: str
    note: str

    def as_dict(self) -> dict[str, Any]:
        """As plain data; a figure that is no number becomes None."""
        plain = dataclasses.asdict(self)
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in plain.items()}


def precision() -> str:
    """The floating type in which cases run: JAX's default one."""
    return "float64" if jax.config.read("jax_enable_x64") else "float32"


def rounded(numbers: Any) -> np.ndarray:
    """Numbers as this precision holds them, in float64: what an answer is to be compared for."""
    return np.asarray(np.asarray(numbers, precision()), np.float64)


def judge(case: Case) -> Verdict:
    """Run a case in the precision that is switched on, and compare with its limits."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = case.run()
        except JaxrbError as error:
            found = Measured(0.0, status=type(error).__name__, note=str(error))
    said = [str(w.message) for w in caught if issubclass(w.category, JaxrbWarning)]
    for w in caught:
        if not issubclass(w.category, JaxrbWarning):
            warnings.warn_explicit(w.message, w.category, w.filename, w.lineno)
    kind = precision()
    limit = case.limit[kind]
    gradient_limit = None if case.gradient_limit is None else case.gradient_limit[kind]
    finite = None
    if found.gradient is not None:
        finite = all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(found.gradient))
    reasons = _reasons(case, found, said, finite, limit, gradient_limit)
    return Verdict(
        case.name,
        kind,
        float(found.figure),
        limit,
        found.status,
        None if finite is None else bool(finite),
        found.gradient_error,
        gradient_limit,
        not reasons,
        "; ".join(reasons),
        found.note,
    )


def _reasons(
    case: Case,
    found: Measured,
    said: list[str],
    finite: bool | None,
    limit: float,
    gradient_limit: float | None,
) -> list[str]:
    """Everything that is wrong. Comparisons are written so that NaN fails them."""
    reasons = []
    if math.isnan(found.figure):
        reasons.append("the figure is NaN")
    elif not found.figure <= limit:
        reasons.append(f"{found.figure:.2e} is beyond the limit {limit:.2e}")
    if found.status != case.ends:
        reasons.append(f"it ended as {found.status!r} where {case.ends!r} is right")
    if finite is False:
        reasons.append("the gradient is not finite")
    if gradient_limit is not None and not (
        found.gradient_error is not None and found.gradient_error <= gradient_limit
    ):
        reasons.append(f"the gradient is off by {found.gradient_error}, the limit is {gradient_limit:.2e}")
    if case.warns is not None and not any(case.warns in text for text in said):
        reasons.append(f"no warning says {case.warns!r}")
    unexpected = [text for text in said if case.warns is None or case.warns not in text]
    if unexpected:
        reasons.append(f"an unexpected warning: {unexpected[0]}")
    return reasons


def unannounced(path: Path) -> tuple[float, str]:
    """How many saved states of a run are not finite, or no rotations, without its status saying so from that step on;
    and the status. The path must hold every step."""
    drift = np.asarray(path.states.orientation.drift().scale)
    bad = ~(np.abs(drift) < 0.5)
    for leaf in (path.states.position, path.states.velocity, path.states.angular_velocity):
        bad |= ~np.isfinite(np.asarray(leaf)).all(axis=-1)
    first = np.asarray(path.status.first_bad_step)
    silent = bad & ((first < 0) | (np.arange(len(bad))[:, None] < first))
    return float(silent.sum()), "ok" if bool(path.status.ok) else "flagged"
