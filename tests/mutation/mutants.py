"""Small faults put into math, body and integrators one at a time: do the tests of the module find them?

    python tests/mutation/mutants.py --sample 150 --seed 0
    python tests/mutation/mutants.py --only integrators/midpoint.py --sample 20

Each mutant is one exchanged sign, operator, comparison, number or truth value in the program's text as it is loaded; no
file is changed. It lives in a process forked from one that has JAX loaded, which runs the tests named below until one
fails. A mutant that makes them run for ever is killed too.
"""

import argparse
import ast
import contextlib
import copy
import importlib
import importlib.abc
import importlib.util
import json
import os
import pathlib
import random
import signal
import sys
import time
import traceback

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "jaxrb"
FOLDERS = ("math", "body", "integrators")
TIMEOUT = 240.0  # [s] of the clock

ORDERS = "tests/test_method_orders.py"
COEFFICIENTS = "tests/test_coefficients.py"
ROLLOUT = ("tests/scene/test_rollout.py", ORDERS, "tests/test_compensated_sums.py")
KINDS = (
    "tests/joints/test_joint_structure.py",
    "tests/scene/test_reversible.py",
)  # which methods may do what
FREE_FLIGHT = ("tests/test_free_flight.py",)
ADAMS = ("tests/test_adams.py",)
SPLITTINGS = ("tests/test_splittings.py", ORDERS, "tests/test_long_runs.py")
# The tests of each module, quickest first; a folder's own where nothing else is said.
TESTS = {
    "math/arrays.py": ("tests/math", "tests/scene/test_rollout.py"),
    "math/elliptic.py": ("tests/math/test_elliptic.py", *FREE_FLIGHT),
    "math/settled.py": ("tests/math/test_settled.py", *FREE_FLIGHT, *ADAMS),
    "math/compaction.py": ("tests/contact/test_contact_structure.py", "tests/collision/test_broadphase.py"),
    "math/safe.py": ("tests/math/test_safe_derivatives.py", "tests/math"),
    "body/body.py": ("tests/body", "tests/test_bad_inputs_x.py", "tests/test_bad_inputs_b.py"),
    "body/freedom.py": ("tests/effects/test_freedom.py",),
    "body/mass_properties.py": ("tests/body/test_mass_properties.py", "tests/geometry/test_mesh.py"),
    "body/unturned.py": ("tests/effects/test_freedom.py",),
    "body/euler_equation.py": (
        "tests/body/test_euler_equation.py",
        "tests/body/test_inertia.py",
        "tests/scene/test_rollout.py",
        "tests/effects/test_freedom.py",
    ),
    "integrators/adams_weights.py": (COEFFICIENTS, ORDERS, *ADAMS),
    "integrators/splitting.py": (COEFFICIENTS, *SPLITTINGS),
    "integrators/three_axis_splitting.py": SPLITTINGS,
    "integrators/moser_veselov.py": SPLITTINGS,
    "integrators/principal_frame.py": SPLITTINGS,
}
OWN = {"math": ("tests/math",), "body": ("tests/body",), "integrators": (*ROLLOUT, *KINDS)}
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Add, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


def tests_of(module: str) -> tuple[str, ...]:
    """The tests that are to find a fault in a file, given as "folder/file.py"."""
    name = module.split("/")[1]
    if module in TESTS:
        return TESTS[module]
    if name.startswith("adams"):
        return ADAMS
    return FREE_FLIGHT if name.startswith("free_flight") else OWN[module.split("/")[0]]


class Sites(ast.NodeVisitor):
    """The nodes at which a fault can be put. Text, annotations and messages are left alone."""

    def __init__(self) -> None:
        self.found: list[ast.AST] = []

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, (ast.JoinedStr, ast.Raise, ast.Import, ast.ImportFrom)):
            return
        changes = (
            isinstance(node, (ast.BinOp, ast.AugAssign))
            and type(node.op) in OPERATORS
            and not _of_text(node),
            isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS,
            isinstance(node, (ast.BoolOp, ast.UnaryOp)) and not isinstance(node, ast.Invert),
            isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)),
        )
        if any(changes):
            self.found.append(node)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    self.visit(child)


def _of_text(node: ast.AST) -> bool:
    return any(isinstance(part, (ast.Constant, ast.JoinedStr)) and isinstance(getattr(part, "value", ""), str)
               for part in ast.iter_child_nodes(node))  # fmt: skip


def mutated(tree: ast.Module, number: int) -> tuple[ast.Module, str]:
    """The tree with its site `number` exchanged, and what was done in words."""
    tree = copy.deepcopy(tree)
    sites = Sites()
    sites.visit(tree)
    node = sites.found[number]
    before = ast.unparse(node)
    if isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp)):
        node.op = OPERATORS[type(node.op)]()
    elif isinstance(node, ast.Compare):
        node.ops = [OPERATORS[type(node.ops[0])]()]
    elif isinstance(node, ast.UnaryOp):
        node.op = ast.UAdd() if isinstance(node.op, ast.USub) else ast.USub()
        if isinstance(node.op, ast.USub):  # it was `not` or `~`
            node.op, node.operand = ast.Not(), ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node, ast.Constant):
        node.value = (not node.value) if isinstance(node.value, bool) else node.value + 1
    ast.fix_missing_locations(tree)
    return tree, f"line {node.lineno}: {before} → {ast.unparse(node)}"


class Mutant(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads one module from another tree."""

    def __init__(self, name: str, file: pathlib.Path, tree: ast.Module):
        self.name, self.file, self.tree = name, file, tree

    def find_spec(self, fullname, path, target=None):
        return (
            importlib.util.spec_from_file_location(fullname, self.file, loader=self)
            if fullname == self.name
            else None
        )

    def create_module(self, spec):
        return None

    def exec_module(self, module):
        exec(compile(self.tree, str(self.file), "exec"), module.__dict__)


def outcome(module: str, tree: ast.Module, log: pathlib.Path) -> str:
    """ "killed", "killed by time" or "survived", in a process of its own."""
    child = os.fork()
    if child == 0:
        with open(log, "w") as stream:
            os.dup2(stream.fileno(), 1)
            os.dup2(stream.fileno(), 2)
        code = 1
        try:
            import pytest

            name = "jaxrb." + module.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
            sys.meta_path.insert(0, Mutant(name, PACKAGE / module, tree))
            os.chdir(ROOT)
            ready = [
                "-W",
                "ignore:Module already imported",
            ]  # some of what is loaded above are plugins of pytest
            code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *ready, *tests_of(module)]))
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        os._exit(code)
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            if code in (3, 4, 5):
                raise SystemExit(
                    f"the tests of {module} cannot be run (pytest's exit code {code}); see {log}"
                )
            return "survived" if code == 0 else "killed"
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "killed by time"


def every_site(only: str | None) -> list[tuple[str, int]]:
    """All sites of all modules, or of those whose name begins with `only`."""
    found = []
    for folder in FOLDERS:
        for file in sorted((PACKAGE / folder).glob("*.py")):
            module = f"{folder}/{file.name}"
            if file.name != "__init__.py" and (only is None or module.startswith(only)):
                sites = Sites()
                sites.visit(ast.parse(file.read_text()))
                found += [(module, i) for i in range(len(sites.found))]
    return found


def survivors(file: pathlib.Path) -> list[tuple[str, int]]:
    """The sites of the mutants that survived, by the output of an earlier run."""
    lines = [json.loads(line) for line in file.read_text().splitlines() if line.startswith("{")]
    wanted = {(line["file"], line["what"]) for line in lines if line["end"] == "survived"}
    trees = {module: ast.parse((PACKAGE / module).read_text()) for module, _ in wanted}
    return [
        (module, i) for module, i in every_site(None)
        if module in trees and (module, mutated(trees[module], i)[1]) in wanted
    ]  # fmt: skip


def main() -> None:
    """Print each mutant as it ends, and the share that was killed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--sample", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="files whose name, such as math/safe.py, begins so")
    parser.add_argument("--first", type=int, default=0, help="skip so many of the sample")
    parser.add_argument("--again", type=pathlib.Path, help="only what survived, by an earlier output")
    parser.add_argument(
        "--folder", type=pathlib.Path, default=pathlib.Path("/tmp"), help="for the tests' output"
    )
    given = parser.parse_args()
    # Loaded before the fork, so that it is loaded once; no array is made, or there would be threads to lose.
    for name in ("jax", "jax.numpy", "numpy", "equinox", "diffrax", "scipy.special"):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    sites = every_site(given.only) if given.again is None else survivors(given.again)
    sample = random.Random(given.seed).sample(sites, min(given.sample, len(sites)))[given.first :]
    counts = {"killed": 0, "killed by time": 0, "survived": 0}
    for module in {tests_of(module): module for module, _ in sample}.values():
        tree = ast.parse((PACKAGE / module).read_text())
        if outcome(module, tree, given.folder / "mutant.log") != "survived":
            raise SystemExit(
                f"the tests of {module} fail without any fault; see {given.folder / 'mutant.log'}"
            )
    for i, (module, number) in enumerate(sample, given.first):
        tree, said = mutated(ast.parse((PACKAGE / module).read_text()), number)
        began = time.monotonic()
        end = outcome(module, tree, given.folder / "mutant.log")
        counts[end] += 1
        print(json.dumps({"number": i, "file": module, "what": said, "end": end,
                          "seconds": round(time.monotonic() - began, 1)}, ensure_ascii=False), flush=True)  # fmt: skip
    total = sum(counts.values())
    print(f"{len(sites)} sites, {total} tried, {total - counts['survived']} killed: "
          f"{100 * (1 - counts['survived'] / max(total, 1)):.0f} %")  # fmt: skip


if __name__ == "__main__":
    main()
