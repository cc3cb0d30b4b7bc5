"""Mesh files: what is read is what was written; what cannot be right is refused by name."""

import copy
import os
import time
import tracemalloc
import warnings

import mesh_files as files
import mesh_samples as samples
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbError, JaxrbWarning, LimitExceeded
from jaxrb.io import read_mesh

TORUS = samples.torus(around=12, across=8)
FORMATS = {
    "binary.stl": files.binary_stl(*TORUS),
    "text.stl": files.text_stl(*TORUS),
    "positive.obj": files.obj(*TORUS),
    "negative.obj": files.obj(*TORUS, negative=True),
    "text.ply": files.ply(*TORUS, order="ascii"),
    "little.ply": files.ply(*TORUS),
    "big.ply": files.ply(*TORUS, order="binary_big_endian"),
    "one.glb": files.glb(*files.glb_document(*TORUS)),
}
SINGLE = ("binary.stl", "one.glb")  # formats that keep 32-bit floats


@pytest.fixture
def written(tmp_path):
    """`written(name, data)`: the path of a file that holds these bytes."""

    def write(name, data):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_read_is_what_was_written(name, written):
    vertices, triangles = TORUS
    mesh = read_mesh(written(name, FORMATS[name]))
    expected = vertices.astype(np.float32).astype(float) if name in SINGLE else vertices
    assert np.array_equal(mesh.corners(), expected[triangles])
    assert mesh.is_closed
    assert mesh.name == name


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_files_of_another_program_are_read(suffix, tmp_path):
    """Written by trimesh, in its own dialect of each format; its volume is the check."""
    trimesh = pytest.importorskip("trimesh")
    part = trimesh.creation.annulus(0.3, 0.5, 0.2)
    part.export(tmp_path / f"part.{suffix}")
    found = rb.Body.from_mesh(tmp_path / f"part.{suffix}", density=700.0)
    assert float(found.mass) == pytest.approx(700.0 * part.volume, rel=1e-6)


def test_polygons_are_cut_into_triangles(written):
    """A cube of six squares: of quads in OBJ and PLY, with a pentagon roof that has a corner in an edge."""
    vertices, _ = samples.box()
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    meshes = [read_mesh(written("a.obj", files.obj(vertices, quads)))]
    meshes += [
        read_mesh(written("a.ply", files.ply(vertices, quads, o))) for o in ("ascii", "binary_big_endian")
    ]
    split = np.concatenate([vertices, [vertices[[4, 5]].mean(0)]])
    pentagons = [quads[0], [8, 5, 7, 6, 4], [0, 1, 5, 8, 4], *quads[3:]]
    meshes += [read_mesh(written("b.obj", files.obj(split, pentagons)))]
    meshes += [
        read_mesh(written("b.ply", files.ply(split, pentagons, o))) for o in ("ascii", "binary_big_endian")
    ]
    for mesh in meshes:
        assert float(mesh.mass_properties(1.0).mass) == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254), ("ft", 0.3048)])
def test_unit_scales_lengths(unit, metres, written):
    path = written("a.stl", FORMATS["text.stl"])
    one = float(rb.Body.from_mesh(path, density=1.0).mass)
    assert float(rb.Body.from_mesh(path, density=1.0, unit=unit).mass) == pytest.approx(one * metres**3)


def test_part_in_millimetres_asks_for_its_unit(written):
    path = written("part.stl", files.text_stl(1e5 * TORUS[0], TORUS[1]))
    with pytest.warns(JaxrbWarning, match=r"part.stl.*unit='mm'"):
        read_mesh(path)


# --- refusals -------------------------------------------------------------------------------------------------------


def refused(path, message, error=InvalidInput, **options):
    with pytest.raises(error, match=message) as found:
        rb.Body.from_mesh(path, density=1.0, **options)
    assert str(path.name) in str(found.value)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_empty_and_random_files_are_refused(suffix, written):
    refused(written(f"a.{suffix}", b""), "empty")
    refused(written(f"b.{suffix}", b"\n\n  "), "empty")
    noise = np.random.default_rng(0).bytes(5000)
    refused(written(f"c.{suffix}", noise), "whole binary STL|no PLY|no GLB|no element of a polygon mesh")


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("share", [0.05, 0.5, 0.98])
def test_cut_files_are_refused(name, share, written):
    data = FORMATS[name]
    refused(
        written(name, data[: int(share * len(data))]), "cut|corners|no triangles|belong|not a whole number"
    )


@pytest.mark.parametrize("magic", [b"PK\x03\x04", b"\x1f\x8b", b"BZh"])
def test_packed_files_are_refused(magic, written):
    refused(written("a.stl", magic + FORMATS["binary.stl"]), "archive; unpack")
    refused(written("a.stl.gz", magic), "unpack or convert")


def test_stl_count_that_lies_is_refused(written):
    data = files.binary_stl(*TORUS, count=2**32 - 1)
    refused(written("a.stl", data), "says 4294967295 triangles, which take 214748364834")


def test_stl_text_that_is_damaged_is_refused(written):
    good = FORMATS["text.stl"]
    refused(written("a.stl", good.replace(b"endloop", b"endlop", 1)), "'endloop' is there 191 times, not 192")
    refused(
        written("b.stl", good.replace(b"  vertex", b"  vertex 1", 1)), "2305 numbers can be read, not 2304"
    )
    refused(written("c.stl", good.replace(b"normal 0", b"normal zero", 1)), "numbers can be read")
    refused(
        written("d.stl", good.replace(b"vertex  ", b"vertex ").replace(b"vertex 1.", b"vertex nan ", 1)),
        "numbers",
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"f 1//1", b"f 97//1", "triangle 0 names vertex 96, but there are 96"),
        (b"f 1//1", b"f -97//1", "line 101: a face names vertex -97, but 96"),
        (b"f 1//1", b"f 0//1", "line 101: a face names vertex 0"),
        (b"f 1//1", b"f 99999999999999999999", "line 101: '99999999999999999999' is no number of anything"),
        (b"f 1//1", b"f one", "line 101: 'one' is not a whole number"),
        (b"f 1//1 ", b"f ", "line 101: a face of 2 corners"),
        (b"v ", b"v x", r"line 5: '\S+' is not a number"),
        (b"v ", b"v nan 0 0 #", "vertex 0 has x = nan"),
        (b"v ", b"v 0 0 -inf #", "vertex 0 has z = -inf"),
        (b"v ", b"v 1 2 #", "line 5: a vertex of 2 numbers"),
        (b"o part", b"curv 1 2", "line 3: 'curv' is no element"),
    ],
)
def test_obj_that_is_damaged_is_refused(old, new, message, written):
    refused(written("a.obj", FORMATS["positive.obj"].replace(old, new, 1)), message)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"element vertex 96", b"element vertex 97", "cut|not a whole number|names vertex"),
        (b"element face 192", b"element face 4000000", "4000000 triangles are more than max_triangles"),
        (b"element face 192", b"element face 999999", "999999 .* announced"),
        (b"element face 192", b"element face 191", "belong to one triangle"),
        (b"double x", b"double u", "property 'x' of element 'vertex' is missing"),
        (b"vertex_indices", b"corners", "'vertex_indices' of element 'face' is missing"),
        (b"double y", b"double x", "declares a property twice"),
        (b"list uchar int", b"list float int", "whole numbers"),
        (b"property int part", b"property into part", "header line"),
        (b"format ", b"format other_", "header line"),
    ],
)
@pytest.mark.parametrize("name", ["text.ply", "little.ply"])
def test_ply_that_is_damaged_is_refused(name, old, new, message, written):
    error = LimitExceeded if b"4000000" in new else InvalidInput
    refused(written(name, FORMATS[name].replace(old, new, 1)), message, error)


def test_signalling_nan_is_refused(written):
    """In 8 bytes and in 4: NumPy warns where it copies one."""
    for name, data in (("little.ply", b"\1\0\0\0\0\0\xf4\x7f"), ("binary.stl", b"\1\0\xa0\x7f")):
        good = FORMATS[name]
        start = good.index(b"end_header\n") + 11 if name == "little.ply" else 84 + 12
        refused(written(name, good[:start] + data + good[start + len(data) :]), "vertex 0 has x = nan")


def damaged_glb(change):
    document, blob = files.glb_document(*TORUS)
    document = copy.deepcopy(document)
    change(document)
    return files.glb(document, blob)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["buffers"][0].update(uri="../../etc/passwd"), "other files are never opened"),
        (lambda d: d["buffers"][0].update(uri="https://example.org/a.bin"), "other files are never opened"),
        (lambda d: d["accessors"][0].update(count=2**31), "the count lies or it is cut"),
        (lambda d: d["accessors"][1].update(count=2**50), "'count' is 1125899906842624"),
        (lambda d: d["accessors"][1].update(count=-1), "'count' is -1"),
        (lambda d: d["accessors"][0].update(count=90), "names vertex 95, but there are 90"),
        (lambda d: d["accessors"][0].update(componentType=5123), "export positions as 32-bit floats"),
        (lambda d: d["accessors"][0].update(sparse={}), "sparse"),
        (lambda d: d["bufferViews"][0].update(byteLength=10**9), "the count lies or it is cut"),
        (lambda d: d["nodes"][0].update(children=[0]), "node 0 is reached twice: a cycle"),
        (lambda d: d["nodes"][0].update(children=[7]), "names node 7, but there are 1"),
        (lambda d: d["nodes"][0].update(mesh=3), r"names meshes\[3\]"),
        (lambda d: d["nodes"][0].update(scale=[1, 1]), "'scale' is .* give 3 finite numbers"),
        (lambda d: d["nodes"][0].update(rotation=[0, 0, 0, 0]), "no unit quaternion"),
        (lambda d: d["nodes"][0].update(translation=[0, float("nan"), 0]), "finite"),
        (lambda d: d["meshes"][0].update(primitives={}), "'primitives' is no list"),
        (lambda d: d["scenes"][0].update(nodes=[]), "places no triangles"),
        (lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        (lambda d: d.update(scene=5), "names scene 5"),
        (lambda d: d["meshes"][0].update(primitives=[7]), "it has no attributes"),
        (lambda d: d["accessors"][1].update(count=10), "10 corners are no whole number of triangles"),
        (
            lambda d: (d["meshes"][0]["primitives"][0].update(mode=6), d["accessors"][1].update(count=2)),
            "a strip or fan of 2 corners; three are needed",
        ),
        (lambda d: d["bufferViews"][0].update(buffer=1), "buffer 1 is not in the file itself"),
        (lambda d: d["bufferViews"][0].update(byteStride=4), "stride 4; it is damaged"),
        (lambda d: d.update(accessors=[3, 4]), r"accessors\[0\] is no object"),
        (lambda d: d.update(nodes=[4]), "'nodes' is no list of objects"),
        (lambda d: d["nodes"][0].update(mesh="first"), "names mesh first"),
        (lambda d: d["nodes"][0].update(children=0), "'children' of a node is no list"),
        (lambda d: d["nodes"][0].update(translation=[10**999, 0, 0]), "give 3 finite numbers"),
    ],
)
def test_glb_that_is_damaged_is_refused(change, message, written):
    refused(written("a.glb", damaged_glb(change)), message)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            lambda d: d[:12] + (10**6).to_bytes(4, "little") + d[16:],
            "a chunk of 1000000 bytes ends after the file",
        ),
        (lambda d: d[:16] + b"BIN\0" + d[20:], "the first chunk is not JSON"),
        (lambda d: d[:20] + b"[" + d[21:], "its JSON cannot be read"),
        (lambda d: d[:20] + b"[]" + b" " * (int.from_bytes(d[12:16], "little") - 2), "its JSON is no object"),
    ],
)
def test_glb_whose_chunks_are_damaged_is_refused(data, message, written):
    bad = data(damaged_glb(lambda d: None))
    refused(written("a.glb", bad[:8] + len(bad).to_bytes(4, "little") + bad[12:]), message)


def test_glb_without_scenes_shows_the_nodes_that_are_no_children_and_names_what_it_leaves_out(written):
    def changed(document):
        del document["scenes"], document["scene"]
        document["nodes"] = [{"children": [1], "translation": [1, 0, 0]}, {"mesh": 0, "skin": 0}]
        document["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 1})

    path = written("a.glb", damaged_glb(changed))
    with pytest.warns(JaxrbWarning) as told:
        mesh = read_mesh(path)
    said = " ".join(str(warning.message) for warning in told)
    assert "its skin (bones) is not applied" in said
    assert "1 primitives of points or lines are left out" in said
    where = np.asarray(mesh.vertices)
    assert where.mean(axis=0) == pytest.approx(
        [1 + TORUS[0][:, 0].mean(), *TORUS[0][:, 1:].mean(axis=0)], abs=1e-6
    )


def test_nodes_of_a_cycle_are_refused(written):
    def cycle(document):
        document["nodes"] = [{"mesh": 0, "children": [1]}, {"children": [2]}, {"children": [0]}]

    refused(written("a.glb", damaged_glb(cycle)), "node 0 is reached twice")


def test_too_many_nodes_are_refused(written):
    def deep(document):
        document["nodes"] = [{"children": [i + 1]} for i in range(100_001)] + [{"mesh": 0}]

    refused(written("a.glb", damaged_glb(deep)), "nodes are more than", LimitExceeded)


@pytest.mark.parametrize("name", FORMATS)
def test_more_triangles_than_allowed_are_refused(name, written):
    path = written(name, FORMATS[name])
    refused(path, "max_triangles=100", LimitExceeded, max_triangles=100)
    refused(path, "max_bytes=1000", LimitExceeded, max_bytes=1000)


def test_instances_of_a_large_mesh_count_each_time(written):
    def many(document):
        document["nodes"] = [{"mesh": 0} for _ in range(1000)]
        document["scenes"] = [{"nodes": list(range(1000))}]

    refused(
        written("a.glb", damaged_glb(many)),
        "more than max_triangles=100000",
        LimitExceeded,
        max_triangles=100_000,
    )


def test_missing_file_and_unknown_unit_are_refused(tmp_path):
    refused(tmp_path / "away.stl", "no such file")
    refused(tmp_path / "a.stl", "unit='parsec' is not known", unit="parsec")


# --- placed geometries ----------------------------------------------------------------------------------------------


def test_transforms_of_nodes_are_applied(written):
    """A turned, scaled and shifted parent with a child; an instance given by its matrix, which mirrors."""
    document, blob = files.glb_document(*samples.box((0.5, 0.5, 0.5)))
    half = np.sqrt(0.5)
    mirror = np.array([[-2, 0, 0, 30], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    document["nodes"] = [
        {
            "mesh": 0,
            "translation": [10, 0, 0],
            "rotation": [0, 0, half, half],
            "scale": [2, 1, 1],
            "children": [1],
        },
        {"mesh": 0, "translation": [3, 0, 0]},
        {"mesh": 0, "matrix": mirror.T.ravel().tolist()},
    ]
    document["scenes"][0]["nodes"] = [0, 2]
    mesh = read_mesh(written("a.glb", files.glb(document, blob)))
    pieces = [np.asarray(mesh.corners())[mesh.triangles.shells == k].reshape(-1, 3) for k in range(3)]
    centers = [0.5 * (p.min(0) + p.max(0)) for p in pieces]
    sizes = [np.ptp(p, axis=0) for p in pieces]
    # The child's 3 m along x are doubled by its parent's scale and turned to y.
    assert np.allclose(centers, [[10, 0, 0], [10, 6, 0], [30, 0, 0]], rtol=0, atol=1e-12)
    assert np.allclose(sizes, [[1, 2, 1], [1, 2, 1], [2, 1, 1]], rtol=0, atol=1e-12)
    assert float(mesh.mass_properties(1.0).mass) == pytest.approx(6.0)


def test_strips_and_fans_are_triangles(written):
    """A cube of one strip; a square pyramid of a fan and a strip."""
    vertices, _ = samples.box()
    strip = [7, 6, 5, 4, 0, 6, 2, 7, 3, 5, 1, 0, 3, 2]
    document, blob = files.glb_document(vertices, np.array(strip).reshape(-1, 1))
    document["meshes"][0]["primitives"][0]["mode"] = 5
    document["accessors"][1]["count"] = 14
    cube = read_mesh(written("a.glb", files.glb(document, blob)))
    assert float(cube.mass_properties(1.0).mass) == pytest.approx(1.0)
    corners = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
    document, blob = files.glb_document(corners, np.array([0, 1, 2, 3, 4, 1, 1, 4, 2, 3]).reshape(-1, 1))
    document["accessors"] += [copy.deepcopy(document["accessors"][1])]
    document["accessors"][1]["count"] = 6
    document["accessors"][2].update(count=4, byteOffset=12)
    document["meshes"][0]["primitives"] = [
        {"attributes": {"POSITION": 0}, "indices": 1, "mode": 6},
        {"attributes": {"POSITION": 0}, "indices": 2, "mode": 5},
    ]
    pyramid = read_mesh(written("b.glb", files.glb(document, blob)))
    assert float(pyramid.mass_properties(1.0).mass) == pytest.approx(2 / 3)


# --- fuzz -----------------------------------------------------------------------------------------------------------

EXTREMES = [
    b"nan",
    b"-1",
    b"1e400",
    b"4294967295",
    b"99999999999999999999",
    b"0",
    b"{",
    b"]",
    b"\0" * 8,
    b"\xff" * 8,
]


def damaged(data, random):
    """One to four random injuries: bytes turned, a piece cut out, doubled or moved, a number made extreme."""
    data, length = bytearray(data), len(data)
    same_length = (
        random.random() < 0.5
    )  # binary formats notice another length before they look at anything else
    for _ in range(random.integers(1, 5)):
        a, b = np.sort(random.integers(0, max(len(data), 1), 2))
        kind = random.choice([0, 3, 5]) if same_length else random.integers(6)
        if kind == 0 and len(data):
            for place in random.integers(0, len(data), random.integers(1, 20)):
                data[place] = random.integers(256)
        elif kind == 1:
            del data[a : min(b, a + 400)]
        elif kind == 2:
            data[b:b] = data[a : a + 400]
        elif kind == 3:
            extreme = EXTREMES[random.integers(len(EXTREMES))]
            a = a if random.random() < 0.5 else int(a * 800 / len(data))  # headers deserve their share
            data[a : a + (len(extreme) if same_length else random.integers(1, 9))] = extreme
        elif kind == 4 and random.random() < 0.3:
            del data[a:]
        else:
            data[min(a, 400) : min(a, 400) + 4] = random.bytes(4)
        if same_length:
            del data[length:]
    return bytes(data)


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_raise_nothing_but_our_errors(name, written):
    """JAXRB_FUZZ=1000 runs that many a format and prints what the worst of them cost."""
    count = int(os.environ.get("JAXRB_FUZZ", "60"))
    random = np.random.default_rng(list(name.encode()))
    slowest, largest, refusals = 0.0, 0, 0
    for i in range(count):
        path = written(f"{i}-{name}", random.bytes(300) if i % 50 == 0 else damaged(FORMATS[name], random))
        if count > 100:
            tracemalloc.start()
        start = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", JaxrbWarning)
                rb.Body.from_mesh(path, density=1.0)
        except JaxrbError:
            refusals += 1
        slowest = max(slowest, time.process_time() - start)
        if count > 100:
            largest = max(largest, tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    print(
        f"{name}: {count} files, {refusals} refused; slowest {slowest:.3f} s, largest {largest / 2**20:.1f} MiB"
    )
    assert refusals > count / 2
