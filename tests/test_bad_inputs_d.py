"""D. Bad meshes: each number of the project's list of bad inputs, 51 to 75, by the door that users take.

One case a number; io/test_mesh_files.py and geometry/test_mesh.py have many of each kind, and the fuzz.
"""

import json
import pathlib
import sys

import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbWarning, LimitExceeded

sys.path.insert(0, str(pathlib.Path(__file__).parent / "io"))
import mesh_files as files
import mesh_samples as samples

BOX = samples.box()
VERTICES, TRIANGLES = BOX
DOCUMENT, BLOB = files.glb_document(*BOX)


def vertices(index, value):
    moved = VERTICES.copy()
    moved[index] = value
    return moved


def document(**changes):
    """A GLB file with parts of its JSON changed, by path."""
    found = json.loads(json.dumps(DOCUMENT))
    for path, value in changes.items():
        *way, last = path.split("__")
        at = found
        for key in way:
            at = at[int(key)] if isinstance(at, list) else at[key]
        at[last] = value
    return files.glb(found, BLOB)


PLANE = VERTICES * (1, 1, 0)
LINE = np.outer(np.arange(8), (1, 2, 3))
OPEN = TRIANGLES[:-1]
FINNED = np.concatenate([TRIANGLES, [[TRIANGLES[0, 0], TRIANGLES[0, 1], 8]]])
REFUSED = {
    "51 empty": ("stl", b"", "the file is empty"),
    "52 truncated": ("stl", files.binary_stl(*BOX)[:-60], "no whole binary STL"),
    "53 random": ("stl", np.random.default_rng(0).bytes(4000), "no whole binary STL"),
    "54 count of 2^32 - 1": ("stl", files.binary_stl(*BOX, count=2**32 - 1), "says 4294967295 triangles"),
    "55 one point": ("obj", files.obj(0 * VERTICES, TRIANGLES), "every triangle names a vertex twice"),
    "56 a line": ("obj", files.obj(LINE, TRIANGLES), "line|without area|no triangles"),
    "57 a plane": ("obj", files.obj(PLANE, TRIANGLES), "plane|plate"),
    "58 NaN": ("obj", files.obj(vertices(3, np.nan), TRIANGLES), "vertex 3 has x = nan"),
    "59 infinite": ("ply", files.ply(vertices(3, np.inf), TRIANGLES), "vertex 3 has x = inf"),
    "60 index out of range": ("ply", files.ply(VERTICES, np.where(TRIANGLES == 7, 9, TRIANGLES)), "names vertex 9"),
    "61 negative index": ("obj", files.obj(*BOX).replace(b"f ", b"f -99//1 ", 1), "names vertex -99"),
    "62 open": ("obj", files.obj(VERTICES, OPEN), "3 edges belong to one triangle only.*convex_hull=True"),
    "67 beyond the floating range": ("obj", files.obj(1e40 * VERTICES, TRIANGLES), "larger units|floating range"),
    "70 edge of three": (
        "obj", files.obj(np.concatenate([VERTICES, [(3, 3, 3)]]), FINNED), "belong to (one|three or more) triangle"
    ),
    "72 URI of another file": ("glb", document(buffers__0__uri="../../etc/passwd"), "other files are never opened"),
    "73 count that lies": ("glb", document(accessors__0__count=2**31), "the count lies or it is cut"),
    "74 nodes in a ring": ("glb", document(nodes__0__children=[0]), "reached twice: a cycle"),
    "75 packed": ("stl", b"\x1f\x8b" + files.binary_stl(*BOX), "gzip archive; unpack"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::jaxrb.errors.JaxrbWarning")
@pytest.mark.parametrize("case", REFUSED)
def test_bad_mesh_is_refused(case, tmp_path):
    suffix, data, message = REFUSED[case]
    path = tmp_path / f"part.{suffix}"
    path.write_bytes(data)
    with pytest.raises(InvalidInput, match=message) as found:
        rb.Body.from_mesh(path, density=1.0)
    assert path.name in str(found.value)


SHIFT = np.concatenate([VERTICES, VERTICES + 1e-3])
DOUBTED = {
    "63 inside out": (VERTICES, TRIANGLES[:, ::-1], "turned|inside out"),
    "64 mixed winding": (VERTICES, np.concatenate([TRIANGLES[:1, ::-1], TRIANGLES[1:]]), "wound"),
    "65 doubled shell": (VERTICES, np.concatenate([TRIANGLES, TRIANGLES]), "twice|repeat|same"),
    "66 zero area": (VERTICES, np.concatenate([TRIANGLES, [[0, 0, 1]]]), "area|dropped"),
    "67 size of 1e20": (1e20 * VERTICES, TRIANGLES, "unit"),
    "67 size of 1e-12": (1e-12 * VERTICES, TRIANGLES, "unit"),
}


@pytest.mark.parametrize("case", DOUBTED)
def test_doubtful_mesh_is_warned_of_and_mended_as_said(case):
    points, triangles, message = DOUBTED[case]
    with pytest.warns(JaxrbWarning, match=message):
        mesh = rb.TriangleMesh(points, triangles)
    expected = float(rb.TriangleMesh(VERTICES, TRIANGLES).mass_properties(1.0).mass)
    if "67" not in case:
        assert float(mesh.mass_properties(1.0).mass) == pytest.approx(expected)


def test_open_surface_fills_its_hull_where_asked_to():
    """[62]"""
    mesh = rb.TriangleMesh(VERTICES, OPEN)
    assert float(rb.Body.from_mesh(mesh, 1.0, convex_hull=True).mass) == pytest.approx(1.0, rel=1e-6)


def test_mesh_far_from_its_origin_keeps_its_inertia():
    """[68]"""
    near, far = (rb.Body.from_mesh(rb.TriangleMesh(VERTICES + d, TRIANGLES), 1.0) for d in (0.0, 1e6))
    assert np.asarray(far.inertia.six()) == pytest.approx(np.asarray(near.inertia.six()), abs=1e-8)


def test_more_triangles_than_allowed_are_refused(tmp_path):
    """[69]"""
    path = tmp_path / "a.stl"
    path.write_bytes(files.binary_stl(*BOX))
    with pytest.raises(LimitExceeded, match=r"a\.stl: 12 triangles are more than max_triangles=11"):
        rb.Body.from_mesh(path, 1.0, max_triangles=11)


def test_transforms_of_many_instances_are_applied(tmp_path):
    """[71] Two placed copies; turned, scaled and nested ones are in io/test_mesh_files.py."""
    path = tmp_path / "a.glb"
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
    path.write_bytes(document(nodes=nodes, scenes=[{"nodes": [0, 1]}]))
    body = rb.Body.from_mesh(path, 1.0)
    assert float(body.mass) == pytest.approx(2.0, rel=1e-6)
    assert np.asarray(body.center_of_mass)[0] == pytest.approx(VERTICES[:, 0].mean() + 2.5, rel=1e-6)


def test_what_is_no_mesh_is_refused():
    with pytest.raises(rb.WrongStructure, match=r"Body\.from_mesh: 5 is no mesh"):
        rb.Body.from_mesh(5, 1.0)
