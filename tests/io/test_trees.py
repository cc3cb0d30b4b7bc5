"""Trees of the library's own classes as plain JSON and arrays: what goes in comes out, and nothing else is let in."""

import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.io.tree import decoded, encoded
from jaxrb.tables import table

BALL = "jaxrb.geometry.primitives:Sphere"


def test_what_is_written_is_read():
    tree = {"a": (1, 2.5, None, "x", True), "b": [rb.UniformGravity(), rb.Sphere(0.5)], "c": np.float64(0.1)}
    arrays = []
    found = decoded(encoded(tree, arrays), arrays, "here")
    assert found["a"] == tree["a"]
    assert type(found["b"][0]) is rb.UniformGravity
    np.testing.assert_array_equal(found["b"][0].acceleration, tree["b"][0].acceleration)
    assert float(found["b"][1].radius) == 0.5
    assert found["c"] == tree["c"]


@pytest.mark.parametrize("thing", [lambda x: x, {1: 2}, object(), {1, 2}, 1j])
def test_what_no_file_can_hold_is_refused(thing):
    with pytest.raises(WrongStructure, match="no file can hold it"):
        encoded({"a": thing}, [])


def deep(levels):
    return {"tuple": [deep(levels - 1)]} if levels else 1


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        (deep(40), "more than 32 levels deep"),
        ({"is": "os:system", "fields": {}}, "'os:system' is no class of this jaxrb's scenes"),
        ({"is": "builtins:dict", "fields": {}}, "is no class of this jaxrb's scenes"),
        ({"float": "0x1p0", "array": 0}, "has 2 kinds"),
        ({"array": -1}, "is a 'array'"),
        ({"array": 5}, "cannot be read .IndexError"),
        ({"array": True, "x": 1}, "has 2 kinds"),
        ({"code": "1+1"}, "is a 'code'"),
        ({"float": "one"}, "cannot be read .ValueError"),
        ([1, 2], "cannot be read .AttributeError"),
        ({"is": BALL, "fields": {"strength": 1}}, "a Sphere differs in radius, strength"),
        (
            {"is": BALL, "fields": {"radius": "down"}},
            "Sphere.radius is no array of real numbers",
        ),
        ({"is": BALL, "fields": {"radius": {"array": 1}}}, "is no array of real numbers"),
        ({"is": BALL, "fields": {"radius": {"array": 0}}}, "Sphere.radius.*nan"),
    ],
)
def test_trees_that_jaxrb_did_not_write_are_refused(plain, message):
    arrays = [np.array([0.0, np.nan, 0.0]), np.array([0, 0, -9])]
    with pytest.raises(InvalidInput, match=f"^a file: .*{message}"):
        decoded(plain, arrays, "a file")


def test_a_table_names_its_columns_and_says_when_it_is_empty():
    assert table([]) == "(nothing)"
    rows = [{"name": "a", "n": 3, "x": 12.34567}, {"name": "long", "n": 12, "x": 1e-7}]
    assert table(rows, {"name": "who", "x": "error"}).splitlines() == [
        "who     error",
        "────  ───────",
        "a        12.3",
        "long  1.0e-07",
    ]
    assert "yes" in table([{"fine": True}])
