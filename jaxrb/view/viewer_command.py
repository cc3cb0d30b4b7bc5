"""`jaxrb view`: a scene or a saved run as a page, and as pictures without a display."""

import json as json_text
import sys
from pathlib import Path as File
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.errors import InvalidInput
from jaxrb.io.models.load import example_named
from jaxrb.io.npz import read_arrays
from jaxrb.io.run import run
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.example import Example
from jaxrb.scene.path import Path
from jaxrb.scene.settings import check_positive
from jaxrb.view.viewer import View
from jaxrb.view.viewer_page import page_of
from jaxrb.view.viewer_record import Record, record_of, record_of_arrays
from jaxrb.view.viewer_scene import Seen, bodies_of, obstacles_of
from jaxrb.view.viewer_surfaces import parts_of

_SAVES, _STEPS = 400, 1000  # about so many saved states; steps of a scene that names none
_MOST_BYTES = 2**31


def view(
    run_or_scene: str,
    *,
    scene: str | None = None,
    out: File | None = None,
    duration: float | None = None,
    forces: bool = False,
    png: File | None = None,
    gif: File | None = None,
    glb: File | None = None,
    live: bool = False,
    port: int = 8080,
    json: bool = False,
) -> None:
    """Write a run as one HTML page that works offline, and as pictures; or show it in a live window.

    Example: jaxrb view domino_row --out dominoes.html --gif dominoes.gif
    Example: jaxrb view run.npz --scene stack_of_10
    Example: jaxrb view run.npz --scene stack_of_10 --live

    Args:
        run_or_scene: a file that `jaxrb simulate --save` wrote, or a scene to run: a name, a Python file that
            defines scene, state and duration, or a model (.xml, .urdf).
        scene: the scene whose run the file holds, for its shapes, which the file has not; without it bodies are small
            boxes.
        out: the page (.html); by default named after the run, and none beside a live window.
        duration: [s] to run a scene for; by default its own.
        forces: hold the effects' forces ready as arrows, and those of contact at its points. A file has the latter.
        png: the bodies at the end from the side, as a picture.
        gif: the run from the side, as a moving picture.
        glb: the run as an animation for Blender.
        live: show it in a window of the browser, served on 127.0.0.1 until Ctrl-C (extra [live]).
        port: of the live window; the next that is free if it is taken.
        json: print one JSON object instead of a line.
    """
    pictures = {"png": png, "gif": gif, "glb": glb}
    for name, file in pictures.items():
        if file is not None and file.suffix.lower() != f".{name}":
            raise InvalidInput(f"--{name} {file}: give the file a name that ends in .{name}")
    if out is None and not live:
        out = File(f"{File(run_or_scene).stem}.html")
    if run_or_scene.endswith(".npz") and scene is None:
        if any(pictures.values()):
            raise InvalidInput(
                f"{run_or_scene}: holds no shapes to draw; say whose run it is by --scene NAME"
            )
        path, (record, arrays, bodies) = None, _without_scene(File(run_or_scene))
        title = File(run_or_scene).name
    else:
        path, record, title = _with_scene(run_or_scene, scene, duration, forces)
        arrays, bodies = {}, []
        _draw(path, pictures)
    written = [file for file in pictures.values() if file is not None]
    if out is not None:
        written.insert(0, View(page_of(record)).save(out))
    found: dict[str, Any] = {"files": {str(file): file.stat().st_size for file in written}}
    window = _live(path, arrays, bodies, title, port) if live else None
    if window is not None:
        found["url"] = window.url
    if json:
        print(json_text.dumps(found), flush=True)
    else:
        lines = [f"{name}: {size / 1e6:.2f} MB" for name, size in found["files"].items()]
        lines += [] if window is None else [f"{window.url} (Ctrl-C closes it)"]
        print("\n".join(lines), flush=True)
    if window is not None:
        window.wait()


def _with_scene(
    run_or_scene: str, scene: str | None, duration: float | None, forces: bool
) -> tuple[Path, Record, str]:
    """A run of a scene, or the saved one of a scene, what the page holds of it, and a title."""
    if not run_or_scene.endswith(".npz"):
        path, title, dt = _simulated(example_named(run_or_scene), duration)
        return path, record_of(path, title, forces=forces, dt=dt), title
    file = File(run_or_scene)
    path, title = _read(file, example_named(str(scene)))
    seen = bodies_of(path.scene), obstacles_of(path.scene)
    return path, record_of_arrays(_arrays(file), *seen, title), title


def _live(path: Path | None, arrays: dict[str, np.ndarray], bodies: list[Seen], title: str, port: int) -> Any:
    from jaxrb.view.live import LiveView, view_live

    if path is not None:
        return view_live(path, title=title, port=port)
    window = LiveView(bodies, [], title, port)
    window.play(*(np.asarray(arrays[name], float) for name in ("time", "position", "orientation_wxyz")))
    return window


def _simulated(example: Example, duration: float | None) -> tuple[Path, str, float]:
    span = example.duration if duration is None else duration
    check_positive("duration", span)
    dt = example.dt or span / _STEPS
    steps = max(1, round(span / dt))
    every = max(1, steps // _SAVES)
    path = run(
        example.scene, example.state(), dt=dt, steps=steps - steps % every, save_every=every,
        progress=sys.stderr.isatty(),
    )  # fmt: skip
    return path, f"{example.name}: {example.about}", dt


def _arrays(file: File) -> dict[str, np.ndarray]:
    if not file.is_file():
        raise InvalidInput(f"{file}: there is no such file")
    return read_arrays(file, _MOST_BYTES)


def _read(file: File, example: Example) -> tuple[Path, str]:
    """The saved states as a path of a scene, as far as a picture needs."""
    arrays = _arrays(file)
    title = f"{example.name}: {example.about}"
    record_of_arrays(arrays, bodies_of(example.scene), [], str(file))  # checks that it fits
    state = example.state()
    states = type(state)(
        jnp.asarray(arrays["position"]),
        Quaternion(jnp.asarray(arrays["orientation_wxyz"])),
        jnp.zeros_like(arrays["position"]),
        jnp.zeros_like(arrays["position"]),
        jnp.asarray(arrays["time"]),
    )
    return Path(states.time, states, state, None, example.scene), title  # type: ignore[arg-type]


def _without_scene(file: File) -> tuple[Record, dict[str, np.ndarray], list[Seen]]:
    """Small boxes of one size: all that a file without shapes tells is where bodies are."""
    from jaxrb.geometry.primitives import Box

    arrays = _arrays(file)
    position = np.asarray(arrays.get("position", np.zeros((0, 0, 3))), float)
    if position.ndim != 3 or position.shape[2] != 3 or not position.size:
        raise InvalidInput(
            f"{file}: holds no positions (saves, bodies, 3); give a file that `jaxrb simulate --save` wrote"
        )
    count = position.shape[1]
    room = np.linalg.norm(np.ptp(position[np.isfinite(position).all(axis=(1, 2))].reshape(-1, 3), axis=0))
    size = 0.05 * (room or 1.0) / max(1.0, count ** (1 / 3))
    parts = parts_of(Box(size * np.array([1.0, 0.7, 0.4])))
    note = "the file holds no shapes: drawn as equal boxes (--scene NAME gives the shapes of a scene)"
    bodies = [Seen(f"body {i}" if count > 1 else "body", parts, note) for i in range(count)]
    return record_of_arrays(arrays, bodies, [], file.name), arrays, bodies


def _draw(path: Path, pictures: dict[str, Any]) -> None:
    if pictures["glb"] is not None:
        from jaxrb.view.glb_animation import save_glb

        save_glb(path, pictures["glb"])
    if pictures["png"] is not None or pictures["gif"] is not None:
        from jaxrb.view.viewer_pictures import save_gif, save_png

        for save, file in ((save_png, pictures["png"]), (save_gif, pictures["gif"])):
            if file is not None:
                save(path, file)
