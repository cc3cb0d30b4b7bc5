"""External tests re-run: jaxrb beside what others published, also where it loses. One function a row."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

from jaxrb.bench import contact_gradients, flight_rows, simbenchmark, tosses
from jaxrb.bench.rigid_body_problem import rigid_body_problem
from jaxrb.errors import UnknownName

Entry = dict[str, Any]
_END = {"error_at_end": "largest error of y(10)"}


@dataclasses.dataclass(frozen=True)
class Row:
    """One external test: its name, what it is, the columns of its figures, and a way to run it.

    `sized`: it takes a length ("quick", "default" or "long"); the others have but one.
    """

    name: str
    about: str
    columns: dict[str, str]
    run: Callable[..., Iterator[Entry]]
    sized: bool = False

    def entries(self, length: str = "default") -> Iterator[Entry]:
        """Run it."""
        return self.run(length) if self.sized else self.run()


ROWS: dict[str, Row] = {
    row.name: row
    for row in (
        Row(
            "A",
            "NESC check case 2, tumbling brick, 30 s",
            flight_rows.RATE_COLUMNS,
            flight_rows.tumbling_brick_row,
        ),
        Row(
            "B", "Gazebo boxes, complex, one box, 10 s", flight_rows.BOX_COLUMNS, flight_rows.gazebo_boxes_row
        ),
        Row(
            "B-simple",
            "Gazebo boxes, simple, one box, 10 s",
            flight_rows.BOX_COLUMNS,
            flight_rows.gazebo_boxes_simple_row,
        ),
        Row(
            "C-bouncing",
            "SimBenchmark bouncing, 49 balls",
            simbenchmark.BOUNCING_COLUMNS,
            simbenchmark.bouncing_row,
            True,
        ),
        Row(
            "C-rolling",
            "SimBenchmark rolling, a slab and 25 balls",
            simbenchmark.ROLLING_COLUMNS,
            simbenchmark.rolling_row,
            True,
        ),
        Row(
            "C-666",
            "SimBenchmark 666, 216 balls that do not bounce",
            simbenchmark.INELASTIC_COLUMNS,
            simbenchmark.inelastic_row,
            True,
        ),
        Row(
            "C-666-elastic",
            "SimBenchmark 666, 216 balls that bounce without loss",
            simbenchmark.ELASTIC_COLUMNS,
            simbenchmark.elastic_row,
            True,
        ),
        Row(
            "C-bouncing-events",
            "SimBenchmark bouncing, impacts located in time",
            contact_gradients.EVENTS_COLUMNS,
            contact_gradients.bouncing_events_row,
            True,
        ),
        Row(
            "C-666-elastic-events",
            "SimBenchmark 666 without loss, impacts located in time",
            contact_gradients.EVENTS_COLUMNS,
            contact_gradients.elastic_events_row,
            True,
        ),
        Row(
            "D-bounce",
            "gradients through one bounce (Zhong et al., task 1)",
            contact_gradients.BOUNCE_COLUMNS,
            contact_gradients.bounce_row,
        ),
        Row(
            "D-exchange",
            "gradients of two equal balls that exchange their velocities",
            contact_gradients.EXCHANGE_COLUMNS,
            contact_gradients.exchange_row,
        ),
        Row(
            "D-control",
            "a ball pushed to hit another to the target (Zhong et al., task 3)",
            contact_gradients.CONTROL_COLUMNS,
            contact_gradients.control_row,
            True,
        ),
        Row("E", "rigid-body problem of the ODE literature, t 0…10", _END, rigid_body_problem),
        Row(
            "F",
            "tosses of a real cube, predicted from their first state",
            tosses.COLUMNS,
            tosses.tosses_row,
            True,
        ),
    )
}


def rows_of(name: str | None) -> list[Row]:
    """All rows, or the one of that name, or those whose names begin with it and a dash.

    Raises:
        UnknownName: there is no such row.
    """
    if name is None:
        return list(ROWS.values())
    found = [row for key, row in ROWS.items() if key.lower() == name.lower()]
    if not found:
        found = [row for key, row in ROWS.items() if key.lower().startswith(name.lower() + "-")]
    if not found:
        raise UnknownName(f"scoreboard row {name!r} is not known; there are {', '.join(ROWS)}")
    return found
