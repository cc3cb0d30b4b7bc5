"""The reference names everything public, and nothing that is gone; `mkdocs build --strict` checks the rest."""

import pathlib
import re
import types

import jaxrb as rb

PAGES = pathlib.Path(__file__).resolve().parent.parent / "docs" / "api"
NAMED = [
    name for page in PAGES.glob("*.md") for name in re.findall(r"^::: (\S+)$", page.read_text("utf-8"), re.M)
]


def test_every_public_name_has_its_place_in_the_reference():
    public = {
        name
        for name in dir(rb)
        if not name.startswith("_")
        and not isinstance(getattr(rb, name), types.ModuleType)
        and str(getattr(getattr(rb, name), "__module__", "")).startswith("jaxrb")
    }
    last = {name.split(".")[-1] for name in NAMED}
    assert len(public) > 120
    assert public - last == set()


def test_no_name_stands_there_twice():
    assert sorted(set(NAMED)) == sorted(NAMED)
