"""E. Robot files and configurations: numbers 76 to 84 of the project's list of bad inputs.

jaxrb reads no MJCF or URDF: the cases wait for the readers. Where a kind can already arrive by another door it is
tested there: counts that lie and paths in io/test_mesh_files.py, names and units below.
"""

import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, UnknownName

WAITING = {
    "76 entity bomb": "an XML file whose entities unfold to more than a limit",
    "77 external entity": "an XML file that names another file or address",
    "78 depth of 50 000": "elements nested deeper than a limit",
    "79 include outside": "a file that includes one outside its folder, or itself",
    "80 replicate 1e8": "a count of bodies beyond a limit",
    "81 height field of 1e10": "a grid beyond a limit",
    "82 unsupported element": "an element that jaxrb has no counterpart of",
    "83 path of a mesh outside": "../ or an absolute path outside the file's folder",
    "84 duplicate names": "two bodies of one name, a text that is no number",
}


@pytest.mark.parametrize("case", WAITING)
def test_bad_robot_file_is_refused(case):
    if not any(hasattr(rb, name) for name in ("read_mjcf", "read_urdf", "read_robot")):
        pytest.skip(f"no reader of MJCF or URDF yet: {WAITING[case]}")
    pytest.fail("a reader of robots is here: write this case")


def test_unknown_names_and_units_are_refused_with_what_there_is(tmp_path):
    """[84] as far as it can arrive today."""
    with pytest.raises(UnknownName, match="did you mean RungeKutta4"):
        rb.rollout(
            rb.Scene(rb.Body(1.0, 1.0)),
            rb.Scene(rb.Body(1.0, 1.0)).state(),
            dt=1.0,
            steps=1,
            method="RungeKuta",
        )
    file = tmp_path / "a.csv"
    head = "# frame: body\ntime [s], wx [rad/s], wy [rad/s], wz [rad/s]\n"
    for text, message in (
        (head.replace("wx [rad/s]", "wx [turns]"), "unit 'turns'; write it as"),
        (head.replace("wy [rad/s]", "wx [rad/s]"), "column 'wx' stands there twice"),
        (f"{head}0, 1, nan, 3\n1, 1, 1, 1\n", "'angular_velocity' is nan"),
        (f"{head}0, 1, two, 3\n", "line 3, column 'wy' is 'two', not a number"),
    ):
        file.write_text(text)
        with pytest.raises(InvalidInput, match=message) as found:
            rb.read_recording(file)
        assert "a.csv" in str(found.value)
