"""The viewer's page: one file that asks for nothing, with the numbers of the run in it."""

import base64
import gzip
import hashlib
import json
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from viewer_scenes import EVIL, path_of, scene_of_all, with_events

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbError, WrongStructure
from jaxrb.view import viewer_page
from jaxrb.view.viewer_command import view as view_command
from jaxrb.view.viewer_record import record_of, record_of_arrays
from jaxrb.view.viewer_scene import bodies_of


@pytest.fixture(scope="module")
def path():
    pytest.importorskip("scipy")
    return path_of(scene_of_all())


@pytest.fixture(scope="module")
def page(path):
    return rb.view(path, title=f"All shapes {EVIL}").html


def part(page, name):
    return re.search(rf'<script id="{name}"[^>]*>(.*?)</script>', page, re.DOTALL)[1]


def numbers_of(page):
    header, blob = json.loads(part(page, "record")), gzip.decompress(base64.b64decode(part(page, "numbers")))

    def array(entry):
        count = int(np.prod(entry["shape"]))
        return np.frombuffer(blob, f"<{entry['type']}", count, entry["at"]).reshape(entry["shape"])

    return header, array


def test_facade_hands_on_the_function():
    assert callable(rb.view)
    assert rb.view.__name__ == "view"
    assert callable(rb.save_glb)


def test_page_holds_the_run_to_the_last_bit(page, path):
    header, array = numbers_of(page)
    np.testing.assert_array_equal(array(header["times"]), np.asarray(path.times, float))
    np.testing.assert_array_equal(array(header["position"]), np.asarray(path.states.position, float))
    turn = np.asarray(path.states.orientation.as_quaternion_array(), float)
    np.testing.assert_allclose(array(header["orientation"]), turn, atol=1e-6)


def test_header_has_its_schema(page, path):
    header, array = numbers_of(page)
    assert header["schema"] == 1
    assert set(header) == {
        "schema", "title", "times", "position", "orientation", "notes", "bodies", "obstacles", "surfaces", "series",
        "events", "forces", "contacts",
    }  # fmt: skip
    assert len(header["bodies"]) == path.scene.count
    for body in header["bodies"] + header["obstacles"]:
        assert (
            {"name", "note", "parts"}
            <= set(body)
            <= {"name", "note", "parts", "plane", "ball", "box", "hull"}
        )
        for piece in body["parts"]:
            surface = header["surfaces"][piece["surface"]]
            assert array(surface["triangles"]).max() < len(array(surface["vertices"]))
            assert np.linalg.norm(piece["orientation"]) == pytest.approx(1.0, abs=1e-6)
    for chart in header["series"]:
        for line in chart["lines"]:
            assert array(line["values"]).shape == array(header["times"]).shape


def test_names_and_titles_are_never_markup(page):
    assert "<img" not in page
    assert page.count("</script>") == 4  # those of the page's own scripts
    header, _ = numbers_of(page)
    assert EVIL in [body["name"] for body in header["bodies"]]
    assert "All shapes &lt;/script&gt;" in page


def test_page_asks_for_nothing(page):
    assert "default-src 'none'" in page
    plain = re.sub(r'<script id="(numbers|program)".*?</script>', "", page, flags=re.DOTALL)
    addresses = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+[^\s\"')]*", plain))
    assert not addresses
    assert not re.search(r"<[^>]*\s(?:src|href|action)\s*=", plain.split('<script id="record"')[0])
    modules = json.loads(gzip.decompress(base64.b64decode(part(page, "program"))))
    for name, source in modules.items():
        wanted = re.findall(r"""\bfrom\s*["']([^"']+)["']""", source)
        assert set(wanted) <= set(modules), name
        if name.startswith("jaxrb/"):
            assert not re.search(r"\bfetch\(|XMLHttpRequest|WebSocket|innerHTML|\beval\(|import\(", source), (
                name
            )


def test_page_is_small(page):
    assert len(page) - len(part(page, "numbers")) - len(part(page, "record")) < 400_000


def test_vendored_files_are_what_their_authors_published(monkeypatch, tmp_path):
    assert {file.name for file in viewer_page.VENDOR.iterdir()} == set(viewer_page.VENDORED)
    for name, digest in viewer_page.VENDORED.items():
        data = (viewer_page.VENDOR / name).read_bytes()
        assert hashlib.sha256(data).hexdigest() == digest
    assert "MIT" in viewer_page.vendored("three.LICENSE.txt")
    assert sum(file.stat().st_size for file in viewer_page.VENDOR.iterdir()) < 1_000_000
    (tmp_path / "three.core.min.js").write_text("alert(1)")
    monkeypatch.setattr(viewer_page, "VENDOR", tmp_path)
    with pytest.raises(JaxrbError, match="the file was changed"):
        viewer_page.vendored("three.core.min.js")
    with pytest.raises(JaxrbError, match="cannot be read"):
        viewer_page.vendored("three.module.min.js")


def test_own_scripts_stay_readable():
    for file in viewer_page.WEB.iterdir():
        assert file.read_text().count("\n") <= 250, file.name


def test_notebook_shows_a_frame_that_reaches_nothing(path):
    shown = rb.view(path, bounds=False)._repr_html_()
    assert 'sandbox="allow-scripts"' in shown
    assert shown.count("<") == 2  # the frame and its end: the page within is escaped
    assert "allow-same-origin" not in shown


def test_page_is_saved_whole(path, tmp_path):
    found = rb.view(path, tmp_path / "run.html", bounds=False)
    assert (tmp_path / "run.html").read_text(encoding="utf-8") == found.html
    with pytest.raises(InvalidInput, match=r"\.html"):
        found.save(tmp_path / "run.png")
    with pytest.raises(InvalidInput, match="no folder"):
        found.save(tmp_path / "away" / "run.html")


def test_what_is_no_path_of_one_world_is_refused(path):
    with pytest.raises(WrongStructure, match="is no path"):
        rb.view(path.scene)
    with pytest.raises(WrongStructure, match="many worlds"):
        rb.view(jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], path))
    with pytest.raises(WrongStructure, match="being traced"):
        jax.jit(lambda p: rb.view(p).html)(path)


def test_a_state_that_is_not_finite_is_told():
    scene = rb.Scene(rb.Body.from_shape(rb.Sphere(0.1), 1.0))
    path = path_of(scene)
    position = np.array(path.states.position)
    position[5:] = np.nan
    states = type(path.states)(
        jnp.asarray(position), path.states.orientation, path.states.velocity, path.states.angular_velocity,
        path.states.time,
    )  # fmt: skip
    broken = type(path)(path.times, states, path.final, None, scene)
    note = record_of(broken, bounds=False).header["notes"][0]
    assert note.startswith("body 0 has no finite place from")
    assert f"{float(path.times[5]):.6g}" in note
    with pytest.raises(InvalidInput, match="no finite place"):
        rb.save_glb(broken, "never.glb")


def test_forces_are_those_of_the_effects():
    scene = rb.Scene(rb.Body(2.0, 1.0), (rb.UniformGravity((0, 0, -10.0)), rb.LinearDrag(1.0)))
    record = record_of(path_of(scene, 5), forces=True, bounds=False)
    (gravity,) = record.header["forces"]  # nothing moves, so there is no drag
    values = np.frombuffer(bytes(record.numbers), "<f4", 15, gravity["values"]["at"]).reshape(5, 1, 3)
    assert gravity["name"] == "UniformGravity"
    np.testing.assert_allclose(values, np.broadcast_to([0, 0, -20.0], (5, 1, 3)))


def test_impacts_are_those_that_happened():
    scene = rb.Scene(rb.Body.from_shape(rb.Sphere(0.1), 1.0))
    events = record_of(with_events(path_of(scene)), bounds=False).header["events"]
    assert events["time"]["shape"] == [2]
    assert events["impulse"]["shape"] == [2, 3]


def test_saved_arrays_become_a_page_and_wrong_ones_are_named(tmp_path, capsys):
    k, n = 6, 2
    turn = np.tile([1.0, 0, 0, 0], (k, n, 1))
    arrays = {
        "time": np.arange(k) * 0.1,
        "position": np.zeros((k, n, 3)),
        "orientation_wxyz": turn,
        "energy": np.arange(k),
    }
    file = tmp_path / "run.npz"
    np.savez(file, **arrays)
    view_command(str(file), out=tmp_path / "run.html", json=True)
    assert json.loads(capsys.readouterr().out)["files"]
    header, array = numbers_of((tmp_path / "run.html").read_text())
    assert "no shapes" in header["bodies"][0]["note"]
    np.testing.assert_allclose(array(header["series"][0]["lines"][0]["values"]), np.arange(k))
    with pytest.raises(InvalidInput, match="do not fit 1 bodies"):
        record_of_arrays(arrays, bodies_of(rb.Scene(rb.Body(1.0, 1.0))), [], "run.npz")
    with pytest.raises(InvalidInput, match="'position'"):
        record_of_arrays({"time": arrays["time"]}, [], [], "run.npz")
    with pytest.raises(InvalidInput, match="--scene"):
        view_command(str(file), out=tmp_path / "run.html", png=tmp_path / "run.png")
    with pytest.raises(InvalidInput, match="no such file"):
        view_command(str(tmp_path / "none.npz"))


def test_pictures_from_the_side_need_no_display(tmp_path):
    pytest.importorskip("matplotlib")
    image = pytest.importorskip("PIL.Image")
    from jaxrb.view.viewer_pictures import save_gif, save_png

    path = path_of(rb.Scene(rb.Body.from_shape(rb.Box((0.1, 0.2, 0.3)), 500.0)), 4)
    assert save_png(path, tmp_path / "run.png").stat().st_size > 5000
    with image.open(save_gif(path, tmp_path / "run.gif")) as moving:
        assert moving.n_frames == 4
