"""Hard cases of derivatives: points where the textbook formula divides zero by zero.

All are functions of one 3-vector, in one program, each with its Jacobian by automatic differentiation; closed forms of
value and Jacobian are computed by numpy in float64.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.state import State
from jaxrb.effects.spring import SpringDamper
from jaxrb.hard.case import QUICK, Case, Measured, precision
from jaxrb.math.arrays import Vector
from jaxrb.math.matrix import RotationMatrix
from jaxrb.math.quaternion import Quaternion, attitude_error
from jaxrb.math.safe import norm
from jaxrb.scene.scene import Scene

TURNED = np.asarray([0.36, -0.48, 0.8])  # a unit vector to rotate, and half a turn about the one below
HALF_TURN = np.pi * np.asarray([0.48, 0.6, 0.64])
STIFFNESS = 30.0


def _spring_acceleration(x: Vector) -> Vector:
    """Of a body at x on a spring without rest length to the origin."""
    scene = Scene(Body(2.0, 1.0), SpringDamper(STIFFNESS))
    zero = jnp.zeros((1, 3), x.dtype)
    turn = Quaternion.identity(x.dtype).wxyz[None]
    state = State(x[None], Quaternion(turn), zero, zero, jnp.zeros((), x.dtype))
    linear = scene.prepared(x.dtype).acceleration(state).linear
    assert linear is not None  # a spring pulls
    return linear[0]


def _rodrigues(v: np.ndarray) -> np.ndarray:
    """The rotation by v applied to `TURNED`."""
    angle = np.linalg.norm(v)
    u = v / angle
    turned = np.cos(angle) * TURNED + np.sin(angle) * np.cross(u, TURNED)
    return turned + (1 - np.cos(angle)) * (u @ TURNED) * u


def _rodrigues_slope(v: np.ndarray) -> np.ndarray:
    h = 1e-6
    return np.stack([(_rodrigues(v + h * e) - _rodrigues(v - h * e)) / (2 * h) for e in np.eye(3)], -1)


def _from_identity(x: Vector) -> Vector:
    return Quaternion.exp(x).angle_to(Quaternion.identity(x.dtype))[None]


def _chord_from_identity(x: Vector) -> Vector:
    return attitude_error(Quaternion.exp(x).wxyz, Quaternion.identity(x.dtype).wxyz)[None]


ZERO = np.zeros(3)
# Name: what is hard, function, point, value, Jacobian (None: any finite one; it has none).
POINTS = {
    "logarithm of no rotation": (
        "arccos has slope infinity at 1", lambda x: Quaternion.exp(x).log(), ZERO, ZERO, np.eye(3)
    ),
    "logarithm of no rotation, matrix": (
        "θ/sin θ at 0", lambda x: RotationMatrix.exp(x).log(), ZERO, ZERO, np.eye(3)
    ),
    "a turn by nothing": (
        "sin θ/θ at 0",
        lambda x: Quaternion.exp(x).rotate(jnp.asarray(TURNED, x.dtype)),
        ZERO,
        TURNED,
        np.cross(TURNED, np.eye(3)),
    ),
    "a turn by π": (
        "q and −q meet",
        lambda x: Quaternion.exp(x).rotate(jnp.asarray(TURNED, x.dtype)),
        HALF_TURN,
        _rodrigues(HALF_TURN),
        _rodrigues_slope(HALF_TURN),
    ),
    "logarithm of a turn by π": (
        "either sign is right", lambda x: Quaternion.exp(x).log(), HALF_TURN, HALF_TURN, None
    ),
    "logarithm of a turn by π, matrix": (
        "the skew part is zero", lambda x: RotationMatrix.exp(x).log(), HALF_TURN, HALF_TURN, None
    ),
    "speed of a body at rest": ("|v| has a corner at 0", lambda x: norm(x)[None], ZERO, np.zeros(1), None),
    "attitude error of equal attitudes": (
        "an angle has a corner at 0", _from_identity, ZERO, np.zeros(1), None
    ),
    "chord of equal attitudes": ("a distance has a corner at 0", _chord_from_identity, ZERO, np.zeros(1), None),
    "spring of zero length": (
        "its direction is 0/0", _spring_acceleration, ZERO, ZERO, -STIFFNESS / 2.0 * np.eye(3)
    ),
}  # fmt: skip


@functools.cache
def _jacobians(kind: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Value and Jacobian of every function at its point, in the precision that is switched on, `kind`."""
    functions = {name: function for name, (_, function, *_) in POINTS.items()}

    def all_of_them(points: dict) -> dict:
        return {name: (f(points[name]), jax.jacrev(f)(points[name])) for name, f in functions.items()}

    at = {name: jnp.asarray(point, kind) for name, (_, _, point, *_) in POINTS.items()}
    found = jax.jit(all_of_them, compiler_options=QUICK)(at)
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), found)


def _at_point(name: str) -> Measured:
    _, _, _, exact, slope = POINTS[name]
    value, jacobian = _jacobians(precision())[name]
    error = np.abs(value - exact).max()
    if "logarithm of a turn by π" in name:
        error = np.minimum(error, np.abs(value + exact).max())
    off = None if slope is None else float(np.abs(jacobian - slope).max() / np.abs(slope).max())
    return Measured(float(error), jacobian, off)


def cases() -> tuple[Case, ...]:
    """The cases of this file."""
    figure = {"float64": 1e-14, "float32": 3e-6}
    slope = {"float64": 1e-8, "float32": 1e-5}
    # The logarithm of a matrix near half a turn is known to √ε: an angle of π − δ has the same matrix to δ².
    coarse = {"float64": 1e-7, "float32": 2e-3}
    return tuple(
        Case(
            name,
            hard,
            "value; the Jacobian is right" if exact is not None else "value; the Jacobian is finite",
            coarse if name.endswith("π, matrix") else figure,
            functools.partial(_at_point, name),
            None if exact is None else slope,
        )
        for name, (hard, _, _, _, exact) in POINTS.items()
    )
