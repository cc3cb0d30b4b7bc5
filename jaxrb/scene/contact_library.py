"""Scenes with contact by name: bouncing, sliding, rolling, stacking, toppling."""

import itertools
import math
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, replicate
from jaxrb.draws import drawn
from jaxrb.effects.custom import CustomForce
from jaxrb.effects.effect import Wrench
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.hull import ConvexHull
from jaxrb.geometry.primitives import Box, Cylinder, HalfSpace, Sphere
from jaxrb.scene.example import Example
from jaxrb.scene.scene import Scene

GRAVITY = UniformGravity((0.0, 0.0, -9.81))


def bouncing_ball() -> Example:
    """A rubber ball thrown along the floor; friction sets it rolling, each bounce keeps 0.64 of its energy upwards."""
    ball = Body.from_shape(Sphere(0.1), density=300.0)
    scene = Scene(ball, (GRAVITY, RigidContact(HalfSpace(), friction=0.5, restitution=0.8)))
    start = {"position": [0.0, 0.0, 1.1], "velocity": [1.0, 0.0, 0.0]}
    return Example("bouncing_ball", "ball that bounces along the floor", scene, start, 5.0, 1e-3)


def billiard_break(speed: float = 8.0) -> Example:
    """The break of pool: 15 balls 0.1 mm apart, struck by the cue ball; a table of 2.54 × 1.27 m with its cushions."""
    radius, length, width = 0.028575, 2.54, 1.27
    ball = Body(0.17, 0.4 * 0.17 * radius**2, Sphere(radius))
    apart = 2 * radius + 1e-4
    rack = [
        (length / 4 + 0.5 * math.sqrt(3.0) * apart * row, apart * (k - 0.5 * row), radius)
        for row in range(5)
        for k in range(row + 1)
    ]
    cushions = tuple(
        HalfSpace(normal, -half)
        for normal, half in (
            ((1.0, 0.0, 0.0), length / 2), ((-1.0, 0.0, 0.0), length / 2),
            ((0.0, 1.0, 0.0), width / 2), ((0.0, -1.0, 0.0), width / 2),
        )
    )  # fmt: skip
    effects = (
        GRAVITY,
        RigidContact(HalfSpace(), friction=0.2, restitution=0.5),
        RigidContact(cushions, friction=0.14, restitution=0.85),
        RigidContact(friction=0.06, restitution=0.95),
    )
    start = {
        "position": [(-length / 4, 0.0, radius), *rack],
        "velocity": [(speed, 0.013 * speed, 0.0)] + 15 * [(0.0, 0.0, 0.0)],
    }
    return Example("billiard_break", "break of pool", Scene(replicate(ball, 16), effects), start, 3.0, 1e-3)


def slab_with_balls(direction: Sequence[float] = (0.0, 1.0)) -> Example:
    """25 balls on a slab that is pushed over the ground: sliding below, rolling above, with a known answer.

    (J. Hwangbo, J. Lee, SimBenchmark "rolling", leggedrobotics 2018.)
    """
    slab = Body.from_shape(Box((10.0, 10.0, 0.5)), density=10.0 / 400.0)
    ball = Body(1.0, 0.4 * 0.25, Sphere(0.5))
    along = np.asarray(direction, float)
    push = CustomForce(_push, 150.0 * np.append(along / np.linalg.norm(along), 0.0), bodies=(0,))
    effects = (
        GRAVITY,
        push,
        RigidContact(HalfSpace(), friction=0.4, bodies=(0,)),
        RigidContact(friction=0.8, groups=(1,) + 25 * (2,), masks=(2,) + 25 * (1,)),
    )
    balls = [(2.0 * (i % 5) - 4.0, 2.0 * (i // 5) - 4.0, 1.5) for i in range(25)]
    start = {"position": [(0.0, 0.0, 0.5), *balls]}
    scene = Scene((slab, replicate(ball, 25)), effects)
    return Example(
        "slab_with_balls", "balls on a slab that is pushed (SimBenchmark)", scene, start, 4.0, 1e-3
    )


def _push(body, state, force) -> Wrench:
    return Wrench(jnp.asarray(force, state.dtype), None)


def block_on_incline(degrees: float = 20.0, friction: float = 0.3) -> Example:
    """A block that slides down an incline with g (sin α − μ cos α), since μ is less than tan α."""
    angle = math.radians(degrees)
    plane = HalfSpace((math.sin(angle), 0.0, math.cos(angle)))
    half = 0.05
    block = Body.from_shape(Box((0.1, 0.1, half)), density=700.0)
    scene = Scene(block, (GRAVITY, RigidContact(plane, friction=friction)))
    start = {
        "position": [half * math.sin(angle), 0.0, half * math.cos(angle)],
        "orientation": [math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0],
    }
    return Example("block_on_incline", "block sliding down an incline", scene, start, 2.0, 2e-3)


def domino_row(count: int = 20) -> Example:
    """A row of dominoes, the first of which is tipped."""
    half = np.array([0.00375, 0.012, 0.024])
    tile = Body.from_shape(Box(half), density=650.0)
    spin = 8.0  # [rad/s] about its lower edge in front
    start = {
        "position": [(0.02 * i, 0.0, half[2]) for i in range(count)],
        "velocity": [(spin * half[2], 0.0, spin * half[0])] + (count - 1) * [(0.0, 0.0, 0.0)],
        "angular_velocity": [(0.0, spin, 0.0)] + (count - 1) * [(0.0, 0.0, 0.0)],
    }
    effects = (GRAVITY, RigidContact(HalfSpace(), friction=0.5), RigidContact(friction=0.3))
    return Example(
        "domino_row", f"{count} dominoes", Scene(replicate(tile, count), effects), start, 1.2, 1e-3
    )


def stack_of_10() -> Example:
    """Ten boxes on each other, each up to 1 cm off the middle: they must stand."""
    box = Body.from_shape(Box((0.05, 0.05, 0.05)), density=700.0)
    off = drawn(0).uniform(-0.01, 0.01, (10, 2))
    start = {"position": [(x, y, 0.05 + 0.1 * i) for i, (x, y) in enumerate(off.tolist())]}
    effects = (GRAVITY, RigidContact(HalfSpace(), friction=0.5), RigidContact(friction=0.5))
    return Example("stack_of_10", "stack of ten boxes", Scene(replicate(box, 10), effects), start, 2.0, 5e-3)


def arch(count: int = 7, friction: float = 0.8) -> Example:
    """A round arch of dry wedges: each is held only by its neighbours."""
    inner, outer, depth = 1.0, 1.3, 0.3
    ends = np.linspace(0.0, math.pi, count + 1)
    bodies, places = [], []
    for start, end in itertools.pairwise(ends):
        ring = np.array([(r * math.cos(a), r * math.sin(a)) for a in (start, end) for r in (inner, outer)])
        points = np.array([(x, y, z) for x, z in ring for y in (-depth / 2, depth / 2)])
        stone = Body.from_shape(ConvexHull(points), density=2400.0)
        bodies.append(stone)
        places.append(np.asarray(stone.center_of_mass, float).tolist())
    touch = RigidContact(friction=friction, groups=_alternate(count, 0), masks=_alternate(count, 1))
    effects = (GRAVITY, RigidContact(HalfSpace(), friction=friction), touch)
    scene = Scene(tuple(bodies), effects)
    return Example("arch", f"dry arch of {count} stones", scene, {"position": places}, 1.0, 5e-3)


def _alternate(count: int, shift: int) -> tuple[int, ...]:
    """Bit i for stone i as its group; as its mask the bits of its neighbours."""
    if not shift:
        return tuple(1 << i for i in range(count))
    return tuple((1 << (i + 1)) | (1 << (i - 1) if i else 0) for i in range(count))


def pile_of_64() -> Example:
    """Boxes of different edges, turned at random, dropped in a heap."""
    random = drawn(0)
    bodies = tuple(Body.from_shape(Box(half), density=500.0) for half in random.uniform(0.03, 0.08, (64, 3)))
    cells = np.array([(i, j, k) for k in range(4) for j in range(4) for i in range(4)], float)
    position = 0.22 * cells + [-0.33, -0.33, 0.2] + random.uniform(-0.02, 0.02, (64, 3))
    turned = random.normal(size=(64, 4))
    start = {
        "position": position.tolist(),
        "orientation": (turned / np.linalg.norm(turned, axis=1, keepdims=True)).tolist(),
    }
    effects = (GRAVITY, RigidContact(HalfSpace(), friction=0.6), RigidContact(friction=0.5))
    return Example("pile_of_64", "64 boxes dropped in a heap", Scene(bodies, effects), start, 2.0, 2e-3)


def spheres_216(elastic: bool = False, seed: int = 0, capacity: int | None = None) -> Example:
    """6 × 6 × 6 balls with small gaps that fall on the floor and on each other; `elastic`: dropped from 1 m more.

    (J. Hwangbo, J. Lee, SimBenchmark "666", leggedrobotics 2018; the jitter of the places is not theirs.)
    """
    random = drawn(seed)
    cells = np.array([(i, j, k) for k in range(6) for j in range(6) for i in range(6)], float)
    jitter = np.append(random.uniform(-1e-3, 1e-3, (216, 2)), random.uniform(0.0, 1e-3, (216, 1)), axis=1)
    position = 0.21 * cells + [0.0, 0.0, 1.101 if elastic else 0.101] + jitter
    ball = Body(10.0, 0.4 * 10.0 * 0.1**2, Sphere(0.1))
    bounce = 1.0 if elastic else None
    effects = (
        GRAVITY,
        RigidContact(HalfSpace(), restitution=bounce),
        RigidContact(restitution=bounce, capacity=capacity),
    )
    scene = Scene(replicate(ball, 216), effects)
    start = {"position": position.tolist()}
    return Example("spheres_216", "216 smooth balls (SimBenchmark 666)", scene, start, 2.0, 5e-3)


def sphere_box(count: int = 1000, friction: float | None = 0.3, seed: int = 0) -> Example:
    """Balls of 10 cm, a little apart, that fall into a heap in an open box as wide as they are high."""
    radius, side = 0.05, math.ceil(count ** (1 / 3))
    random, apart = drawn(seed), 2.1 * 0.05
    cells = np.array([(i, j, k) for k in range(side) for j in range(side) for i in range(side)], float)[
        :count
    ]
    position = apart * (cells + 0.5) + random.uniform(-0.02, 0.02, (count, 3)) * radius
    walls = (
        HalfSpace(),
        HalfSpace((1.0, 0.0, 0.0), 0.0), HalfSpace((-1.0, 0.0, 0.0), -side * apart),
        HalfSpace((0.0, 1.0, 0.0), 0.0), HalfSpace((0.0, -1.0, 0.0), -side * apart),
    )  # fmt: skip
    effects = (
        GRAVITY,
        RigidContact(walls, friction=friction),
        RigidContact(friction=friction, solver="sparse"),
    )
    ball = Body.from_shape(Sphere(radius), density=1000.0)
    scene = Scene(replicate(ball, count), effects)
    return Example("sphere_box", f"{count} balls in a box", scene, {"position": position.tolist()}, 1.5, 5e-3)


def cube_toss() -> Example:
    """A cube thrown on a table, of the size and mass of that of the ContactNets recordings (Pfrommer et al. 2020)."""
    cube = Body.from_shape(Box((0.0524, 0.0524, 0.0524)), density=0.37 / 0.1048**3)
    scene = Scene(cube, (GRAVITY, RigidContact(HalfSpace(), friction=0.18, restitution=0.1)))
    start = {
        "position": [0.0, 0.0, 0.35],
        "orientation": [0.8, 0.36, 0.48, 0.0],
        "velocity": [1.2, 0.3, -0.5],
        "angular_velocity": [3.0, 8.0, -2.0],
    }
    return Example("cube_toss", "cube thrown on a table", scene, start, 1.5, 1e-3)


def spinning_coin() -> Example:
    """A coin of 2 euro, stood nearly upright and spun: it leans ever more and rattles down."""
    radius, half = 0.012875, 0.0011
    coin = Body.from_shape(Cylinder(radius, half), density=0.0085 / (math.pi * radius**2 * 2 * half))
    lean = math.radians(75.0)  # of its axis from the vertical
    scene = Scene(coin, (GRAVITY, RigidContact(HalfSpace(), friction=0.3)))
    start = {
        "position": [0.0, 0.0, radius * math.sin(lean) + half * math.cos(lean)],
        "orientation": [math.cos(lean / 2), math.sin(lean / 2), 0.0, 0.0],
        "angular_velocity": [0.0, 30.0 * math.sin(lean), 30.0 * math.cos(lean)],
    }
    return Example("spinning_coin", "coin spun on its edge", scene, start, 2.0, 5e-5)


def tippe_top() -> Example:
    """A ball whose centre of mass lies below its middle: spun fast, friction turns it over.

    (M. C. Ciocci, B. Malengier, B. Langerock, B. Grimonprez, "Towards a prototype of a spherical tippe top", 2012:
    6 g, 15 mm, 3 mm off, 155 rad/s.)
    """
    mass, radius, off = 0.006, 0.015, 0.003
    about_axis = 0.4 * mass * radius**2
    across = 131.0 / 350.0 * mass * radius**2
    top = Body(mass, (across, across, about_axis), Sphere(radius), center_of_mass=(0.0, 0.0, -off))
    lean, spin = 0.1, 155.0
    scene = Scene(top, (GRAVITY, RigidContact(HalfSpace(), friction=0.3)))
    start = {
        "position": [0.0, off * math.sin(lean), radius - off * math.cos(lean)],
        "orientation": [math.cos(lean / 2), math.sin(lean / 2), 0.0, 0.0],
        "angular_velocity": [0.0, spin * math.sin(lean), spin * math.cos(lean)],
    }
    return Example("tippe_top", "top that turns over", scene, start, 4.0, 5e-4)


CONTACT_SCENES: dict[str, Callable[[], Example]] = {
    build.__name__: build
    for build in (
        bouncing_ball, billiard_break, slab_with_balls, block_on_incline, domino_row, stack_of_10, arch, pile_of_64,
        spheres_216, sphere_box, cube_toss, spinning_coin, tippe_top,
    )
}  # fmt: skip
