"""What the README and the documentation show is run: each page's Python from top to bottom, in a folder of its own.

A page's first lines may lean on what it has talked of: `PRELUDES` says what that is. What would take long is run for
less (`SHORTER`); a block after the comment "<!-- not run: why -->" is only compiled.
"""

import inspect
import pathlib
import re

import jax
import pytest

import jaxrb as rb
from jaxrb.cli import COMMANDS

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"(<!-- not run: [^>]+-->\n)?^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
SPAN = re.compile(r"`(jaxrb [^`]+)`")
WANTED = 11  # pages with Python; fewer means that they are no longer found

COMMON = "import jax\nimport jax.numpy as jnp\nimport jaxrb as rb\n"
BALL = """
brick = rb.Body.from_shape(rb.Box((0.10, 0.05, 0.02)), density=700.0)
scene = rb.Scene(brick, (rb.UniformGravity(), rb.QuadraticDrag(coefficient=0.4, area=0.02)))
state = scene.state(velocity=(3.0, 0.0, 4.0), angular_velocity=(0.5, 5.0, 0.1))
"""
PRELUDES = {
    "long_runs.md": BALL,
    "many_worlds.md": BALL + "worlds = [(scene, state), (rb.Scene(brick, rb.UniformGravity()), state)]\n",
    "identification.md": BALL
    + """
rb.write_recording(rb.read_recording(EXAMPLE), "throw.csv")
first_state = state
path = rb.rollout(scene, state, dt=1e-3, steps=500, save_every=25)
recording = rb.Recording(path.times, path.states.angular_velocity[:, 0], position=path.states.position[:, 0])
""",
}
SHORTER = {
    "identification.md": {'read_recording("throw.csv")': 'read_recording("throw.csv"), nuisances=()'},
    "long_runs.md": {"steps=10_000_000": "steps=20_000"},
}


def blocks(page):
    """The page's Python: each block with whether it is to be run."""
    text = page.read_text(encoding="utf-8")
    return [
        (match[2], match[1] is None, text[: match.start(2)].count("\n")) for match in BLOCK.finditer(text)
    ]


WITH_PYTHON = [page for page in PAGES if blocks(page)]


def test_pages_with_python_are_found():
    assert len(WITH_PYTHON) >= WANTED


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.name)
def test_snippets_run(page, tmp_path, monkeypatch):
    if jax.config.read("jax_enable_x64") == (page.name == "README.md"):
        pytest.skip(
            "the README is run in float32, which a new user has, and the other pages in float64, once each"
        )
    monkeypatch.chdir(tmp_path)
    known = {
        "__name__": "snippet",
        "EXAMPLE": pathlib.Path(rb.__file__).parent / "data" / "tumbling_brick.npz",
    }
    exec(COMMON + PRELUDES.get(page.name, ""), known)
    shorter = dict(SHORTER.get(page.name, {}))
    for text, wanted, line in blocks(page):
        for long in [long for long in shorter if long in text]:
            text = text.replace(long, shorter.pop(long))
        code = compile("\n" * line + text, str(page), "exec")  # a failure then names the page's line
        if wanted:
            exec(code, known)
    assert not shorter, f"{page.name} no longer holds {list(shorter)}"


def test_commands_that_pages_name_are_there():
    """Every `jaxrb …` in the text: its subcommand and its options exist."""
    found = [(page.name, span) for page in PAGES for span in SPAN.findall(page.read_text(encoding="utf-8"))]
    assert len(found) > 30
    for name, span in found:
        words = span.split()[1:]
        if words[0].startswith(("…", "<")):
            continue
        command, *rest = (word.rstrip(",") for word in words)
        assert command in COMMANDS, f"{name}: {span!r}: there is no such command"
        options = inspect.signature(COMMANDS[command]()).parameters
        for word in rest:
            if word.startswith("--") and word not in ("--float32", "--x64", "--help"):
                option = word[2:].partition("=")[0].replace("-", "_").removeprefix("no_")
                assert option in options, f"{name}: {span!r}: {command} takes no {word}"
