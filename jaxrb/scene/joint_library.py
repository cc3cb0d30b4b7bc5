"""Scenes with joints by name: pendulums, a chain, a door, linkages, a doll, a cart."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxrb.body.body import Body, replicate
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.effects.torques import AngularSpring
from jaxrb.geometry.primitives import Box, Capsule, Cylinder, HalfSpace
from jaxrb.joints.drives import JointLimit, JointMotor, JointSpring
from jaxrb.joints.kinds import BallJoint, Hinge
from jaxrb.math.quaternion import Quaternion
from jaxrb.scene.example import Example
from jaxrb.scene.rods import Rods as Rods
from jaxrb.scene.rods import rod as rod
from jaxrb.scene.scene import Scene

GRAVITY = UniformGravity((0.0, 0.0, -9.81))
CART_INCLINE = 10.0  # [degrees]


def double_pendulum(angles: Sequence[float] = (math.pi / 2, math.pi / 2)) -> Example:
    """Two rods of 1 m and 1 kg on hinges, by default let go stretched out level; `angles` from the vertical [rad]."""
    points = [np.zeros(3)]
    for angle in angles:
        points.append(points[-1] + [math.sin(angle), 0.0, -math.cos(angle)])
    rods = Rods(points)
    hinges = (rods.hinge(0, None, 0, (0.0, 1.0, 0.0)), rods.hinge(1, 0, 1, (0.0, 1.0, 0.0)))
    scene = Scene(replicate(rod(1.0, 1.0), len(angles)), (GRAVITY, *hinges))
    return Example("double_pendulum", "double pendulum of two rods", scene, rods.start, 10.0, 1e-3)


def chain(count: int = 50, link: float = 0.1, angle: float = 0.3) -> Example:
    """A chain of rods of 0.1 kg on ball joints, hung up at one end and let go straight, off the vertical [rad]."""
    along = link * np.array([math.sin(angle), 0.0, -math.cos(angle)])
    rods = Rods([k * along for k in range(count + 1)])
    below, above = tuple(range(1, count)), tuple(range(count - 1))
    effects = [GRAVITY, BallJoint(bodies=(0, None), anchor_a=(0.0, 0.0, -link / 2))]
    if count > 1:
        ends = {"anchor_a": (0.0, 0.0, -link / 2), "anchor_b": (0.0, 0.0, link / 2)}
        effects.append(BallJoint(bodies=(below, above), **ends))
    scene = Scene(replicate(rod(link, 0.1), count), tuple(effects))
    return Example("chain", f"chain of {count} links", scene, rods.start, 60.0, 2e-3)


def door() -> Example:
    """A door on two hinges, of which one says all that the other says; a spring shuts it, a stop holds it."""
    half = (0.45, 0.02, 1.0)
    leaf = Body.from_shape(Box(half), density=20.0 / (8.0 * math.prod(half)))
    closer = JointSpring(stiffness=3.0, damping=2.0)
    stop = JointLimit(0.0, 1.8, stiffness=2e3, dissipation=0.5)
    hinges = tuple(
        Hinge(
            (0.0, 0.0, 1.0), (-half[0], 0.0, z), (0.0, 0.0, half[2] + z), bodies=(0, None),
            drives=(closer, stop) if z < 0 else (),
        )
        for z in (-0.8, 0.8)
    )  # fmt: skip
    start = {
        "position": [half[0], 0.0, half[2]],
        "velocity": [0.0, 4.0 * half[0], 0.0],
        "angular_velocity": [0.0, 0.0, 4.0],
    }
    return Example(
        "door", "door on two hinges with closer and stop", Scene(leaf, (GRAVITY, *hinges)), start, 10.0, 1e-3
    )


def four_bar() -> Example:
    """A crank of 0.3 m driven round by a motor, a coupler and a rocker: a closed loop in a plane, joints to spare."""
    crank, coupler, rocker, ground = 0.3, 0.9, 0.7, 0.8
    # The crank upright; where coupler and rocker meet, by the law of cosines.
    tip, foot = np.array([0.0, 0.0, crank]), np.array([ground, 0.0, 0.0])
    line = foot - tip
    far = float(np.linalg.norm(line))
    along = (coupler**2 - rocker**2 + far**2) / (2 * far)
    across = np.array([-line[2], 0.0, line[0]]) / far
    top = tip + line / far * along + across * math.sqrt(coupler**2 - along**2)
    rods = Rods([np.zeros(3), tip, top, foot])
    y = (0.0, 1.0, 0.0)
    motor = JointMotor(speed=6.0, gain=2.0, effort_limit=20.0)
    hinges = (
        rods.hinge(0, None, 0, y, motor), rods.hinge(1, 0, 1, y), rods.hinge(2, 1, 2, y), rods.hinge(2, None, 3, y),
    )  # fmt: skip
    bodies = tuple(rod(length, length) for length in (crank, coupler, rocker))
    return Example(
        "four_bar", "four-bar linkage with a motor", Scene(bodies, (GRAVITY, *hinges)), rods.start, 5.0, 1e-3
    )


def bricard() -> Example:
    """Bricard's mechanism: five rods of 1 m and 1 kg and six hinges along edges of a cube.

    By counting it could not move, but it does, and six hinges then say one thing too much at every place. (Benchmark of
    the IFToMM library of multibody problems; M. González et al. 2006, Multibody Syst. Dyn. 16, 1.)
    """
    corners = [(0, 0, 0), (1, 0, 0), (1, 0, -1), (1, 1, -1), (0, 1, -1), (0, 1, 0)]
    points = [np.asarray(corner, float) for corner in corners]
    rods = Rods(points)
    edges = [b - a for a, b in zip(points, [*points[1:], points[0]])]
    axes = [np.cross(edges[k - 1], edges[k]) for k in range(6)]
    hinges = [rods.hinge(0, None, 0, axes[0])]
    hinges += [rods.hinge(k, k - 1, k, axes[k]) for k in range(1, 5)]
    hinges.append(rods.hinge(4, None, 5, axes[5]))
    scene = Scene(replicate(rod(1.0, 1.0), 5), (GRAVITY, *hinges))
    return Example("bricard", "Bricard's mechanism (IFToMM)", scene, rods.start, 10.0, 1e-3)


def ragdoll() -> Example:
    """A doll of ten limbs hung up by one hand: ball joints with springs, elbows and knees that bend one way."""
    bodies, effects, rods = _doll()
    hand = [body.name for body in bodies].index("forearm l")
    effects = (*effects, rods.ball(hand, None, np.array([0.0, 0.8, 1.5])))
    return Example("ragdoll", "doll hung up by one hand", Scene(bodies, effects), rods.start, 5.0, 1e-3)


def doll_on_floor() -> Example:
    """The same doll let go above a floor: it falls on its legs, collapses, and lies there."""
    bodies, effects, rods = _doll()
    effects = (*effects, RigidContact(HalfSpace(), friction=0.6), RigidContact(friction=0.3))
    return Example(
        "doll_on_floor", "doll that falls on a floor", Scene(bodies, effects), rods.start, 4.0, 2e-3
    )


def cart(degrees: float = CART_INCLINE) -> Example:
    """A cart on four wheels rolls down an incline, with g sin α m/(m + 4 I/r²), I about the axles, m of all."""
    angle = math.radians(degrees)
    radius, half = 0.1, (0.3, 0.15, 0.05)
    wheel = Body.from_shape(Cylinder(radius, 0.02), 1000.0, "wheel")
    chassis = Body.from_shape(Box(half), 400.0, "chassis")
    # Wheels turn about their own z axes, which lie across.
    turn = Quaternion(np.array([math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0]))
    hubs = np.array([(x, y, -half[2]) for x in (-0.25, 0.25) for y in (-0.19, 0.19)])
    axles = Hinge((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), hubs, turn, bodies=((1, 2, 3, 4), (0, 0, 0, 0)))
    # α about y: x points down the incline.
    lean = np.array([math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0])
    down = np.array(
        [[math.cos(angle), 0.0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0.0, math.cos(angle)]]
    )
    floor = HalfSpace((math.sin(angle), 0.0, math.cos(angle)))
    middle = np.array([0.0, 0.0, radius + half[2]])
    places = [down @ (middle + place) for place in np.vstack([np.zeros(3), hubs])]
    w, _, y, _ = lean
    start = {
        "position": [place.tolist() for place in places],
        # lean ⊗ turn, on the host.
        "orientation": [lean.tolist(), *4 * [(np.array([w, -w, y, y]) * math.sqrt(0.5)).tolist()]],
    }
    scene = Scene((chassis, replicate(wheel, 4)), (GRAVITY, axles, RigidContact(floor, friction=0.8)))
    return Example("cart", "cart that rolls down an incline", scene, start, 2.0, 2e-3)


def _doll() -> tuple[tuple[Body, ...], tuple[Any, ...], Rods]:
    """Its limbs, gravity and joints, and where they are."""
    limbs = {
        "torso": ((0.0, 0.0, 1.1), (0.0, 0.0, 1.5), 0.14), "head": ((0.0, 0.0, 1.6), (0.0, 0.0, 1.75), 0.09),
        "arm l": ((0.0, 0.2, 1.5), (0.0, 0.5, 1.5), 0.045), "forearm l": ((0.0, 0.5, 1.5), (0.0, 0.8, 1.5), 0.035),
        "arm r": ((0.0, -0.2, 1.5), (0.0, -0.5, 1.5), 0.045), "forearm r": ((0.0, -0.5, 1.5), (0.0, -0.8, 1.5), 0.035),
        "thigh l": ((0.0, 0.1, 1.0), (0.0, 0.1, 0.6), 0.07), "shin l": ((0.0, 0.1, 0.6), (0.0, 0.1, 0.2), 0.05),
        "thigh r": ((0.0, -0.1, 1.0), (0.0, -0.1, 0.6), 0.07), "shin r": ((0.0, -0.1, 0.6), (0.0, -0.1, 0.2), 0.05),
    }  # fmt: skip
    names = list(limbs)
    ends = [(np.asarray(a), np.asarray(b)) for a, b, _ in limbs.values()]
    rods = Rods.of(ends)
    bodies = tuple(
        Body.from_shape(Capsule(radius, 0.5 * float(np.linalg.norm(b - a))), 1000.0, name)
        for (a, b), (_, _, radius), name in zip(ends, limbs.values(), names)
    )
    effects: list[Any] = [GRAVITY]
    for limb, parent in (
        ("head", "torso"),
        ("arm l", "torso"),
        ("arm r", "torso"),
        ("thigh l", "torso"),
        ("thigh r", "torso"),
    ):
        a, b = names.index(limb), names.index(parent)
        effects.append(rods.ball(a, b, ends[a][0]))
        rest = rods.seen(a, b)
        effects.append(AngularSpring(stiffness=4.0, damping=0.4, rest=rest, body_a=a, body_b=b))
    bend = JointLimit(0.0, 2.4, stiffness=200.0, dissipation=0.5)
    for limb, parent, axis in (
        ("forearm l", "arm l", (0.0, 0.0, -1.0)), ("forearm r", "arm r", (0.0, 0.0, 1.0)),
        ("shin l", "thigh l", (0.0, 1.0, 0.0)), ("shin r", "thigh r", (0.0, 1.0, 0.0)),
    ):  # fmt: skip
        a, b = names.index(limb), names.index(parent)
        effects.append(rods.hinge(a, b, ends[a][0], axis, bend, JointSpring(damping=0.2)))
    return bodies, tuple(effects), rods


JOINT_SCENES: dict[str, Callable[[], Example]] = {
    build.__name__: build
    for build in (double_pendulum, chain, door, four_bar, bricard, ragdoll, doll_on_floor, cart)
}
