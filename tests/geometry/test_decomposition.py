"""Convex parts of a mesh that is not convex: they fill it and leave its hollows free; files of them are not trusted."""

import mesh_samples as samples
import numpy as np
import pytest

from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.geometry import decomposition
from jaxrb.geometry.decomposition import convex_decomposition
from jaxrb.geometry.mesh import TriangleMesh


@pytest.fixture(scope="module")
def torus():
    return TriangleMesh(*samples.torus(around=16, across=8))


@pytest.fixture(scope="module")
def parts(torus):
    pytest.importorskip("coacd", reason="CoACD (extra [decompose]) is not installed")
    return convex_decomposition(torus, concavity=0.1)


def inside(parts, points, slack):
    """Whether each point (n, 3) lies in some part."""
    found = np.zeros(len(points), bool)
    for part in parts:
        a, b, c = np.moveaxis(np.asarray(part.vertices)[part.faces], 1, 0)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        found |= ((points @ normals.T - (a * normals).sum(-1)) <= slack).all(-1)
    return found


def test_parts_of_a_ring_fill_it_and_leave_its_hole_free(torus, parts):
    assert len(parts) >= 4
    surface = np.asarray(torus.corners()).mean(1)
    assert inside(parts, surface, 0.05).all()
    assert not inside(parts, np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1]], float), 0.0).any()


def test_parts_are_kept_and_found_again_by_geometry_and_settings(torus, parts, tmp_path, monkeypatch):
    first = convex_decomposition(torus, concavity=0.1, cache=tmp_path)
    (file,) = tmp_path.iterdir()

    def never(*arguments):
        raise AssertionError("decomposed again")

    with monkeypatch.context() as patch:
        patch.setattr(decomposition, "_decomposed", never)
        again = convex_decomposition(torus, concavity=0.1, cache=tmp_path)
        for other in (TriangleMesh(np.asarray(torus.vertices) * 1.001, torus.triangles), torus):
            with pytest.raises(AssertionError, match="decomposed again"):
                convex_decomposition(other, concavity=0.1 if other is not torus else 0.2, cache=tmp_path)
    for one, two, known in zip(first, again, parts, strict=True):
        assert np.array_equal(one.vertices, two.vertices)
        assert np.array_equal(one.vertices, known.vertices)  # the same seed, the same parts
    file.write_bytes(file.read_bytes()[:100])
    repaired = convex_decomposition(torus, concavity=0.1, cache=tmp_path)
    assert len(repaired) == len(first)
    assert [path.name for path in tmp_path.iterdir()] == [file.name]  # replaced whole, nothing left beside it


@pytest.mark.parametrize(
    "arrays",
    [
        {"points": np.zeros((8, 2)), "counts": np.array([8])},
        {"points": np.full((8, 3), np.nan), "counts": np.array([8])},
        {"points": np.zeros((8, 3)), "counts": np.array([9])},
        {"points": np.array([{}] * 8), "counts": np.array([8])},
        {"points": np.zeros((8, 3))},
    ],
)
def test_kept_files_that_cannot_be_right_count_as_none(arrays, tmp_path):
    np.savez(tmp_path / "a.npz", **arrays)
    assert decomposition._recall(tmp_path / "a.npz") is None


def test_what_has_no_parts_is_refused(torus, tmp_path):
    with pytest.raises(InvalidInput, match="is open"):
        convex_decomposition(TriangleMesh(torus.vertices, torus.triangles.triangles[1:]))
    with pytest.raises(WrongStructure, match="no TriangleMesh"):
        convex_decomposition(torus.convex_hull())  # pyright: ignore[reportArgumentType]
    for settings in ({"concavity": 0.0}, {"max_parts": 0}):
        with pytest.raises(InvalidInput, match=next(iter(settings))):
            convex_decomposition(torus, **settings)
