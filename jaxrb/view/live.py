"""`rb.view_live`: a window in the browser that follows a run while it runs, served by viser on this machine alone."""

import contextlib
import sys
import threading
import time
import webbrowser
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxrb.body.state import State
from jaxrb.checks import is_concrete
from jaxrb.errors import InvalidInput, JaxrbError, WrongStructure
from jaxrb.scene.path import Path
from jaxrb.scene.scene import Scene
from jaxrb.view.glb_animation import COLOURS, STILL, square_under
from jaxrb.view.viewer_record import check_path
from jaxrb.view.viewer_scene import Seen, bodies_of, obstacles_of
from jaxrb.view.viewer_surfaces import Part, quaternion_of

HOST = "127.0.0.1"  # never another: whoever reaches the port can look on and press its buttons
_RATE = 60.0  # [1/s] most pictures sent while a path plays
_MOST_BODIES = 2000  # each is a node and a mesh of its own in the browser


class LiveView:
    """A window that is open until `close`. `url` is where a browser on this machine finds it.

    `show(state)` sends bodies to where a state has them: call it from a loop of your own. `play` shows saved states
    over and over, with a player in the window. Also a context manager, which closes it.
    """

    def __init__(self, bodies: Sequence[Seen], obstacles: Sequence[Seen], title: str = "", port: int = 8080):
        if len(bodies) > _MOST_BODIES:
            raise InvalidInput(
                f"view_live: {len(bodies)} bodies are more than a browser follows, {_MOST_BODIES}; write a page by "
                "rb.view, or show fewer"
            )
        if not 0 <= port < 2**16:
            raise InvalidInput(f"view_live: port is {port}; give 0 (any that is free) to 65535")
        self._server = _server(port)
        self.url = f"http://{HOST}:{self._server.get_port()}"
        self._done, self._player = threading.Event(), None
        scene, gui = self._server.scene, self._server.gui
        scene.set_up_direction("+z")
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.set_panel_label(title or "Run")
        self._frames = [
            # By number: a name with a slash would be a path of viser's.
            scene.add_frame(f"/bodies/{i}", show_axes=False)
            for i in range(len(bodies))
        ]
        self._labels = []
        for i, seen in enumerate(bodies):
            self._draw(f"/bodies/{i}", seen.parts, COLOURS[i % len(COLOURS)])
            self._labels.append(scene.add_label(f"/bodies/{i}/name", seen.name, visible=False))
        for i, seen in enumerate(obstacles):
            self._draw(f"/still/{i}", seen.parts, STILL)
        shown = gui.add_checkbox("names", False)
        self._when(shown, lambda: self._name_bodies(shown.value))
        notes = [f"{seen.name}: {seen.note}" for seen in bodies if seen.note]
        if notes:  # as text of a box, which viser does not read as markup
            gui.add_text("drawn", "; ".join(notes), disabled=True)

    def show(self, state: State) -> None:
        """Send bodies to where a state of the scene has them (position [m], orientation)."""
        if not all(is_concrete(leaf) for leaf in jax.tree.leaves(state)):
            raise WrongStructure(
                "LiveView.show: the state is being traced by jit, grad or vmap; show it outside"
            )
        self._send(np.asarray(state.position, float), quaternion_of(state.orientation))

    def play(self, times: np.ndarray, position: np.ndarray, orientation: np.ndarray) -> None:
        """Show saved states in turn: `times` (k) [s], `position` (k, n, 3) [m], `orientation` (k, n, 4) wxyz.

        Each as it was saved, none in between; the player has a time, a speed and a box to stop it.
        """
        if self._player is not None:
            raise InvalidInput("LiveView.play: something plays already; open another window")
        self._send(position[0], orientation[0])
        if len(times) == 1:
            return
        gui, first, span = self._server.gui, float(times[0]), float(times[-1] - times[0])
        running = gui.add_checkbox("play", True)
        pace = gui.add_slider("speed", min=-4.0, max=4.0, step=0.5, initial_value=0.0, hint="powers of two")
        clock = gui.add_slider("time [s]", min=0.0, max=span, step=span / 1e4, initial_value=0.0)

        def loop() -> None:
            at, last, told = 0.0, time.perf_counter(), -1
            while not self._done.wait(1.0 / _RATE):
                now = time.perf_counter()
                if running.value:
                    at = (at + (now - last) * 2.0**pace.value) % span
                    clock.value = at
                else:
                    at = clock.value
                last = now
                k = int(np.searchsorted(times - first, at, side="right")) - 1
                if k != told:
                    self._send(position[k], orientation[k])
                    told = k

        self._player = threading.Thread(target=loop, daemon=True)
        self._player.start()

    def wait(self) -> None:
        """Keep the window open until Ctrl-C or `close`."""
        try:
            while not self._done.wait(0.5):
                pass
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Close the window and give the port back."""
        self._done.set()
        if self._player is not None:
            self._player.join()
        with contextlib.redirect_stdout(sys.stderr):
            self._server.stop()

    def __enter__(self) -> "LiveView":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, position: np.ndarray, turn: np.ndarray) -> None:
        count = len(self._frames)
        if position.shape != (count, 3) or turn.shape != (count, 4):
            raise InvalidInput(
                f"LiveView: positions {position.shape} and orientations {turn.shape} do not fit {count} bodies; give "
                "those of one world of the scene that is shown"
            )
        good = np.isfinite(np.concatenate([position, turn], axis=-1)).all(axis=-1)
        with self._server.atomic():
            for frame, there, place, wxyz in zip(self._frames, np.atleast_1d(good), position, turn):
                frame.visible = bool(there)  # what has no finite place is not drawn at its last one
                if there:
                    frame.position, frame.wxyz = place, wxyz
        self._server.flush()

    def _draw(self, where: str, parts: Sequence[Part], colour: tuple[int, int, int]) -> None:
        for j, part in enumerate(parts):
            vertices = np.asarray(part.surface.vertices * part.scale, np.float32)
            self._server.scene.add_mesh_simple(
                f"{where}/{j}", vertices, part.surface.triangles.astype(np.uint32), color=colour, side="double",
                position=part.position, wxyz=part.orientation,
            )  # fmt: skip

    def _name_bodies(self, shown: bool) -> None:
        for label in self._labels:
            label.visible = shown

    @staticmethod
    def _when(control: Any, action: Any) -> None:
        control.on_update(lambda _: action())


def view_live(what: Path | Scene, state: State | None = None, *, title: str = "", port: int = 8080,
              browser: bool = False) -> LiveView:  # fmt: skip
    """Open a live window (extra [live]) of a path, which plays over and over, or of a scene, to be fed by `show`.

        window = rb.view_live(scene, state)
        for _ in range(1000):
            state = step(state)
            window.show(state)

    It listens on 127.0.0.1 only, and viser's own way to share a window over its makers' server is shut. `rb.view`
    writes a page instead, which needs neither a server nor this process.

    Args:
        what: a path of one world, or a scene.
        state: of that scene, where its bodies stand at first.
        title: heading of the panel.
        port: where to listen; the next that is free if it is taken, any for 0.
        browser: open it in this machine's browser.

    Raises:
        JaxrbError: viser is not installed. WrongStructure: neither a path of one world nor a scene; a scene without a
            state, or one that is traced. InvalidInput: a port that is none, more bodies than a browser follows.
    """
    if isinstance(what, Scene):
        if state is None:
            raise WrongStructure("view_live: a scene needs a state; give view_live(scene, state)")
        places = np.asarray(state.position, float)
    else:
        check_path("view_live", what)
        if state is not None:
            raise WrongStructure("view_live: a path has its own states; give a state only beside a scene")
        places = np.asarray(what.states.position, float)
    scene = what if isinstance(what, Scene) else what.scene
    window = LiveView(bodies_of(scene), standing(scene, places), title, port)
    try:
        if state is not None:
            window.show(state)
        elif isinstance(what, Path):
            turn = quaternion_of(what.states.orientation)
            window.play(np.asarray(what.times, float), places, turn)
    except BaseException:
        window.close()
        raise
    if browser:
        webbrowser.open(window.url)
    return window


def standing(scene: Scene, places: np.ndarray) -> list[Seen]:
    """What stands still; half-spaces as squares about where bodies are, `places` (…, 3) [m]."""
    finite = places[np.isfinite(places).all(axis=-1)].reshape(-1, 3)
    return [square_under(seen, finite if len(finite) else np.zeros((1, 3))) for seen in obstacles_of(scene)]


def _server(port: int) -> Any:
    try:
        import viser
    except ImportError as error:
        raise JaxrbError("view_live needs viser: pip install jaxrb[live]") from error

    class Server(viser.ViserServer):
        """One that no message of a browser can make reachable from elsewhere."""

        def request_share_url(self, verbose: bool = True) -> None:
            return None

    with contextlib.redirect_stdout(sys.stderr):  # where it announces itself; a command's answer may be JSON
        server = Server(host=HOST, port=port, verbose=False)
    if server.get_host() != HOST:
        server.stop()
        raise JaxrbError(f"view_live: viser listens on {server.get_host()}, not on {HOST}; not shown")
    return server
