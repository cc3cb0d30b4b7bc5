"""The commands `jaxrb work-precision`, `jaxrb plan`, `jaxrb cost` and `jaxrb scoreboard`."""

import json as json_text
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from jaxrb.tables import table

POINT_HEADINGS = {
    "front": "",
    "method": "method",
    "representation": "representation",
    "precision": "precision",
    "steps": "steps",
    "attitude": "attitude [rad]",
    "position_error_m": "position [m]",
    "energy_error": "energy, rel.",
    "run_us": "run [CPU µs]",
    "step_ns": "a step [ns]",
    "compile_seconds": "compile [CPU s]",
    "memory_bytes": "scratch [B]",
}
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def _bar(unit: str) -> Any:
    from tqdm import tqdm

    return lambda items: tqdm(items, disable=not sys.stderr.isatty(), leave=False, unit=f" {unit}")


def work_precision(
    scene: str,
    *,
    representations: tuple[Literal["quaternion", "matrix", "euler"], ...] = ("quaternion",),
    precisions: tuple[Literal["float64", "float32"], ...] = ("float64", "float32"),
    levels: int = 6,
    front: bool = False,
    figure: Path | None = None,
    json: bool = False,
) -> None:
    """What accuracy costs on a scene: error against CPU time of every method, step, representation and precision.

    Errors are those of the end state, against the closed form or a high-order run that a second computation confirms.
    "*" marks the points that nothing cheaper matches in attitude; "≤" an error that the reference cannot resolve.

    Example: jaxrb work-precision heavy_top --figure heavy_top.png
    Example: jaxrb work-precision my_scene.py --representations quaternion matrix
    Example: jaxrb work-precision contact --figure contact.png

    Args:
        scene: a name (tumbling_brick, dzhanibekov, heavy_top, lagrange_top, thrown_brick, gazebo_boxes,
            gazebo_boxes_simple, free_boxes, double_spring), a Python file that defines scene, state and duration, or a
            model (.xml, .urdf); or, with contact, bouncing_ball, sliding_block, cube_toss, "contact" for all three:
            solve_contact beside fixed steps and MuJoCo, in float64.
        representations: of rotations.
        precisions: float64, float32 or both.
        levels: numbers of steps for each method, each four times the last.
        front: print only the points that nothing cheaper matches.
        figure: draw a picture into this file.
        json: print one JSON object instead of tables.
    """
    from jaxrb.accuracy.contact_scenes import CASES
    from jaxrb.accuracy.work_precision import work_precision as measured
    from jaxrb.io.models.load import example_named
    from jaxrb.scene.settings import check_count

    key = scene.lower().replace("-", "_")
    if key == "contact" or key in CASES:
        _work_precision_of_contact(() if key == "contact" else (key,), front, figure, json)
        return
    check_count("levels", levels, 1)
    found = measured(example_named(scene), representations, precisions, levels, _bar("methods"))
    if figure is not None:
        from jaxrb.view import figures

        known = found.reference.uncertainty.attitude
        figures.save(figures.work_precision_figure(found.points, found.bodies, known, found.scene), figure)
    if json:
        print(json_text.dumps(found.as_dict()))
        return
    print(_work_precision_report(found, front))


def _work_precision_of_contact(names: Sequence[str], front: bool, figure: Path | None, json: bool) -> None:
    from jaxrb.accuracy.contact_report import summary
    from jaxrb.accuracy.contact_work_precision import contact_work_precision

    found = contact_work_precision(names, _bar("scenes"))
    if figure is not None:
        from jaxrb.view import contact_figures, figures

        figures.save(contact_figures.contact_figure(found), figure)
    print(json_text.dumps([scene.as_dict() for scene in found]) if json else summary(found, front))


def _work_precision_report(found: Any, front: bool) -> str:
    known = found.reference
    rows = [
        point.row()
        | {
            "front": "*" if point.on_front else "",
            "attitude": f"≤ {known.uncertainty.attitude:.1e}"
            if point.beyond_reference
            else f"{point.attitude_error_rad:.1e}",
            "run_us": 1e6 * point.run_seconds,
            "step_ns": 1e9 * point.seconds_per_step,
        }
        for point in found.points
        if point.on_front or not front
    ]
    return "\n".join(
        [
            f"{found.scene}: {found.bodies} bodies, {found.duration:g} s; errors at the end.",
            f"Reference: {known.how}; checked by {known.checked_by}: they differ by {known.uncertainty.attitude:.1e} "
            f"rad, {known.uncertainty.position:.1e} m, {known.uncertainty.energy:.1e} of the energy.",
            table(rows, POINT_HEADINGS),
            "",
            "The cheapest that was measured for an attitude error of at most",
            table(_cheapest(found)),
        ]
    )


def _cheapest(found: Any) -> list[dict[str, Any]]:
    rows = []
    for tolerance in TOLERANCES:
        good = [
            p
            for p in found.points
            if max(p.attitude_error_rad, found.reference.uncertainty.attitude) <= tolerance
        ]
        best = min(good, key=lambda p: p.run_seconds, default=None)
        if best is None:
            rows.append({"[rad]": f"{tolerance:.0e}", "method": "none", "representation": "", "precision": "",
                         "steps": "", "run [CPU µs]": ""})  # fmt: skip
            continue
        rows.append(
            {
                "[rad]": f"{tolerance:.0e}",
                "method": best.method,
                "representation": best.representation,
                "precision": best.precision,
                "steps": best.steps,
                "run [CPU µs]": 1e6 * best.run_seconds,
            }
        )
    return rows


def plan(
    scene: str,
    tolerance: float,
    *,
    duration: float | None = None,
    json: bool = False,
) -> None:
    """The cheapest method and step that keep the error of the end state within a tolerance, with the evidence.

    Example: jaxrb plan heavy_top 1e-6

    Args:
        scene: a name, a Python file or a model (.xml, .urdf), as for simulate.
        tolerance: on the attitude [rad] of the worst body; on position and energy relative to their scales.
        duration: [s]; by default the scene's own.
        json: print one JSON object instead of text.
    """
    from jaxrb.accuracy.planner import plan as planned
    from jaxrb.io.models.load import example_named

    example = example_named(scene)
    state = example.state()
    span = example.duration if duration is None else duration
    found = planned(example.scene, state, float(state.time) + span, tolerance)
    print(json_text.dumps(found.as_dict()) if json else found.summary())


def cost(
    scene: str,
    *,
    tolerance: float | None = None,
    dt: float | None = None,
    method: str = "RungeKutta4",
    figure: Path | None = None,
    json: bool = False,
) -> None:
    """What each effect of a scene costs, what leaving it out changes, and which effects the scene calls for.

    For every effect: its share of a step's CPU time, equations, operations and compile time that go when it goes, and
    how far the motion then is from the whole scene's over the scene's duration.

    Example: jaxrb cost thrown_brick --tolerance 1e-3

    Args:
        scene: a name, a Python file or a model (.xml, .urdf), as for simulate.
        tolerance: [rad and m]; name the effects that the scene can do without within it.
        dt: step [s]; by default a thousandth of the scene's duration.
        method: how to advance.
        figure: draw a picture into this file.
        json: print one JSON object instead of text.
    """
    from jaxrb.accuracy.cost import cost as measured
    from jaxrb.accuracy.recommend import recommend
    from jaxrb.io.models.load import example_named

    example = example_named(scene)
    state = example.state()
    step = example.duration / 1000 if dt is None else dt
    steps = max(1, round(example.duration / step))
    found = measured(example.scene, state, dt=step, steps=steps, method=method)
    advice = None
    if tolerance is not None:
        advice = recommend(example.scene, state, float(state.time) + example.duration, tolerance)
    if figure is not None:
        from jaxrb.view import figures

        figures.save(figures.cost_figure(found, example.name), figure)
    if json:
        plain = {"cost": found.as_dict(), "recommendation": None if advice is None else advice.as_dict()}
        print(json_text.dumps(plain))
        return
    print("\n\n".join(part.summary() for part in (found, advice) if part is not None))


def scoreboard(*, row: str = "all", quick: bool = False, long: bool = False, json: bool = False) -> None:
    """External tests re-run: jaxrb beside the figures that others published, also where it loses.

    A: NASA's tumbling brick. B, B-simple: Gazebo's boxes. C-bouncing, C-rolling, C-666, C-666-elastic: SimBenchmark's
    contacts, with goals. E: the rigid-body problem of the ODE literature. MuJoCo runs beside in this process where it
    is installed (extra [bench]). Times are those of one run of the whole test.

    Example: jaxrb scoreboard --row A
    Example: jaxrb scoreboard --row C --quick

    Args:
        row: only this one: A, B, B-simple, C (all four of them), C-bouncing, C-rolling, C-666, C-666-elastic, E or F.
        quick: rows C only for short times and one seed, F with a short fit.
        long: rows C at dt 1e-4 too (half an hour or more).
        json: print one JSON object instead of tables.
    """
    from jaxrb.bench import scoreboard as board
    from jaxrb.bench.workloads import machine
    from jaxrb.errors import InvalidInput

    if quick and long:
        raise InvalidInput("scoreboard: --quick and --long exclude each other")

    chosen = board.rows_of(None if row == "all" else row)
    bar = _bar("entries")
    length = "long" if long else "quick" if quick else "default"
    found = {chosen_row.name: list(bar(chosen_row.entries(length))) for chosen_row in chosen}
    if json:
        print(json_text.dumps({"machine": machine(), "rows": found}))
        return
    print(", ".join(f"{key} {value}" for key, value in machine().items()))
    for chosen_row in chosen:
        print(f"\n{chosen_row.name}. {chosen_row.about}")
        print(entries_table(found[chosen_row.name], chosen_row.columns))
        for source in dict.fromkeys(e["source"] for e in found[chosen_row.name] if e.get("source")):
            print(f"published: {source}")


def entries_table(entries: Sequence[dict[str, Any]], columns: dict[str, str]) -> str:
    """The entries of a row of the scoreboard, published ones first and marked."""
    headings = {"who": "who", "setting": "setting", **columns}
    headings |= {"cpu_s": "CPU [s]", "wall_s": "wall [s]", "compile_cpu_s": "compile [CPU s]"}
    ordered = sorted(entries, key=lambda entry: not entry.get("published", False))
    rows = [{key: _figure(entry.get(key, "")) for key in headings} for entry in ordered]
    for entry, line in zip(ordered, rows):
        if entry.get("published"):
            line["setting"] = f"{line['setting']}, published".lstrip(", ")
    return table(rows, headings)


def _figure(value: Any) -> Any:
    return f"{value:.2e}" if isinstance(value, float) and math.isfinite(value) else value
