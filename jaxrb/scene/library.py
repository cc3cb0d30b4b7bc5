"""Scenes by name: what the commands run, with a start and a duration; or a user's own from a Python file.

Those of `SCENES` are smooth, and have answers that can be known; those with contact are in `contact_library`, those
with joints in `joint_library`.
"""

import difflib
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.effects.drag import QuadraticDrag
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.spring import SpringDamper
from jaxrb.errors import InvalidInput, JaxrbError, UnknownName, WrongStructure
from jaxrb.geometry.primitives import Box
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.contact_library import CONTACT_SCENES
from jaxrb.scene.example import Example
from jaxrb.scene.joint_library import JOINT_SCENES
from jaxrb.scene.scene import Scene, check_fit
from jaxrb.scene.settings import check_positive

SLUG_FT2 = 1.3558179483314004  # [kg m²]: 1 slug ft² is 1 lbf ft s²


def tumbling_brick() -> Example:
    """Atmospheric check case 2 of the NASA Engineering and Safety Center, without its Earth, which does not turn it.

    (NASA/TM-2015-218675; the moments in slug ft² are those of its data, as in simupy-flight's `NESC_data`.)
    """
    moments = SLUG_FT2 * np.array([0.001894220, 0.006211019, 0.007194665])
    start = {"angular_velocity": np.deg2rad([10.0, 20.0, 30.0]).tolist()}
    return Example(
        "tumbling_brick", "free brick (NESC check case 2)", Scene(Body(2.26796, moments)), start, 30.0
    )


def dzhanibekov() -> Example:
    """A free body that starts within 1e-3 of its unstable axis: every error of the start grows by e^(t/√3)."""
    start = {"orientation": [0.5, 0.5, -0.5, 0.5], "angular_velocity": [0.001, 1.0, 0.001]}
    scene = Scene(Body(1.0, (1.0, 2.0, 3.0)))
    return Example("dzhanibekov", "free body near its unstable axis", scene, start, 100.0)


def heavy_top() -> Example:
    """An asymmetric top, its centre of mass off all axes: no closed form."""
    scene = _top((1.0, 1.5, 2.0), (0.3, 0.2, 1.0))
    start = {"orientation": _LEANING, "angular_velocity": [0.3, -0.2, 2.0]}
    return Example("heavy_top", "asymmetric heavy top", scene, start, 20.0)


def lagrange_top() -> Example:
    """A symmetric top spinning fast."""
    scene = _top((1.0, 1.0, 0.5), (0.0, 0.0, 2.0))
    start = {"orientation": _LEANING, "angular_velocity": [0.2, 0.1, 8.0]}
    return Example("lagrange_top", "symmetric heavy top", scene, start, 20.0)


_LEANING = [0.9354143466934853, 0.3535533905932738, 0.0, 0.0]


def _top(moments: tuple[float, ...], weight_moment: tuple[float, ...], gravity: float = 9.81) -> Scene:
    """A held body of 1 kg with these moments about the held point, and m g r [N m] from there to the centre of mass."""
    r = np.array(weight_moment) / gravity
    about_centre = np.diag(moments) - (r @ r * np.eye(3) - np.outer(r, r))
    effects = (UniformGravity((0.0, 0.0, -gravity)), FixedPoint(point=-r))
    return Scene(Body(1.0, about_centre), effects)


def thrown_brick() -> Example:
    """A wooden brick thrown through the air."""
    body = Body.from_shape(Box(half_extents=(0.10, 0.05, 0.02)), density=700.0)
    scene = Scene(body, (UniformGravity(), QuadraticDrag(coefficient=1.05, area=0.02)))
    start = {"position": [0.0, 0.0, 1.0], "velocity": [6.0, 0.0, 8.0], "angular_velocity": [0.5, 9.0, 0.3]}
    return Example("thrown_brick", "brick with gravity and drag", scene, start, 1.5)


def gazebo_boxes() -> Example:
    """One box of the "complex" case of Gazebo's benchmark: thrown upwards, tumbling, no contact.

    (S. Peters, J. Hsu, "Comparison of rigid body dynamic simulators for robotic simulation in Gazebo", ROSCon 2014;
    scpeters/benchmark.)
    """
    scene = Scene(_gazebo_box(), UniformGravity((0.0, 0.0, -9.8)))
    start = {"velocity": [-2.0, 2.0, 8.0], "angular_velocity": [0.1, 5.0, 0.1]}
    return Example("gazebo_boxes", "Gazebo's benchmark box, complex case", scene, start, 10.0)


def gazebo_boxes_simple() -> Example:
    """The "simple" case of the same benchmark: no gravity, spin about a principal axis."""
    start = {"velocity": [-0.9, 0.4, 0.1], "angular_velocity": [0.5, 0.0, 0.0]}
    scene = Scene(_gazebo_box())
    return Example("gazebo_boxes_simple", "Gazebo's benchmark box, simple case", scene, start, 10.0)


def _gazebo_box() -> Body:
    return Body.from_shape(Box(half_extents=(0.05, 0.2, 0.45)), density=10.0 / 0.036)


def free_boxes(count: int = 9) -> Example:
    """Wooden boxes of different edges, each with a spin of its own; nothing acts."""
    random = drawn(0)
    half = random.uniform(0.1, 0.4, (count, 3))
    bodies = tuple(Body.from_shape(Box(edges), density=600.0) for edges in half)
    start = {
        "position": [(1.5 * (i % 3), 1.5 * (i // 3), 0.0) for i in range(count)],
        "angular_velocity": random.normal(size=(count, 3)).tolist(),
    }
    return Example("free_boxes", f"{count} free boxes", Scene(bodies), start, 25.0)


def double_spring() -> Example:
    """Two bricks, the corner of one tied to the corner of the other by a spring: tumbling drives the spring."""
    brick = Body.from_shape(Box(half_extents=(0.10, 0.05, 0.02)), density=700.0)
    spring = SpringDamper(
        stiffness=15.0, rest_length=0.2, point_a=(0.1, 0.05, 0.02), point_b=(-0.1, 0.05, -0.02), body_a=0, body_b=1
    )  # fmt: skip
    start = {
        "position": [(-0.25, 0.0, 0.0), (0.25, 0.0, 0.0)],
        "velocity": [(0.0, 0.2, 0.0), (0.0, -0.2, 0.0)],
        "angular_velocity": [(0.5, 1.0, 2.0), (-1.0, 0.3, 0.5)],
    }
    return Example(
        "double_spring", "two bricks joined by a spring", Scene((brick, brick), spring), start, 5.0
    )


SCENES: dict[str, Callable[[], Example]] = {
    build.__name__: build
    for build in (
        tumbling_brick, dzhanibekov, heavy_top, lagrange_top, thrown_brick, gazebo_boxes, gazebo_boxes_simple,
        free_boxes, double_spring,
    )
}  # fmt: skip


def example_of(name: str) -> Example:
    """The scene of that name, or the one that the Python file of that name defines.

    Such a file defines `scene` (a `Scene`), `state` (a `State` of it), `duration` [s] and, if it likes, `dt` [s].

    Raises:
        UnknownName: there is no such scene; the message suggests the nearest.
        InvalidInput, WrongStructure: the file is not there, fails, or does not define what it should.
    """
    if name.endswith(".py"):
        return _from_file(Path(name))
    key = name.lower().replace("-", "_")
    known = SCENES | CONTACT_SCENES | JOINT_SCENES
    if key in known:
        return known[key]()
    near = difflib.get_close_matches(key, known, n=2, cutoff=0.4)
    meant = f"did you mean {' or '.join(near)}? " if near else ""
    raise UnknownName(
        f"scene {name!r} is not known; {meant}There are {', '.join(known)}; or give a Python file (….py) that "
        "defines scene, state and duration"
    )


def _from_file(file: Path) -> Example:
    if not file.is_file():
        raise InvalidInput(
            f"scene file {file}: there is no such file; give a name of "
            f"{', '.join(SCENES | CONTACT_SCENES | JOINT_SCENES)}, or a path"
        )
    try:
        defined = runpy.run_path(str(file))
    except JaxrbError:
        raise
    except Exception as error:
        raise InvalidInput(
            f"scene file {file} fails with {type(error).__name__}: {error}; run it with Python"
        ) from error
    for name, kind in (("scene", Scene), ("state", State)):
        if not isinstance(defined.get(name), kind):
            what = (
                f"defines {name} as {type(defined[name]).__name__}"
                if name in defined
                else f"defines no {name}"
            )
            raise WrongStructure(f"scene file {file} {what}; it must define `{name}`, a rb.{kind.__name__}")
    if "duration" not in defined:
        raise WrongStructure(
            f"scene file {file} defines no duration; it must define `duration`, a number [s]"
        )
    scene, state = defined["scene"], defined["state"]
    check_fit(scene, state)
    check_positive(f"{file}: duration", defined["duration"])
    dt = defined.get("dt")
    if dt is not None:
        check_positive(f"{file}: dt", dt)
        dt = float(dt)
    return Example(file.stem, str(file), scene, _numbers(state), float(defined["duration"]), dt)


def _numbers(state: State) -> dict[str, Any]:
    turned = jax.jit(Quaternion.from_rotation)(state.orientation).normalise()
    parts = {
        "position": state.position,
        "orientation": turned.as_quaternion_array(),
        "velocity": state.velocity,
        "angular_velocity": state.angular_velocity,
    }
    return {key: np.asarray(value, float).tolist() for key, value in parts.items()} | {
        "time": float(state.time)
    }
