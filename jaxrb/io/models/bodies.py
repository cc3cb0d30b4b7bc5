"""Bodies from a compiled model: what moves together becomes one body, with the compiler's mass and inertia."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.inertia import FullInertia, PrincipalInertia
from jaxrb.body.mass_properties import MassProperties, of_parts
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.primitives import Box, Capsule, Composite, Cylinder, Ellipsoid, HalfSpace, Pose, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.io.mesh import read_mesh
from jaxrb.io.models.survey import Survey
from jaxrb.math.quaternion import Quaternion

_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
_ROUND_OFF = 8 * np.finfo(float).eps  # of a product of rotations, relative to the trace

Placed = tuple[
    Shape, np.ndarray, np.ndarray
]  # a shape, its position and wxyz in the frame of what carries it


def movers_of(answer: Mapping[str, Any]) -> list[int]:
    """Numbers in the model of the bodies that move by themselves; their places here are their numbers in the scene."""
    return [i for i, body in enumerate(answer["bodies"]) if i and body["carrier"] == i]


def mass_properties(answer: Mapping[str, Any], movers: Sequence[int]) -> list[MassProperties]:
    """Of each mover with all that it carries, in the mover's own frame, in float64."""
    bodies = answer["bodies"]
    numbers = [
        np.asarray([pick(body) for body in bodies], float)
        for pick in (
            lambda b: b["mass"],
            lambda b: b["inertia"],
            lambda b: b["inertia_pose"][0],
            lambda b: b["inertia_pose"][1],
            lambda b: b["pose"][0],
            lambda b: b["pose"][1],
        )
    ]
    # A file's digits do not depend on the precision in which its scene will run.
    with jax.enable_x64(True):
        centers, sixes = (np.stack(x) for x in zip(*(_in_carrier(*row) for row in zip(*numbers))))
        found = []
        for mover in movers:
            rows = [i for i, body in enumerate(bodies) if body["carrier"] == mover]
            parts = [
                MassProperties(numbers[0][i], centers[i], FullInertia(sixes[i]))
                for i in rows
                if bodies[i]["mass"]
            ]
            whole = parts[0] if len(parts) == 1 else of_parts(parts)
            found.append(jax.tree.map(lambda leaf: np.asarray(leaf, float), whole))
    return found


# Compiled once for all models: a call a body costs less than a program for each number of bodies.
@jax.jit
def _in_carrier(mass: Any, moments: Any, inner: Any, inner_turn: Any, outer: Any, outer_turn: Any) -> Any:
    own = MassProperties(mass, jnp.zeros(3, moments.dtype), PrincipalInertia(moments))
    whole = own.moved(inner, Quaternion(inner_turn)).moved(outer, Quaternion(outer_turn))
    return whole.center_of_mass, whole.inertia.six()


def simplest(six: np.ndarray) -> Any:
    """The numbers of an inertia as one, three or a matrix: fewer where the others are zero to rounding."""
    size = _ROUND_OFF * six[:3].sum()
    if np.abs(six[3:]).max() > size:
        return FullInertia(six)
    return six[0] if np.ptp(six[:3]) <= size else six[:3]


def shapes_of(answer: Mapping[str, Any], survey: Survey) -> list[Placed]:
    """The shape of each geom of the model, in the frame of what carries it. A plane is a `HalfSpace` in the world."""
    known: dict[Any, Shape] = {}
    found = []
    for geom in answer["geoms"]:
        position, turn = (np.asarray(part, float) for part in geom["pose"])
        if geom["type"] == "mesh":
            key = (geom["mesh"], *geom["scale"])
            if key not in known:
                known[key] = _hull(geom, survey)
            shape = known[key]
        else:
            shape = _primitive(geom, position, turn)
        found.append((shape, position, turn))
    return found


def _primitive(geom: Mapping[str, Any], position: np.ndarray, turn: np.ndarray) -> Shape:
    size = np.asarray(geom["size"], float)
    kind = geom["type"]
    if kind == "plane":
        with jax.enable_x64(True):
            normal = np.asarray(turned(turn, np.array([0.0, 0.0, 1.0])))
        return HalfSpace(normal, float(normal @ position))
    if kind == "sphere":
        return Sphere(size[0])
    if kind in ("ellipsoid", "box"):
        return {"ellipsoid": Ellipsoid, "box": Box}[kind](size)
    if kind in ("capsule", "cylinder"):
        return {"capsule": Capsule, "cylinder": Cylinder}[kind](size[0], size[1])
    raise WrongStructure(f"geom {geom['name']!r}: jaxrb has no shape like MuJoCo's {kind}")


def _hull(geom: Mapping[str, Any], survey: Survey) -> ConvexHull:
    """The convex hull, which is what MuJoCo collides; in the numbers of the file, not in MuJoCo's float32."""
    if geom["file"] is None:
        vertices = np.asarray(geom["vertices"], float).reshape(-1, 3)
    else:
        vertices = np.asarray(read_mesh(survey.meshes[geom["file"]]).vertices, float)
    return ConvexHull(vertices * np.asarray(geom["scale"], float))


def colliding(geom: Mapping[str, Any]) -> bool:
    """Whether a geom may touch any other."""
    return bool(geom["contype"] or geom["conaffinity"])


def body_of(
    answer: Mapping[str, Any],
    mover: int,
    properties: MassProperties,
    shapes: Sequence[Placed],
    survey: Survey,
) -> Body:
    """The body of a mover. Its axes are the model's; its shape are the geoms that may touch, or all if none may."""
    own = [g for g, geom in enumerate(answer["geoms"]) if answer["bodies"][geom["body"]]["carrier"] == mover]
    own = [g for g in own if colliding(answer["geoms"][g])] or own
    center = properties.center_of_mass
    shape: Shape | None = None
    if len(own) == 1 and np.abs(np.abs(shapes[own[0]][2]) - _UPRIGHT).max() == 0:
        shape, position, _ = shapes[own[0]]
        center = center - position
    elif own:
        shape = Composite(tuple((shapes[g][0], Pose(shapes[g][1], Quaternion(shapes[g][2]))) for g in own))
    name = name_of(answer, mover)
    try:
        return Body(properties.mass, simplest(np.asarray(properties.inertia.six())), shape, center, name)
    except InvalidInput as error:
        file, line = survey.place("body", name)
        raise InvalidInput(f"{file}:{line}: body {name!r}: {error}") from error


def name_of(answer: Mapping[str, Any], body: int) -> str:
    """The name of a body of the model, or its number."""
    return answer["bodies"][body]["name"] or f"body_{body}"


def placed(answer: Mapping[str, Any], movers: Sequence[int], centers: np.ndarray) -> dict[str, Any]:
    """The arguments of `Scene.state`: where the movers' centres of mass are and how they move."""
    bodies = [answer["bodies"][i] for i in movers]
    numbers = [np.asarray([body["world_pose"][k] for body in bodies], float) for k in (0, 1)]
    motions = [
        np.asarray([body[name] for body in bodies], float) for name in ("velocity", "angular_velocity")
    ]
    with jax.enable_x64(True):
        rows = [_at_center(*row) for row in zip(*numbers, *motions, centers)]
    position, velocity, spin = (np.stack(x) for x in zip(*rows))
    return {
        "position": position.tolist(),
        "orientation": numbers[1].tolist(),
        "velocity": velocity.tolist(),
        "angular_velocity": spin.tolist(),
        "time": answer["time"],
    }


@jax.jit
def turned(turn: Any, vector: Any) -> Any:
    """A vector (3,) turned by wxyz (4,)."""
    return Quaternion(turn).rotate(vector)


@jax.jit
def _at_center(position: Any, turn: Any, velocity: Any, spin: Any, center: Any) -> Any:
    rotation = Quaternion(turn)
    arm = rotation.rotate(center)
    return position + arm, velocity + jnp.cross(spin, arm), rotation.unrotate(spin)
