"""Hard cases of distances: pairs of shapes whose nearest features are many, tiny, huge, far away or everywhere.

Boxes are asked twice, as boxes and as hulls of eight corners: two programs that share no search. What is known is
known in closed form; the figure is relative to the largest coordinate and includes any excess of the certificate, so a
wrong sign or a false bound shows.
"""

import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.collision.contact import Contact
from jaxrb.collision.narrowphase import separation
from jaxrb.geometry.hull import ConvexHull, stack_hulls
from jaxrb.geometry.primitives import Box, Ellipsoid, Pose, Sphere
from jaxrb.hard.case import QUICK, Case, Measured, precision
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.quaternion import Quaternion

_X, _NO_TURN = (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
_EIGHTH = np.pi / 8
_ABOUT_Z = (float(np.cos(_EIGHTH)), 0.0, 0.0, float(np.sin(_EIGHTH)))  # by 45°
_ABOUT_Y = (float(np.cos(_EIGHTH)), 0.0, float(np.sin(_EIGHTH)), 0.0)


def _corner_to_x() -> tuple[float, ...]:
    """The turn that takes (1, 1, 1)/√3 to x."""
    half = np.asarray([1, 1, 1]) / np.sqrt(3) + np.asarray(_X)
    half /= np.linalg.norm(half)
    axis = np.cross(np.asarray([1, 1, 1]) / np.sqrt(3), half)
    return (float(half.sum() / np.sqrt(3)), *axis.tolist())


_ONE, _ROOT2, _ROOT3 = (1.0, 1.0, 1.0), float(np.sqrt(2)), float(np.sqrt(3))
_CORNER = _corner_to_x()
# Name: what is hard, half extents a, turn a, half extents b, turn b, place of b as seen from a, distance, normal (None
# where it is not unique), place of a.
_At = tuple[Any, ...]
BOXES: dict[str, _At] = {
    "parallel faces": ("a face of nearest points", _ONE, _NO_TURN, _ONE, _NO_TURN, (2.5, 0.25, -0.5), 0.5, _X),
    "edge on edge": (
        "the normal is that of no face", _ONE, _ABOUT_Z, _ONE, _ABOUT_Y, (2 * _ROOT2 + 0.5, 0, 0), 0.5, _X
    ),
    "corner on corner": (
        "every direction nearby separates", _ONE, _CORNER, _ONE, _CORNER, (2 * _ROOT3 + 0.5, 0, 0), 0.5, _X
    ),
    "one and the same": ("all ways out tie", _ONE, _ABOUT_Z, _ONE, _ABOUT_Z, (0, 0, 0), -2.0, None),
    "deep inside": (
        "origin deep in the difference", _ONE, _NO_TURN, (0.2, 0.2, 0.2), _NO_TURN, (0.125, 0, 0), -1.075, _X
    ),
    "slivers 1e4": (
        "edges of ratio 1e4", (1, 1, 1e-4), _NO_TURN, (1, 1, 1e-4), _NO_TURN, (0.1, 0.2, 2.5e-4), 5e-5, (0, 0, 1)
    ),
    "touch exactly": ("the distance is 0", _ONE, _NO_TURN, _ONE, _NO_TURN, (2, 0.25, 0.5), 0.0, _X),
    "touch at an edge": ("0, and no unique normal", _ONE, _NO_TURN, _ONE, _NO_TURN, (2, 2, 0.5), 0.0, None),
    "touch at a corner": ("0, and no unique normal", _ONE, _NO_TURN, _ONE, _NO_TURN, (2, 2, 2), 0.0, None),
    "size ratio 1e6": (
        "a grain before a wall", (1e3, 1e3, 1e3), _NO_TURN, (1e-3, 1e-3, 1e-3), _NO_TURN, (1000.501, 1, 2), 0.5, _X
    ),
    "1e4 m away, both": ("world coordinates have no digits left", _ONE, _NO_TURN, _ONE, _NO_TURN, (2.5, 0.25, -0.5),
                         0.5, _X, (1e4, -1e4, 1e4)),
}  # fmt: skip
# Radii a, radii b, place of b, distance, normal.
ELLIPSOIDS: dict[str, _At] = {
    "ellipsoids, concentric": ("two ways out tie", (1, 2, 3), (0.5, 1, 2), (0, 0, 0), -1.5, None),
    "ellipsoids, one and the same": ("two ways out tie", (1, 2, 3), (1, 2, 3), (0, 0, 0), -2.0, None),
    "ellipsoids that touch": ("the distance is 0", (1, 2, 3), (0.5, 1, 2), (1.5, 0, 0), 0.0, _X),
}
SPHERES: dict[str, _At] = {
    "spheres, concentric": ("the normal is 0/0", 1.0, 0.5, (0, 0, 0), -1.5, None),
    "spheres that touch": ("the distance is 0", 1.0, 0.5, (0, 1.5, 0), 0.0, (0, 1, 0)),
}


def _distance(
    place_b: Vector, shape_a: Any, pose_a: Pose, shape_b: Any, turn_b: Quaternion
) -> tuple[Scalar, Contact]:
    contact = separation(shape_a, pose_a, shape_b, Pose(place_b, turn_b))
    return contact.distance, contact


_BATCH = jax.jit(jax.vmap(jax.value_and_grad(_distance, has_aux=True)), compiler_options=QUICK)
Answers = dict[str, tuple[Contact, np.ndarray]]  # contact, gradient by the place of b


def _asked(names: Any, a: Any, turn_a: Any, at_a: Any, b: Any, turn_b: Any, from_a: Any) -> Answers:
    """One compiled program for all pairs of a kind."""
    kind = precision()
    at_a, turn_a, turn_b = (jnp.asarray(x, kind) for x in (at_a, turn_a, turn_b))
    at_b = at_a + jnp.asarray(from_a, kind)
    a, b = jax.tree.map(lambda x: jnp.asarray(x, kind if np.asarray(x).dtype.kind == "f" else None), (a, b))
    (_, contact), slope = _BATCH(at_b, a, Pose(at_a, Quaternion(turn_a)), b, Quaternion(turn_b))
    contact, slope = jax.tree.map(lambda x: np.asarray(x, np.float64), (contact, slope))
    return {name: (jax.tree.map(lambda x, i=i: x[i], contact), slope[i]) for i, name in enumerate(names)}


@functools.cache
def _boxes(kind: str, as_hulls: bool) -> Answers:
    rows = list(BOXES.values())
    half_a, turn_a, half_b, turn_b, from_a = (
        np.asarray([row[i] for row in rows], float) for i in range(1, 6)
    )
    at_a = np.asarray([row[8] if len(row) > 8 else (0, 0, 0) for row in rows], float)
    if as_hulls:
        corners = np.asarray(list(itertools.product((-1.0, 1.0), repeat=3)))
        a, b = (stack_hulls([ConvexHull(h * corners) for h in half]) for half in (half_a, half_b))
    else:
        a, b = (jax.vmap(lambda h: Box(h))(jnp.asarray(half, kind)) for half in (half_a, half_b))
    return _asked(BOXES, a, turn_a, at_a, b, turn_b, from_a)


@functools.cache
def _smooth(kind: str, spheres: bool) -> Answers:
    table = SPHERES if spheres else ELLIPSOIDS
    rows = list(table.values())
    shape = Sphere if spheres else Ellipsoid
    a, b = (jax.vmap(lambda size: shape(size))(jnp.asarray([row[i] for row in rows], kind)) for i in (1, 2))
    turn = np.asarray([_NO_TURN] * len(rows))
    return _asked(table, a, turn, np.zeros((len(rows), 3)), b, turn, np.asarray([row[3] for row in rows]))


def _judged(answer: Any, exact: float, normal: Any, size: float) -> tuple[float, float | None]:
    contact, slope = answer
    excess = max(abs(contact.distance - exact), contact.lower - exact, exact - contact.upper) / size
    if np.isnan(contact.distance):
        excess = np.nan
    elif abs(np.linalg.norm(contact.normal) - 1) > 1e-5:
        excess = np.inf
    if normal is None:
        return excess, None
    return excess, float(np.linalg.norm(slope - np.asarray(normal)))


def _measure(answers: list[Any], exact: float, normal: Any, size: float) -> Measured:
    judged = [_judged(answer, exact, normal, size) for answer in answers]
    slopes = [off for _, off in judged if off is not None]
    return Measured(
        float(np.max([figure for figure, _ in judged])),
        answers,
        max(slopes) if slopes else None,
    )


def _box_pair(name: str) -> Measured:
    _, half_a, _, half_b, _, from_a, exact, normal, *_ = BOXES[name]
    answers = [_boxes(precision(), as_hulls)[name] for as_hulls in (False, True)]
    return _measure(answers, exact, normal, float(np.max(np.abs([half_a, half_b, from_a]))))


def _smooth_pair(name: str, spheres: bool) -> Measured:
    _, size_a, _, _, exact, normal = (SPHERES if spheres else ELLIPSOIDS)[name]
    return _measure([_smooth(precision(), spheres)[name]], exact, normal, float(np.max(size_a)))


def cases() -> tuple[Case, ...]:
    """The cases of this file."""
    stable = "error of the distance over the largest coordinate; the certificate holds the truth; "
    figure = {"float64": 1e-14, "float32": 2e-6}
    slope = {"float64": 1e-7, "float32": 1e-3}

    def case(name: str, hard: str, run: Any, normal: Any) -> Case:
        known = normal is not None
        gradient = "the gradient is the normal" if known else "the gradient is finite"
        return Case(name, hard, stable + gradient, figure, run, slope if known else None)

    return (
        *(case(n, row[0], functools.partial(_box_pair, n), row[7]) for n, row in BOXES.items()),
        *(
            case(n, row[0], functools.partial(_smooth_pair, n, False), row[5])
            for n, row in ELLIPSOIDS.items()
        ),
        *(case(n, row[0], functools.partial(_smooth_pair, n, True), row[5]) for n, row in SPHERES.items()),
    )
