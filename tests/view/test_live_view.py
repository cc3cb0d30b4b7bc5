"""The live window: who can reach it, and what it is sent. Skipped where viser (extra [live]) is not installed."""

import pathlib
import re
import time

import jax
import numpy as np
import pytest
from viewer_scenes import EVIL

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbError, WrongStructure
from jaxrb.view import live

SOCKETS = pathlib.Path("/proc/net/tcp"), pathlib.Path("/proc/net/tcp6")
LISTENS = "0A"


@pytest.fixture(scope="module")
def scene():
    bodies = (
        rb.Body.from_shape(rb.Box((0.1, 0.2, 0.3)), 500.0, name=f"a/b {EVIL}"),
        rb.Body(1.0, (1.0, 2.0, 2.5)),
    )
    return rb.Scene(bodies, (rb.UniformGravity(), rb.RigidContact(rb.HalfSpace(), friction=0.5, bodies=(0,))))


@pytest.fixture(scope="module")
def window(scene):
    pytest.importorskip("viser", reason="the live window needs viser, the extra [live]")
    with rb.view_live(scene, scene.state(position=[(0, 0, 1), (1, 0, 1)]), port=0) as shown:
        yield shown


def port_of(window):
    return int(re.fullmatch(r"http://127\.0\.0\.1:(\d+)", window.url)[1])


@pytest.fixture(scope="module")
def browser(window):
    """What a browser is sent: a function that collects messages until one fulfils a condition."""
    import msgspec
    import viser
    import zstandard
    from websockets.sync.client import connect

    def messages(raw):
        size = int.from_bytes(raw[8:16], "little")
        return msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(raw[16 : 16 + size]))[
            "messages"
        ]

    with connect(
        window.url.replace("http", "ws"), subprotocols=[f"viser-v{viser.__version__}"], max_size=None
    ) as socket:

        def until(enough, seconds=10.0):
            found, end = [], time.monotonic() + seconds
            while not enough(found):
                found += messages(socket.recv(timeout=max(end - time.monotonic(), 0.01)))
            return found

        yield until


def told(messages, kind, name):
    """The last message of a kind about a node."""
    return next((m for m in reversed(messages) if m["type"] == kind and m.get("name") == name), None)


def test_listens_on_this_machine_alone(window):
    if not SOCKETS[0].exists():
        pytest.skip("sockets are listed under /proc on Linux")
    rows = [line.split() for file in SOCKETS if file.exists() for line in file.read_text().splitlines()[1:]]
    own = [
        row[1].split(":")[0]
        for row in rows
        if row[3] == LISTENS and int(row[1].split(":")[1], 16) == port_of(window)
    ]
    assert own == ["0100007F"]  # 127.0.0.1, the bytes as the processor keeps them


def test_cannot_be_shared_over_the_network(window):
    assert window._server.request_share_url() is None


def test_bodies_shapes_and_poses_are_sent(window, browser, scene):
    sent = browser(lambda found: told(found, "SetPositionMessage", "/bodies/1"))
    names = {m.get("name") for m in sent}
    assert {"/bodies/0/0", "/bodies/1/0", "/still/0/0"} <= names
    (label,) = [m for m in sent if m.get("name") == "/bodies/0/name" and "props" in m]
    assert label["props"]["text"] == f"a/b {EVIL}"  # text, wherever it comes from
    turn = (0.6, 0.0, 0.8, 0.0)
    state = scene.state(position=[(0.25, 0, 2), (1.5, -3, 1)], orientation=[turn, (1, 0, 0, 0)])
    window.show(state)
    sent = browser(
        lambda found: (
            all(told(found, "SetPositionMessage", f"/bodies/{i}") for i in range(2))
            and told(found, "SetOrientationMessage", "/bodies/0")
        )
    )
    for i, place in enumerate([(0.25, 0, 2), (1.5, -3, 1)]):
        np.testing.assert_allclose(told(sent, "SetPositionMessage", f"/bodies/{i}")["position"], place)
    np.testing.assert_allclose(told(sent, "SetOrientationMessage", "/bodies/0")["wxyz"], turn, atol=1e-6)


def test_what_has_no_place_is_hidden(window, browser, scene):
    window._send(np.array([[np.nan, 0, 0], [0.0, 0, 0]]), np.eye(1, 4).repeat(2, axis=0))
    sent = browser(lambda found: told(found, "SetSceneNodeVisibilityMessage", "/bodies/0"))
    assert told(sent, "SetSceneNodeVisibilityMessage", "/bodies/0")["visible"] is False


def test_a_path_plays(scene):
    pytest.importorskip("viser", reason="the live window needs viser, the extra [live]")
    states = jax.tree.map(
        lambda x: np.stack([x] * 3), scene.state(position=[(0, 0, 1), (1, 0, 1)], rotation=rb.Quaternion)
    )
    path = rb.rollout(rb.Scene(scene.bodies), jax.tree.map(lambda x: x[0], states), dt=0.02, steps=2)
    seen = []
    with rb.view_live(path, port=0) as shown:
        send, shown._send = shown._send, lambda place, turn: seen.append(place) or send(place, turn)
        end = time.monotonic() + 5
        while len(seen) < 4 and time.monotonic() < end:
            time.sleep(0.02)
    assert len(seen) >= 4
    assert shown._player is not None
    assert not shown._player.is_alive()


def test_what_cannot_be_shown_is_refused(scene):
    with pytest.raises(WrongStructure, match="needs a state"):
        rb.view_live(scene)
    with pytest.raises(WrongStructure, match="is no path"):
        rb.view_live([1, 2])
    with pytest.raises(InvalidInput, match="port is 70000"):
        live.LiveView([], [], port=70000)
    with pytest.raises(InvalidInput, match="more than a browser follows"):
        live.LiveView([None] * 2001, [])


def test_a_state_of_another_scene_is_refused(window):
    with pytest.raises(InvalidInput, match="do not fit 2 bodies"):
        window.show(rb.Scene(rb.Body(1.0, 1.0)).state())


def test_without_viser_says_what_to_install(scene, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(JaxrbError, match=r"jaxrb\[live\]"):
        rb.view_live(scene, scene.state(position=[(0, 0, 1), (1, 0, 1)]))
