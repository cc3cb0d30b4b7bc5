"""The body of `jaxrb hard-cases`."""

import dataclasses
import functools
import json as json_text
import math
import sys
from typing import Any

from jaxrb.bench.peers import NOT_INSTALLED, mujoco_version
from jaxrb.hard.case import Case, Verdict, judge, precision
from jaxrb.hard.contact_peers import NAMES, flown
from jaxrb.hard.flight import VERY_LONG_STEPS, long_flip
from jaxrb.hard.table import cases_named
from jaxrb.tables import table

_LONG = "intermediate-axis flip, long"


def hard_cases(
    *, only: str | None = None, long: bool = False, peers: bool = False, json: bool = False
) -> None:
    """Hard cases: what is hard, what it costs in digits, and whether the gradient survives. Exit code 1 if one fails.

    Rotation, springs, fields, derivatives, distances of shapes and contact at the inputs where formulas degenerate;
    each with a figure and a limit that is stated for this precision.

    Example: jaxrb hard-cases --only separatrix
    Example: jaxrb hard-cases --float32

    Args:
        only: those whose name contains this.
        long: 1e7 steps in the long run (a minute or so), not 1e5.
        peers: also fly them in MJX and Brax, some minutes; JAXRB_PEERS_PYTHON names a Python that has them.
        json: print one JSON object instead of a table.
    """
    from tqdm import tqdm

    cases = cases_named(only)
    if long:
        run = functools.partial(long_flip, VERY_LONG_STEPS)
        cases = tuple(dataclasses.replace(case, run=run) if case.name == _LONG else case for case in cases)
    version = mujoco_version()
    rows = []
    for case in tqdm(cases, disable=not sys.stderr.isatty(), leave=False, unit=" cases"):
        rows.append((case, judge(case), _peer(case) if version else None))
    failed = [verdict for _, verdict, _ in rows if not verdict.passed]
    others = {engine: _in_other(engine, cases) for engine in NAMES} if peers else {}
    if json:
        print(json_text.dumps(_plain(rows, version, others)))
    else:
        print(_report(rows, version, others))
    if failed:
        sys.exit(1)


def _peer(case: Case) -> float | str | None:
    """MuJoCo's figure; its own words where it refuses the body."""
    if case.peer is None:
        return None
    try:
        return case.peer()
    except ValueError as error:
        return f"refused: {str(error).splitlines()[0]}"


def _in_other(engine: str, cases: tuple[Case, ...]) -> dict[str, float | str]:
    """The figure of each case that the engine can fly, by name; in words where it cannot be had."""
    groups: dict[tuple, list[Case]] = {}
    for case in cases:
        if case.flight is not None:
            groups.setdefault((case.flight.kind, len(case.flight.masses)), []).append(case)
    found: dict[str, float | str] = {}
    for group in groups.values():
        answers = flown(engine, [case.flight for case in group if case.flight is not None])
        for i, case in enumerate(group):
            states = answers if isinstance(answers, str) else answers[i]
            if isinstance(states, str):
                found[case.name] = states
            elif states is not None and case.of_peer is not None:
                found[case.name] = case.of_peer(states)
    return found


def _plain(
    rows: list[tuple[Case, Verdict, Any]], version: str | None, others: dict[str, dict[str, float | str]]
) -> dict[str, Any]:
    found = [
        verdict.as_dict()
        | {"hard": case.hard, "stable": case.stable, "mujoco": _json_number(other)}
        | {engine: _json_number(figures.get(case.name)) for engine, figures in others.items()}
        for case, verdict, other in rows
    ]
    return {"precision": precision(), "mujoco": version or NOT_INSTALLED, "cases": found}


def _json_number(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _report(
    rows: list[tuple[Case, Verdict, Any]], version: str | None, others: dict[str, dict[str, float | str]]
) -> str:
    lines = []
    for case, verdict, other in rows:
        line: dict[str, Any] = {
            "case": case.name,
            "figure": f"{verdict.figure:.1e}",
            "limit": f"{verdict.limit:.0e}",
            "ended": verdict.status,
            "gradient": _gradient(verdict),
            "": "passed" if verdict.passed else "FAILED",
        }
        if version:
            line["MuJoCo"] = _shown(other)
        for engine, figures in others.items():
            figure = figures.get(case.name)
            line[NAMES[engine]] = "*" if isinstance(figure, str) else _shown(figure)
        lines.append(line | {"what is hard": case.hard})
    bad = [verdict for _, verdict, _ in rows if not verdict.passed]
    measures = dict.fromkeys(case.stable for case, _, _ in rows)
    parts = [table(lines), "", "What the figures are:"]
    parts += [
        f"  {', '.join(case.name for case, _, _ in rows if case.stable == measure)}: {measure}."
        for measure in measures
    ]
    notes = [f"  {v.name}: {v.note}." for _, v, _ in rows if v.note]
    parts += ["", "Notes:", *notes] if notes else []
    if version is None:
        parts += ["", f"MuJoCo: {NOT_INSTALLED}."]
    for engine, figures in others.items():
        said = dict.fromkeys(figure for figure in figures.values() if isinstance(figure, str))
        parts += [f"* {NAMES[engine]}: {words}." for words in said]
    parts += ["", f"{len(rows) - len(bad)} of {len(rows)} passed in {precision()}."]
    parts += [f"FAILED {v.name}: {v.reason}" for v in bad]
    return "\n".join(parts)


def _shown(figure: float | str | None) -> str:
    """A peer's figure, or its words."""
    return f"{figure:.1e}" if isinstance(figure, float) else str(figure or "")


def _gradient(verdict: Verdict) -> str:
    if verdict.gradient_finite is None:
        return ""
    if not verdict.gradient_finite:
        return "NOT FINITE"
    return "finite" if verdict.gradient_error is None else f"off {verdict.gradient_error:.1e}"
