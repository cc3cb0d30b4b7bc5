"""The command line: `jaxrb demo | simulate | work-precision | plan | cost | scoreboard | fit | bench | hard-cases |
gradient-check | view`."""

import difflib
import importlib
import json as json_text
import os
import sys
import traceback
from pathlib import Path
from typing import Any, Literal

import tyro

from jaxrb.errors import JaxrbError


def demo(
    output: Path = Path("jaxrb-demo"),
    *,
    json: bool = False,
) -> None:
    """Free boxes in each representation, what accuracy costs in time, inertia from a recording, and pictures.

    Example: jaxrb demo --output pictures

    Args:
        output: folder for the pictures.
        json: print one JSON object instead of tables.
    """
    from jaxrb import demo as demonstration

    found = demonstration.demo(output, bar=sys.stderr.isatty())
    print(json_text.dumps(found) if json else demonstration.report(found, output))


def bench(
    *,
    what: Literal[
        "speed",
        "flight",
        "methods",
        "adams",
        "peers",
        "engines",
        "growth",
        "effects",
        "bounds",
        "collision",
        "contact",
        "crowd",
        "identification",
        "joints",
        "memory",
        "ratios",
    ] = "speed",
    planner: bool = False,
    json: bool = False,
) -> None:
    """Speed on this machine: start-up, cost of a step, cost of a gradient; the goals beside the figures.

    CPU time of this process, medians; on a shared machine compare figures of one run only.

    Example: taskset -c 0 jaxrb bench

    Args:
        what: speed of steps and gradients; the closed form of free flight; all methods beside each other; stabilised
            Adams beside its peers; one body beside MuJoCo, diffrax and SciPy at equal error; engines: jaxrb, MuJoCo,
            MJX, Brax, diffrax and heyoka in turns (JAXRB_PEERS_PYTHON names a Python that has those which this one
            has not); growth: cost against bodies, contacts, worlds, steps and devices; whether a scene pays only for
            its effects; bounding volumes, the hierarchy of boxes and the broad phase; distances and depths of pairs
            of shapes; boxes falling on a floor and on each other, beside MuJoCo; 100 to 10,000 balls in a box; inertia
            from a gyroscope beside the Cramér–Rao bound and MuJoCo; joints against closed forms and published
            mechanisms; what `rb.memory` says beside what runs take; ratios: jaxrb's time over that of each peer in five
            rounds, beside the goal, also where it is missed.
        planner: instead, the time of the planner's picks over the best that a fine search finds, on a grid of scenes
            and tolerances (some minutes).
        json: print one JSON object instead of a table.
    """
    from tqdm import tqdm

    from jaxrb.bench import planner as picks
    from jaxrb.bench import workloads
    from jaxrb.tables import table

    files = {"speed": "workloads", "flight": "free_flight", "peers": "stepping_peers"}
    rows = picks.rows() if planner else importlib.import_module(f"jaxrb.bench.{files.get(what, what)}").rows()
    found = list(tqdm(rows, disable=not sys.stderr.isatty(), leave=False, unit=" rows"))
    machine = workloads.machine()
    if json:
        print(json_text.dumps({"machine": machine, "rows": found}))
        return
    print(", ".join(f"{key} {value}" for key, value in machine.items()))
    print(table(found))
    if planner:
        share = 100 * picks.share_within(found)
        print(
            f"{share:.0f} % of the picks are within {picks.GOAL_RATIO} times the best; the goal is "
            f"{100 * picks.GOAL_SHARE:.0f} %."
        )


def _simulate_command() -> Any:
    from jaxrb.simulate import simulate

    return simulate


def _fit_command() -> Any:
    from jaxrb.fit.command import fit

    return fit


def _hard_cases_command() -> Any:
    from jaxrb.hard.command import hard_cases

    return hard_cases


def _gradient_check_command() -> Any:
    from jaxrb.accuracy.gradient_check_command import gradient_check_of_scene

    return gradient_check_of_scene


def _view_command() -> Any:
    from jaxrb.view.viewer_command import view

    return view


def _command(name: str) -> Any:
    from jaxrb.bench import commands

    return getattr(commands, name)


COMMANDS = {
    "demo": lambda: demo,
    "simulate": _simulate_command,
    "work-precision": lambda: _command("work_precision"),
    "plan": lambda: _command("plan"),
    "cost": lambda: _command("cost"),
    "scoreboard": lambda: _command("scoreboard"),
    "fit": _fit_command,
    "bench": lambda: bench,
    "hard-cases": _hard_cases_command,
    "view": _view_command,
    "gradient-check": _gradient_check_command,
}


def main(arguments: list[str] | None = None) -> None:
    """Entry point of `jaxrb`. Exit codes: 0 done, 1 an error that jaxrb explains, 2 a wrong command line."""
    from jaxrb.command_options import with_common

    arguments = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in arguments
    if arguments and not arguments[0].startswith("-") and arguments[0] not in COMMANDS:
        near = difflib.get_close_matches(arguments[0], COMMANDS, 1, 0.5)
        meant = f"did you mean {near[0]}? " if near else ""
        print(
            f"jaxrb: there is no command {arguments[0]!r}; {meant}There are {', '.join(COMMANDS)}",
            file=sys.stderr,
        )
        sys.exit(2)
    # Importing every command for the sake of its help text would make each wait for all.
    chosen = {arguments[0]} & set(COMMANDS) if arguments else set()
    functions = {name: with_common(load()) for name, load in COMMANDS.items() if not chosen or name in chosen}
    try:
        tyro.extras.subcommand_cli_from_dict(
            functions,
            prog="jaxrb",
            description="Differentiable rigid-body dynamics that is honest about its accuracy.",
            args=arguments,
            config=(tyro.conf.PositionalRequiredArgs, tyro.conf.FlagCreatePairsOff),
        )
        sys.stdout.flush()
    except JaxrbError as error:
        if debug:
            traceback.print_exc()
        print(f"jaxrb: {error}", file=sys.stderr)
        sys.exit(1)
    except FloatingPointError as error:
        if not debug:
            raise
        traceback.print_exc()
        print(
            f"jaxrb: --debug found a result that is no number: {error}; its place stands above",
            file=sys.stderr,
        )
        sys.exit(1)
    except BrokenPipeError:
        # `jaxrb … | head`: nobody reads on. Python would complain once more when it closes what cannot be written.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


if __name__ == "__main__":
    main()
