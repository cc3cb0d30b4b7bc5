"""What pyproject.toml says of the libraries: all that is imported is named, installed as asked, and free to use."""

import ast
import importlib.metadata
import pathlib
import re
import sys
import tomllib
import zlib

import jax
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import jaxrb

pytestmark = pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"), reason="no number of jaxrb's: once is enough"
)

ROOT = pathlib.Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = (
    "view",
    "live",
    "mesh",
    "mjcf",
    "decompose",
    "bench",
)  # what a user runs; the rest is for developers
# Engines that the benchmarks find in environments of their own, and say so where they are not there.
PEERS = {"brax", "heyoka"}
OTHERWISE_NAMED = {"mpl_toolkits": "matplotlib"}  # modules that go by another name than their distribution

# Licences that ask for no more than to be named, and the Mozilla licence, which covers its own files alone.
FREE = re.compile(
    r"\b(0?BSD|MIT|ISC|[Zz]lib|Apache|PSF|Python Software Foundation|HPND|CC0|BSL-1\.0|MPL|Mozilla)\b"
)
UNFREE = re.compile(
    r"\bA?GPL|\bLGPL|GNU|Commercial|Proprietary|Non-?Commercial|CC-BY-NC|SSPL|BUSL", re.IGNORECASE
)


def requirements(lines, extras=("",)):
    """Those of the lines that hold on this machine, for a distribution asked with these extras."""
    found = [Requirement(line) for line in lines]
    return [
        r for r in found if r.marker is None or any(r.marker.evaluate({"extra": extra}) for extra in extras)
    ]


def of_user():
    lines = list(PROJECT["dependencies"])
    for extra in EXTRAS:
        lines += PROJECT["optional-dependencies"][extra]
    return requirements(lines)


def installed(name):
    try:
        return importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        return None  # an extra that this environment does without


def closure(wanted):
    """The distributions that come along, each with the requirements that ask for it."""
    asked, queue = {}, list(wanted)
    while queue:
        requirement = queue.pop()
        seen = asked.setdefault(canonicalize_name(requirement.name), set())
        if str(requirement) in seen:
            continue
        seen.add(str(requirement))
        found = installed(requirement.name)
        if found is not None:
            queue += requirements(found.requires or (), ("", *requirement.extras))
    return asked


def licence(found):
    """What a distribution says of its licence: the expression, the classifiers, or the first words of the text."""
    data = found.metadata
    classifiers = [line for line in data.get_all("Classifier") or () if line.startswith("License ::")]
    return data.get("License-Expression") or "; ".join(classifiers) or (data.get("License") or "")[:80]


def test_every_library_that_comes_along_is_free_to_use():
    asked = closure(of_user())
    found = {name: licence(distribution) for name in asked if (distribution := installed(name))}
    assert {"jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "tqdm"} <= set(found)
    doubtful = {name: said for name, said in found.items() if not FREE.search(said) or UNFREE.search(said)}
    assert not doubtful


def test_what_is_installed_is_what_is_asked_for():
    core = {canonicalize_name(r.name) for r in requirements(PROJECT["dependencies"])}
    for name, lines in closure(of_user()).items():
        found = installed(name)
        assert found is not None or name not in core, name
        for requirement in map(Requirement, lines):
            if found is not None:
                assert requirement.specifier.contains(found.version, prereleases=True), (
                    requirement,
                    found.version,
                )


@pytest.mark.parametrize("place", ["where a module begins", "within functions"])
def test_what_is_imported_is_a_dependency_by_name(place):
    """Of the core where a module begins, which all users run; of an extra too where a function asks."""
    declared = {canonicalize_name(r.name) for r in requirements(PROJECT["dependencies"])}
    if place == "within functions":
        declared |= {canonicalize_name(r.name) for r in of_user()} | PEERS
    for file in (ROOT / "jaxrb").rglob("*.py"):
        tree = ast.parse(file.read_text())
        for node in ast.walk(tree) if place == "within functions" else tree.body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            for name in {name.split(".")[0] for name in names} - set(sys.stdlib_module_names) - {"jaxrb"}:
                assert canonicalize_name(OTHERWISE_NAMED.get(name, name)) in declared, (file, name)


def brought(names):
    """Distributions that an installation of these brings, by name, without extras."""
    found, waiting = {}, list(names)
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name in found:
            continue
        found[name] = importlib.metadata.distribution(name)
        asked = [Requirement(line) for line in found[name].requires or []]
        waiting += [r.name for r in asked if r.marker is None or r.marker.evaluate({"extra": ""})]
    return found


def test_what_the_core_adds_to_jax_diffrax_and_optax_is_small():
    """As wheels compress it, in bytes: what a user downloads. Installed it is three times as much."""
    added = {k: v for k, v in brought(["jaxrb"]).items() if k not in brought(["jax", "diffrax", "optax"])}
    assert set(added) <= {"jaxrb", "tyro", "tqdm", "typeguard", "docstring-parser", "colorama"}
    package = pathlib.Path(jaxrb.__file__).parent
    files = [file for file in package.rglob("*") if file.is_file()]
    for name, distribution in added.items():
        if name != "jaxrb":  # which may be installed as a link
            files += [pathlib.Path(str(file.locate())) for file in distribution.files or []]
    kept = [file for file in files if file.is_file() and file.suffix != ".pyc"]
    size = sum(len(zlib.compress(file.read_bytes())) for file in kept)
    print(f"the core adds {size / 1e6:.2f} MB in {len(added)} distributions")
    assert 0.5e6 < size < 3e6
