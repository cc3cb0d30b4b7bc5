"""Mechanisms with known motion, side by side in one scene: one program for all kinds of joints."""

import math

import jax
import mpmath
import numpy as np

import jaxrb as rb
from jaxrb.scene.joint_library import Rods, rod

GRAVITY = 9.81
DOOR_HALF = (0.4, 0.02, 0.9)
DOOR_MASS, DOOR_STIFFNESS, DOOR_DAMPING, DOOR_SPEED = 8.0, 6.0, 1.5, 2.0
SPRING, START = 40.0, 0.3
GAIN, SPEED, LIMIT = 3.0, 5.0, 2.0
LENGTH, ANGLE = 0.7, 1.1
WELD_TURN = 0.8


def _door():
    leaf = rb.Body.from_shape(rb.Box(DOOR_HALF), density=DOOR_MASS / (8 * math.prod(DOOR_HALF)))
    closer = rb.JointSpring(stiffness=DOOR_STIFFNESS, damping=DOOR_DAMPING)
    hinges = [
        rb.Hinge((0, 0, 2.0), (-DOOR_HALF[0], 0, z), (0, 0, z), bodies=(0, None), drives=drives)
        for z, drives in ((-0.7, (closer,)), (0.7, ()))
    ]
    return leaf, hinges


def _weld():
    """Two boxes, the second turned about z and set at the end of the first: together one rigid body."""
    first = rb.Body.from_shape(rb.Box((0.2, 0.1, 0.05)), 500.0)
    second = rb.Body.from_shape(rb.Box((0.1, 0.15, 0.08)), 800.0)
    rest = rb.Quaternion(np.array([math.cos(WELD_TURN / 2), 0, 0, math.sin(WELD_TURN / 2)]))
    joint = rb.Weld((-0.1, 0, 0), (0.2, 0.02, 0.01), rest, bodies=(2, 1))
    return first, second, joint


def yard(numbers):
    """The scene. Numbers: gravity () [m/s²], mass () [kg] of the bead of the distance joint, length () [m] of its rod.

    Bodies: 0 door, 1–2 welded pair, 3 slider on a spring, 4 slider with a motor, 5 bead on a rod without mass, 6 rod on
    a hinge, 7–9 four-bar linkage.
    """
    leaf, door = _door()
    first, second, weld = _weld()
    block = rb.Body.from_shape(rb.Box((0.1, 0.1, 0.1)), 250.0)  # 2 kg
    bead = rb.Body(numbers["mass"], rb.SphericalInertia(0.01))
    slides = [
        rb.Slider((1.0, 0, 0), (0, 0, 0), (0, 5.0, 0), bodies=(3, None), drives=rb.JointSpring(SPRING)),
        rb.Slider(
            (0, 1.0, 0), (0, 0, 0), (3.0, 0, 0), bodies=(4, None), drives=rb.JointMotor(SPEED, GAIN, LIMIT)
        ),
    ]
    tether = rb.Distance(numbers["length"], (0, 0, 0), (0, -3.0, 0), bodies=(5, None))
    pin = rb.Hinge((0, 1.0, 0), (0, 0, 0.5), (0, -5.0, 0), bodies=(6, None))
    bars, linkage = four_bar()
    bodies = (leaf, first, second, block, block, bead, rod(1.0, 1.5), *bars)
    gravity = rb.UniformGravity(
        jax.numpy.stack([0.0 * numbers["gravity"], 0.0 * numbers["gravity"], -numbers["gravity"]])
    )
    return rb.Scene(bodies, (gravity, *door, weld, *slides, tether, pin, *linkage))


def four_bar(first=7):
    """Crank, coupler and rocker in the plane y = 8, hinges twice as many as the plane needs."""
    rods = Rods([np.array(p, float) for p in ((0, 8, 0), (0, 8, 0.3), _top(), (0.8, 8, 0))])
    y = (0, 1.0, 0)

    def shifted(joint):
        a, b = joint.bodies
        return rb.Hinge(
            joint.axis, joint.anchor_a, joint.anchor_b, joint.rest,
            bodies=(a + first, None if b is None else b + first),
        )  # fmt: skip

    hinges = [
        rods.hinge(0, None, 0, y),
        rods.hinge(1, 0, 1, y),
        rods.hinge(2, 1, 2, y),
        rods.hinge(2, None, 3, y),
    ]
    return (rod(0.3, 0.3), rod(0.9, 0.9), rod(0.7, 0.7)), [shifted(hinge) for hinge in hinges]


def _top():
    tip, foot = np.array([0, 0.3]), np.array([0.8, 0.0])
    far = np.linalg.norm(foot - tip)
    along = (0.9**2 - 0.7**2 + far**2) / (2 * far)
    unit = (foot - tip) / far
    x, z = tip + along * unit + math.sqrt(0.9**2 - along**2) * np.array([-unit[1], unit[0]])
    return x, 8.0, z


def start():
    """Position, orientation, velocity and angular velocity (10, …) of the yard."""
    rods = Rods([np.array(p, float) for p in ((0, 8, 0), (0, 8, 0.3), _top(), (0.8, 8, 0))])
    position, wxyz, velocity, spin = (
        np.zeros((10, 3)),
        np.zeros((10, 4)),
        np.zeros((10, 3)),
        np.zeros((10, 3)),
    )
    wxyz[:, 0] = 1.0
    position[0], velocity[0], spin[0] = (
        (DOOR_HALF[0], 0, 0),
        (0, DOOR_SPEED * DOOR_HALF[0], 0),
        (0, 0, DOOR_SPEED),
    )
    # The pair turns as one: about its common centre of mass.
    second = np.array([math.cos(WELD_TURN), math.sin(WELD_TURN), 0]) * 0.1 + (0.2, 0.02, 0.01)
    position[1], position[2] = (0, 0, 9.0), np.add((0, 0, 9.0), second)
    wxyz[2] = (math.cos(WELD_TURN / 2), 0, 0, math.sin(WELD_TURN / 2))
    turning = np.array([1.0, 2.0, -1.5])
    masses = 500 * 8 * 0.2 * 0.1 * 0.05, 800 * 8 * 0.1 * 0.15 * 0.08
    middle = (masses[0] * position[1] + masses[1] * position[2]) / sum(masses)
    velocity[1], velocity[2] = (np.cross(turning, position[k] - middle) for k in (1, 2))
    c, s = math.cos(WELD_TURN), math.sin(WELD_TURN)
    spin[1], spin[2] = turning, np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ turning
    position[3], position[4] = (START, 5.0, 0), (3.0, 0, 0)
    position[5] = (LENGTH * math.sin(ANGLE), -3.0, -LENGTH * math.cos(ANGLE))
    position[6] = (-0.5 * math.sin(ANGLE), -5.0, -0.5 * math.cos(ANGLE))
    wxyz[6] = (math.cos(ANGLE / 2), 0, math.sin(ANGLE / 2), 0)
    position[7:], wxyz[7:] = rods.start["position"], rods.start["orientation"]
    return position, wxyz, velocity, spin


def numbers(dtype):
    """Those that the tests use."""
    return {
        k: jax.numpy.asarray(v, dtype) for k, v in {"gravity": GRAVITY, "mass": 1.2, "length": LENGTH}.items()
    }


def pendulum_angle(amplitude, rate, time):
    """The angle of a pendulum let go at `amplitude` [rad], `rate` √(g/l) of small swings, by Jacobi's functions."""
    k = mpmath.sin(amplitude / 2)
    quarter = mpmath.ellipk(k * k)
    return float(2 * mpmath.asin(k * mpmath.ellipfun("sn", quarter - rate * time, m=k * k)))


def pendulum_period(amplitude, rate):
    """Its period [s]."""
    return float(4 * mpmath.ellipk(mpmath.sin(amplitude / 2) ** 2) / rate)
