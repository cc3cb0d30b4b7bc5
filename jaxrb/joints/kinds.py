"""The joints: ball, hinge, slider, distance, weld."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxrb.checks import check_direction, quantity
from jaxrb.joints.drives import Drive
from jaxrb.joints.joint import Joint, basis_about, in_turn, resting
from jaxrb.joints.rows import LengthRows, Place, PointRows, Rows, TurnRows
from jaxrb.math.arrays import Scalar, Vector
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.math.safe import arctan2, norm
from jaxrb.math.vector import cross, dot

_ORIGIN = (0.0, 0.0, 0.0)


class BallJoint(Joint):
    """Holds the point `anchor_a` (3,) [m] of body a, in its frame, at the point `anchor_b` of b, or of the world."""

    anchor_a: Vector = quantity((3,), unit="m", default=_ORIGIN)
    anchor_b: Vector = quantity((3,), unit="m", default=_ORIGIN)

    def parts(self, world: int) -> list[tuple[Any, np.ndarray]]:
        return [_held(self, world, _unit_axes(self))]

    def misfit(self, a: Place, b: Place) -> tuple[Scalar, Scalar]:
        gap = norm(_apart(self, a, b))
        return gap, jnp.zeros_like(gap)


class Weld(Joint):
    """Holds a to b as if they were one body: the points `anchor_a` and `anchor_b` [m] together, and the attitude.

    `rest` is the attitude of a as seen from b, or in the world; by default the two frames are parallel.
    """

    anchor_a: Vector = quantity((3,), unit="m", default=_ORIGIN)
    anchor_b: Vector = quantity((3,), unit="m", default=_ORIGIN)
    rest: Rotation | None = None

    def parts(self, world: int) -> list[tuple[Any, np.ndarray]]:
        return [_held(self, world, _unit_axes(self)), _unturned(self, world, self.rest)]

    def misfit(self, a: Place, b: Place) -> tuple[Scalar, Scalar]:
        return norm(_apart(self, a, b)), _turned_by(self, a, b)


class _AxialJoint(Joint):
    """What joints with one free coordinate, about or along `axis`, have in common."""

    axis: Vector = quantity((3,), default=(0.0, 0.0, 1.0))
    anchor_a: Vector = quantity((3,), unit="m", default=_ORIGIN)
    anchor_b: Vector = quantity((3,), unit="m", default=_ORIGIN)
    rest: Rotation | None = None
    drives: tuple[Drive, ...] = eqx.field(default=(), kw_only=True)  # pyright: ignore

    def __post_init__(self):
        self.drives = _tuple(self.drives)
        super().__post_init__()
        check_direction(f"{type(self).__name__}.axis", self.axis)


class Hinge(_AxialJoint):
    """Lets a turn against b about one axis only: a door, an elbow, a wheel on its axle.

    `anchor_a`, `anchor_b` (3,) [m]: the point that both share, in the frame of each. `axis` (3,): of any length, in the
    frame of a. `rest`: the attitude of a as seen from b (or in the world) at angle zero, by default parallel frames; so
    the axis in b is `rest` applied to `axis`. The coordinate is the angle [rad] of a against b about the axis, from −π
    to π: turns are not counted. `drives`: what acts along it, such as `JointSpring`.
    """

    free: ClassVar[str | None] = "rad"

    def parts(self, world: int) -> list[tuple[Any, np.ndarray]]:
        axis, first, second = basis_about(self.spread(self.axis))
        turned = resting(self.rest, axis.dtype)
        fixed_in_b = in_turn([turned.rotate(first), turned.rotate(second)])
        pairs, own = _repeated(self, world, 2)
        turn = TurnRows(in_turn([axis, axis]), fixed_in_b, pairs)
        return [_held(self, world, _unit_axes(self)), (turn, own)]

    def misfit(self, a: Place, b: Place) -> tuple[Scalar, Scalar]:
        axis, _, _ = basis_about(self.spread(self.axis))
        in_b = resting(self.rest, axis.dtype).rotate(axis)
        u, v = a.orientation.rotate(axis), b.orientation.rotate(jnp.broadcast_to(in_b, axis.shape))
        return norm(_apart(self, a, b)), arctan2(norm(cross(u, v)), dot(u, v))

    def coordinate_rows(self, a: Place, b: Place) -> Rows:
        axis, _, _ = basis_about(self.spread(self.axis))
        rest = resting(self.rest, axis.dtype)
        seen_from_b = Quaternion.from_rotation(b.orientation.inverse() @ a.orientation)
        wxyz = (rest.inverse() @ seen_from_b).as_quaternion_array()
        sine, cosine = dot(wxyz[..., 1:], axis), wxyz[..., 0]
        # q and −q are the same attitude: the one with cos ≥ 0 gives the angle from −π to π.
        sign = jnp.where(cosine < 0, -1.0, 1.0).astype(cosine.dtype)
        angle = 2.0 * arctan2(sign * sine, sign * cosine)
        on_b = -b.orientation.unrotate(a.orientation.rotate(axis))
        angular = jnp.stack([axis, on_b], axis=1)
        return Rows(angle, jnp.zeros_like(angular), angular, jnp.zeros_like(angle))


class Slider(_AxialJoint):
    """Lets a move along one axis of b, without turning: a piston, a drawer.

    `axis` (3,): of any length, in the frame of a. `anchor_a`, `anchor_b` (3,) [m]: points on the guide, in the frame of
    each, which meet at travel zero. `rest` as for `Hinge`. The coordinate is the travel [m] of a along the axis.
    `drives`: what acts along it.
    """

    free: ClassVar[str | None] = "m"

    def parts(self, world: int) -> list[tuple[Any, np.ndarray]]:
        _, first, second = self._fixed_in_b()
        return [_held(self, world, [first, second]), _unturned(self, world, self.rest)]

    def misfit(self, a: Place, b: Place) -> tuple[Scalar, Scalar]:
        axis = b.orientation.rotate(self._fixed_in_b()[0])
        return norm(cross(axis, _apart(self, a, b))), _turned_by(self, a, b)

    def coordinate_rows(self, a: Place, b: Place) -> Rows:
        axis, _, _ = self._fixed_in_b()
        (point, _) = _held(self, 0, [axis])
        return point.rows(a, b)

    def _fixed_in_b(self) -> tuple[Vector, ...]:
        basis = basis_about(self.spread(self.axis))
        turned = resting(self.rest, basis[0].dtype)
        return tuple(turned.rotate(vector) for vector in basis)


class Distance(Joint):
    """A rod without mass: keeps `anchor_a` (3,) [m] of a and `anchor_b` of b, or of the world, `length` [m] apart."""

    length: Scalar = quantity((), positive=True, unit="m")
    anchor_a: Vector = quantity((3,), unit="m", default=_ORIGIN)
    anchor_b: Vector = quantity((3,), unit="m", default=_ORIGIN)

    def parts(self, world: int) -> list[tuple[Any, np.ndarray]]:
        pairs, own = _repeated(self, world, 1)
        length = jnp.broadcast_to(jnp.asarray(self.length), (self.count,))
        return [(LengthRows(self.spread(self.anchor_a), self.spread(self.anchor_b), length, pairs), own)]

    def misfit(self, a: Place, b: Place) -> tuple[Scalar, Scalar]:
        error = jnp.abs(norm(_apart(self, a, b)) - self.length)
        return error, jnp.zeros_like(error)


def _apart(joint: Any, a: Place, b: Place) -> Vector:
    """From the anchor of b to that of a (k, 3) [m], in the world."""
    arm_a, arm_b = (
        a.orientation.rotate(joint.spread(joint.anchor_a)),
        b.orientation.rotate(joint.spread(joint.anchor_b)),
    )
    return (a.position - b.position) + (arm_a - arm_b)


def _turned_by(joint: Any, a: Place, b: Place) -> Scalar:
    """The angle (k,) [rad] by which a, as seen from b, is off its attitude at rest."""
    seen = Quaternion.from_rotation(b.orientation.inverse() @ a.orientation)
    return norm((resting(joint.rest, seen.wxyz.dtype).inverse() @ seen).log())


def _tuple(drives: Any) -> tuple:
    return tuple(drives) if isinstance(drives, (tuple, list)) else (drives,)


def _unit_axes(joint: Any) -> list[Vector]:
    eye = jnp.eye(3, dtype=jnp.asarray(joint.anchor_a).dtype)
    return [joint.spread(row) for row in eye]


def _repeated(joint: Joint, world: int, times: int) -> tuple[tuple[tuple[int, int], ...], np.ndarray]:
    """The bodies of `times` rows a joint, and of each row the number of its joint."""
    own = np.repeat(np.arange(joint.count, dtype=np.int32), times)
    return tuple(map(tuple, joint.pairs(world)[own].tolist())), own


def _held(joint: Any, world: int, directions: list[Vector]) -> tuple[PointRows, np.ndarray]:
    """Rows that hold the anchors together along directions (k, 3) fixed in b."""
    pairs, own = _repeated(joint, world, len(directions))
    on_a, on_b = (joint.spread(x)[own] for x in (joint.anchor_a, joint.anchor_b))
    return PointRows(on_a, on_b, in_turn(directions), pairs), own


def _unturned(joint: Any, world: int, rest: Rotation | None) -> tuple[TurnRows, np.ndarray]:
    """Rows that hold the attitude of a as seen from b at `rest`: each axis of a across the next one of b."""
    in_a = _unit_axes(joint)
    turned = resting(rest, in_a[0].dtype)
    in_b = [jnp.broadcast_to(turned.rotate(x), x.shape) for x in in_a]
    pairs, own = _repeated(joint, world, 3)
    return TurnRows(in_turn(in_a), in_turn([in_b[1], in_b[2], in_b[0]]), pairs), own
