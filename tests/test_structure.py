"""The house itself: imports point downwards, importing sets nothing, files stay readable."""

import ast
import pathlib
import subprocess
import sys

import pytest

import jaxrb

PACKAGE = pathlib.Path(jaxrb.__file__).parent
FLOORS = {
    "errors": -2,
    "checks": -1,
    "draws": -1,
    "compilation": -1,
    "tables": -1,
    "compilation_cache": -1,
    "math": 0,
    "body": 1,
    "geometry": 2,
    "collision": 3,
    "effects": 4,
    "contact": 4.5,  # an effect that a step resolves
    "joints": 4.5,
    "integrators": 5,
    "scene": 6,
    "accuracy": 7,
    "io": 7,
    "fit": 7.5,  # a fit reads recordings
    "data": 7.5,
    "view": 8,
    "bench": 8,
    "hard": 8.5,  # a peer's figure stands beside ours
    "demo": 9,
    "simulate": 9,
    "command_options": 9,
    "cli": 9.5,
    "__main__": 10,
}


def imported(file: pathlib.Path) -> list[str]:
    """Dotted names of everything of jaxrb that a file imports, wherever in the file."""
    names = []
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: import by full name"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return [name for name in names if name.split(".")[0] == "jaxrb"]


def floor_of(name: str) -> float:
    return FLOORS[name.split(".")[1]]


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("*.py")), ids=lambda f: str(f.relative_to(PACKAGE)))
def test_imports_point_downwards(file):
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    if parts == ("__init__",):
        return  # the facade
    own = FLOORS[parts[0]]
    for name in imported(file):
        assert floor_of(name) <= own, f"{file.name} is on floor {own} and imports {name} from above"


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("*.py")), ids=lambda f: str(f.relative_to(PACKAGE)))
def test_files_and_functions_stay_readable(file):
    text = file.read_text()
    assert text.count("\n") <= 330, f"{file.name} has outgrown its room"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            length = node.end_lineno - node.lineno + 1
            assert length <= 90, f"{file.name}: {node.name} has {length} lines"


def test_import_changes_no_setting_and_loads_nothing_heavy():
    program = """
import jax
before = dict(jax.config.values)
import sys, jaxrb
assert dict(jax.config.values) == before, "a setting of JAX changed"
heavy = {"matplotlib", "diffrax", "optax", "scipy.optimize", "tyro", "trimesh", "mujoco", "tqdm"} & set(sys.modules)
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True)


def test_facade_names_exist_and_say_what_they_are():
    for name in dir(jaxrb):
        member = getattr(jaxrb, name)
        if not name.startswith("_") and (isinstance(member, type) or callable(member)):
            assert member.__doc__, name
