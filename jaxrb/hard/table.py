"""All hard cases in one table."""

import difflib

from jaxrb.errors import UnknownName
from jaxrb.hard import coin, derivatives, flight, scenes, shapes, stack, touching
from jaxrb.hard.case import Case

CASES: tuple[Case, ...] = tuple(
    case for file in (flight, derivatives, scenes, shapes, touching, stack, coin) for case in file.cases()
)


def cases_named(name: str | None) -> tuple[Case, ...]:
    """The cases whose name contains `name`; all where it is None.

    Raises:
        UnknownName: there is none.
    """
    if name is None:
        return CASES
    found = tuple(case for case in CASES if name.lower() in case.name.lower())
    if not found:
        names = [case.name for case in CASES]
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.3)
        meant = f"; did you mean {' or '.join(repr(n) for n in near)}?" if near else ""
        raise UnknownName(
            f"no hard case is called {name!r}{meant} `jaxrb hard-cases` prints all {len(names)}"
        )
    return found
