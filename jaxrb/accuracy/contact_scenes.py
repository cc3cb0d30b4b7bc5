"""Scenes with contact whose answers are known: a ball that bounces, a block that slides and stops, a cube thrown."""

import dataclasses
import difflib
import math
from collections.abc import Callable, Sequence

import numpy as np

from jaxrb.body.body import Body
from jaxrb.body.state import State
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.errors import UnknownName
from jaxrb.geometry.primitives import Box, HalfSpace
from jaxrb.scene import contact_library as library
from jaxrb.scene.contact_library import GRAVITY
from jaxrb.scene.example import Example
from jaxrb.scene.scene import Scene

_G = 9.81


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene of one body on a floor, as jaxrb and as MuJoCo know it.

    `exact(times)`: positions (k, 1, 3) [m] and quaternions (k, 1, 4) in closed form, None where there is none; `geom`:
    the body in MuJoCo's words; `events`: whether it has impacts, and `solve_events` is asked too.
    """

    example: Example
    geom: str
    friction: float
    restitution: float
    exact: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None
    events: bool

    @property
    def name(self) -> str:
        """Of the scene."""
        return self.example.name

    @property
    def about(self) -> str:
        """The scene in words."""
        return self.example.about

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.example.scene

    @property
    def duration(self) -> float:
        """[s]."""
        return self.example.duration

    def state(self) -> State:
        """The start."""
        return self.example.state()

    def mjcf(self, dt: float, spring: tuple[float, float] | None) -> str:
        """The scene for MuJoCo; its contact has this stiffness and damping, by default MuJoCo's own."""
        soft = "" if spring is None else f'solref="{spring[0]!r} {spring[1]!r}" solimp="0.9999 0.9999 0.001"'
        mass = float(np.ravel(self.scene.bodies[0].mass)[0])
        return (
            f'<mujoco><option timestep="{dt!r}" gravity="0 0 {-_G}" cone="elliptic" tolerance="1e-12"/>'
            f'<default><geom friction="{self.friction} 0 0" {soft}/></default><worldbody>'
            '<geom type="plane" size="50 50 1"/>'
            f'<body><freejoint/><geom {self.geom} mass="{mass!r}"/></body></worldbody></mujoco>'
        )

    def start_of_mujoco(self) -> tuple[np.ndarray, np.ndarray]:
        """MuJoCo's qpos (7,) and qvel (6,)."""
        state = self.state()
        place, turn = np.asarray(state.position)[0], np.asarray(state.orientation.as_quaternion_array())[0]
        # As jaxrb, MuJoCo has the angular velocity of a free joint in the body's frame.
        motion = np.asarray(state.velocity)[0], np.asarray(state.angular_velocity)[0]
        return np.concatenate([place, turn]), np.concatenate(motion)


def bouncing_ball() -> Case:
    """The library's ball: it bounces until it rolls."""
    return Case(library.bouncing_ball(), 'type="sphere" size="0.1"', 0.5, 0.8, _bounced, True)


def _bounced(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Newton's restitution gives the heights; friction suffices to set the ball rolling in its first bounce."""
    radius, bounce, speed = 0.1, 0.8, 1.0
    fall = math.sqrt(2.0 * 1.0 / _G)
    rolling = 5.0 / 7.0 * speed
    after = np.maximum(times - fall, 0.0)
    x = speed * np.minimum(times, fall) + rolling * after
    height = np.where(times < fall, 1.0 - 0.5 * _G * times**2, 0.0)
    begin, up = fall, bounce * _G * fall
    while up > 1e-18:
        inside = (times >= begin) & (times < begin + 2 * up / _G)
        height = np.where(inside, (times - begin) * (up - 0.5 * _G * (times - begin)), height)
        begin, up = begin + 2 * up / _G, bounce * up
    position = np.stack([x, np.zeros_like(x), radius + height], axis=-1)
    half = 0.5 * rolling / radius * after
    turn = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=-1)
    return position[:, None], turn[:, None]


def sliding_block(speed: float = 2.0, friction: float = 0.3) -> Case:
    """A block thrown along the floor: it slides, and stops after v²/2μg."""
    half = (0.1, 0.1, 0.05)
    block = Body.from_shape(Box(half), density=700.0)
    scene = Scene(block, (GRAVITY, RigidContact(HalfSpace(), friction=friction)))
    start = {"position": [0.0, 0.0, half[2]], "velocity": [speed, 0.0, 0.0]}
    example = Example("sliding_block", "block that slides along the floor and stops", scene, start, 1.0, 2e-3)

    def slid(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        t = np.minimum(times, speed / (friction * _G))
        x = speed * t - 0.5 * friction * _G * t**2
        position = np.stack([x, 0 * x, np.full_like(x, half[2])], axis=-1)
        turn = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(times), 4))
        return position[:, None], turn[:, None]

    size = " ".join(map(str, half))
    return Case(example, f'type="box" size="{size}"', friction, 0.0, slid, False)


def cube_toss() -> Case:
    """The library's cube, thrown on a table: bounces, rocks, slides and stops; no closed form."""
    return Case(library.cube_toss(), 'type="box" size="0.0524 0.0524 0.0524"', 0.18, 0.1, None, True)


CASES: dict[str, Callable[[], Case]] = {
    build.__name__: build for build in (bouncing_ball, sliding_block, cube_toss)
}


def cases_of(names: Sequence[str] = ()) -> list[Case]:
    """The cases of these names, by default all.

    Raises:
        UnknownName: there is no such case; the message suggests the nearest.
    """
    cases = []
    for name in names or CASES:
        key = name.lower().replace("-", "_")
        if key not in CASES:
            near = difflib.get_close_matches(key, CASES, n=1, cutoff=0.4)
            meant = f"did you mean {near[0]}? " if near else ""
            raise UnknownName(f"scene {name!r} has no known answer; {meant}There are {', '.join(CASES)}")
        cases.append(CASES[key]())
    return cases
