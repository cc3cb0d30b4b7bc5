"""Joints from a compiled model. Joints of one kind become one value: the program is then that of one."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxrb.io.models.bodies import name_of, turned
from jaxrb.io.models.survey import Finding, Survey
from jaxrb.joints.drives import JointLimit, JointSpring
from jaxrb.joints.joint import Joint
from jaxrb.joints.kinds import BallJoint, Hinge, Slider
from jaxrb.math.quaternion import Quaternion

_KINDS = {"hinge": Hinge, "slide": Slider, "ball": BallJoint}


def joints_of(
    answer: Mapping[str, Any],
    movers: Sequence[int],
    centers: np.ndarray,
    survey: Survey,
    limit_stiffness: float | None,
) -> tuple[list[Joint], dict[str, tuple[int, int]], list[Finding]]:
    """The joints, where each name is among them (value, row), and what they leave out."""
    findings: list[Finding] = []
    groups: dict[Any, list[dict[str, Any]]] = {}
    seen: set[int] = set()
    for joint in answer["joints"]:
        name = joint["name"] or f"joint of {name_of(answer, joint['body'])}"

        def tell(why: str, joint: Mapping[str, Any] = joint, name: str = name) -> None:
            findings.append(Finding(*survey.place("joint", joint["name"]), f"joint[{name}]", why))

        if joint["more_terms"]:
            tell("stiffness and damping of more than one number are not supported; the first was taken")
        if joint["body"] in seen:
            tell("a second joint between the same two bodies; put a body with mass between them")
            continue
        seen.add(joint["body"])
        if joint["type"] in ("free", "ball"):
            _without_drives(joint, tell)
        if joint["type"] == "free":
            continue
        limited = joint["range"] is not None and joint["type"] != "ball"
        if limited and limit_stiffness is None:
            tell("stops need a stiffness, which the file has not: give limit_stiffness=… [N m/rad or N/m]")
            limited = False
        if joint["type"] == "hinge" and _beyond_a_turn(joint, limited):
            tell("an angle beyond ±π of its stops or spring; jaxrb counts no turns")
            limited = False
        sprung = joint["type"] != "ball" and bool(joint["stiffness"] or joint["damping"])
        on_world = answer["bodies"][joint["body"]]["above"] == 0
        groups.setdefault((joint["type"], on_world, sprung, limited), []).append(joint | {"name": name})
    values, names = [], {}
    for (kind, on_world, sprung, limited), members in groups.items():
        names |= {member["name"]: (len(values), row) for row, member in enumerate(members)}
        drives = _drives(members, limit_stiffness, sprung, limited)
        values.append(_value(_KINDS[kind], answer, members, movers, centers, on_world, drives))
    return values, names, findings


def _without_drives(joint: Mapping[str, Any], tell: Any) -> None:
    if joint["stiffness"] or joint["damping"]:
        tell(f"stiffness and damping of a {joint['type']} joint; use rb.AngularSpring or rb.LinearDrag")
    if joint["range"] is not None:
        tell(f"stops of a {joint['type']} joint are not supported")


def _beyond_a_turn(joint: Mapping[str, Any], limited: bool) -> bool:
    ends = [end - joint["reference"] for end in joint["range"]] if limited else []
    rest = [joint["spring_rest"]] if joint["stiffness"] else []
    return any(abs(angle) > np.pi for angle in (*ends, *rest))


def _drives(
    members: Sequence[Mapping[str, Any]], limit_stiffness: float | None, sprung: bool, limited: bool
) -> tuple:
    drives = []
    if sprung:
        columns = [[m[name] for m in members] for name in ("stiffness", "damping", "spring_rest")]
        drives.append(JointSpring(*(_leading(column) for column in columns)))
    if limited:
        ends = [[m["range"][k] - m["reference"] for m in members] for k in (0, 1)]
        drives.append(JointLimit(*(_leading(end) for end in ends), stiffness=float(limit_stiffness or 0.0)))
    return tuple(drives)


def _value(
    kind: type[Joint],
    answer: Mapping[str, Any],
    members: Sequence[Mapping[str, Any]],
    movers: Sequence[int],
    centers: np.ndarray,
    on_world: bool,
    drives: tuple,
) -> Joint:
    """One joint, or several of a kind: a is the body that has the joint, b what it hangs on."""
    number = {mover: i for i, mover in enumerate(movers)}
    bodies = [answer["bodies"][m["body"]] for m in members]
    a = tuple(number[m["body"]] for m in members)
    b = None if on_world else tuple(number[body["above"]] for body in bodies)
    point = np.asarray([m["point"] for m in members], float)
    position, turn = (np.asarray([body["pose_above"][k] for body in bodies], float) for k in (0, 1))
    with jax.enable_x64(True):
        arm = np.stack([turned(q, p) for q, p in zip(turn, point)])
    ends = {
        "anchor_a": _leading(point - centers[list(a)]),
        "anchor_b": _leading(position + arm - (0.0 if b is None else centers[list(b)])),
    }
    if kind is not BallJoint:
        ends |= {
            "axis": _leading([m["axis"] for m in members]),
            "rest": Quaternion(_leading(turn)),
            "drives": drives,
        }
    one = len(members) == 1
    return kind(**ends, bodies=(a[0] if one else a, b if b is None else (b[0] if one else b)))


def _leading(rows: Any) -> np.ndarray:
    """Numbers with a leading axis over joints, or those of the only one."""
    array = np.asarray(rows, float)
    return array[0] if len(array) == 1 else array
