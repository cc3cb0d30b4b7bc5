"""A run as GLB: read back by our own reader, by trimesh, and key by key."""

import json

import numpy as np
import pytest
from viewer_scenes import path_of, scene_of_all

import jaxrb as rb
from jaxrb.errors import InvalidInput
from jaxrb.io.mesh_glb import read_glb
from jaxrb.view.glb_animation import glb_of
from jaxrb.view.viewer_scene import bodies_of
from jaxrb.view.viewer_surfaces import matrix_of, quaternion_of


@pytest.fixture(scope="module")
def path():
    pytest.importorskip("scipy")
    return path_of(scene_of_all())


@pytest.fixture(scope="module")
def data(path):
    return glb_of(path)


@pytest.fixture(scope="module")
def document(data):
    size = int.from_bytes(data[12:16], "little")
    blob = data[20 + size + 8 :]
    tree = json.loads(data[20 : 20 + size])

    def array(number):
        accessor = tree["accessors"][number]
        view = tree["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        return np.frombuffer(blob, kind, width * accessor["count"], view["byteOffset"]).reshape(-1, width)

    return tree, array


def points_at_start(path):
    """What the bodies look like at the first saved time, in the world."""
    turns = quaternion_of(path.states.orientation)[0]
    places = np.asarray(path.states.position, float)[0]
    return [
        np.concatenate([part.points() for part in seen.parts]) @ matrix_of(turn).T + place
        for seen, turn, place in zip(bodies_of(path.scene), turns, places)
    ]


def test_keys_are_the_saved_states(document, path):
    tree, array = document
    (animation,) = tree["animations"]
    position = np.asarray(path.states.position, float)
    matrices = np.asarray(path.states.orientation.as_matrix(), float)
    names = [seen.name for seen in bodies_of(path.scene)]
    assert len(animation["channels"]) == 2 * path.scene.count
    for channel in animation["channels"]:
        sampler, node = animation["samplers"][channel["sampler"]], tree["nodes"][channel["target"]["node"]]
        np.testing.assert_allclose(array(sampler["input"])[:, 0], path.times, atol=1e-6)
        values = array(sampler["output"])
        body = names.index(node["name"])
        if channel["target"]["path"] == "translation":
            np.testing.assert_allclose(values, position[:, body], atol=1e-6)
            np.testing.assert_allclose(node["translation"], position[0, body], atol=1e-6)
        else:
            x, y, z, w = values.T
            turned = np.array([matrix_of(q) for q in np.stack([w, x, y, z], -1).astype(float)])
            np.testing.assert_allclose(turned, matrices[:, body], atol=2e-6)
            assert (np.einsum("ki,ki->k", values[1:], values[:-1]) >= 0).all()


def test_own_reader_finds_the_bodies_where_they_start(data, path):
    vertices, _ = read_glb("run.glb", data, 10**6)
    upright = vertices @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T  # y up in the file
    start = 0
    for points in points_at_start(path):
        np.testing.assert_allclose(upright[start : start + len(points)], points, atol=2e-6)
        start += len(points)


def test_trimesh_reads_the_same_bodies(data, path, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "run.glb").write_bytes(data)
    scene = trimesh.load(tmp_path / "run.glb")
    for seen, points in zip(bodies_of(path.scene), points_at_start(path)):
        found = []
        for child in scene.graph.transforms.children[seen.name]:
            matrix, geometry = scene.graph[child]
            found.append(trimesh.transform_points(scene.geometry[geometry].vertices, matrix))
        upright = np.concatenate(found) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T
        np.testing.assert_allclose(upright.min(axis=0), points.min(axis=0), atol=2e-6)
        np.testing.assert_allclose(upright.max(axis=0), points.max(axis=0), atol=2e-6)


def test_poor_names_and_times_are_refused(path, tmp_path):
    with pytest.raises(InvalidInput, match=r"\.glb"):
        rb.save_glb(path, tmp_path / "run.gltf")
    assert rb.save_glb(path, tmp_path / "run.glb").stat().st_size > 1000
    twice = type(path)(np.zeros(len(path.times)), path.states, path.final, None, path.scene)
    with pytest.raises(InvalidInput, match="same time"):
        rb.save_glb(twice, tmp_path / "run.glb")
