"""What jaxrb understands of MJCF: each element, where it may stand, and what each of its attributes may be.

A list of what is understood, not of what is not: an element that a later MuJoCo brings is then unsupported by itself.
(MuJoCo's "XML Reference" for the meaning; the tables are ours.)
"""

from collections.abc import Mapping
from typing import NamedTuple


class Rule(NamedTuple):
    """What an attribute may be. `kind`: "text", "numbers", "file", "only" (one of `values`, else it is reported and
    left out), "needs" (one of `values`, else the whole element is), "ignored"."""

    kind: str
    values: tuple[str, ...] = ()
    why: str = ""


class Element(NamedTuple):
    """An element that is understood: the elements in which it may stand, and its attributes."""

    parents: frozenset[str]
    attributes: Mapping[str, Rule]


class Vocabulary(NamedTuple):
    """Elements that are understood, elements that change no motion and why, and why others are not supported."""

    root: str
    elements: Mapping[str, Element]
    ignored: Mapping[str, str]
    unsupported: Mapping[str, str]
    named: frozenset[str]  # elements of which no two may have one name


def text(names: str) -> dict[str, Rule]:
    """Attributes that are words."""
    return {name: Rule("text") for name in names.split()}


def numbers(names: str) -> dict[str, Rule]:
    """Attributes that are finite numbers."""
    return {name: Rule("numbers") for name in names.split()}


def only(values: str, why: str, names: str) -> dict[str, Rule]:
    """Attributes that may have these values alone; others are reported."""
    return {name: Rule("only", tuple(values.split()), why) for name in names.split()}


def ignored(why: str, names: str) -> dict[str, Rule]:
    """Attributes that change no motion."""
    return {name: Rule("ignored", (), why) for name in names.split()}


LOOKS = "how it looks"
_SOFT = "softness of MuJoCo's constraints; jaxrb's joints and contacts are rigid"
_SOLVER = "a setting of MuJoCo's own solver"
_SPACES = frozenset({"worldbody", "body", "frame", "replicate"})
_PLACE = {**text("name class childclass"), **numbers("pos quat axisangle xyaxes zaxis euler")}
_NO_LINEAR = "jaxrb's joints have no such force"

_GEOM = {
    **_PLACE,
    "type": Rule(
        "needs",
        ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh"),
        "jaxrb has no such shape",
    ),
    **text("mesh shellinertia"),
    **numbers("size fromto mass density contype conaffinity friction group fitscale"),
    **only("1 3 4 6", "MuJoCo itself knows no other", "condim"),
    **only("0", "rigid contact has no such quantity", "margin gap adhesion"),
    **only("0 0.0", "contact knows one coefficient a body", "priority"),
    **only("none", "jaxrb has no such fluid force", "fluidshape"),
    **ignored(LOOKS, "rgba material user castshadow"),
    **ignored(_SOFT, "solref solimp solmix"),
}
_JOINT = {
    **text("name class limited"),
    "type": Rule("needs", ("hinge", "slide", "ball", "free"), "jaxrb has no such joint"),
    **numbers("pos axis range stiffness damping ref springref springdamper group"),
    **only("0", _NO_LINEAR, "armature frictionloss margin"),
    **ignored(_SOFT, "solreflimit solimplimit solreffriction solimpfriction"),
    **ignored("bounds of actuators, of which there are none", "actuatorfrcrange actuatorfrclimited actuatorgravcomp"),
    **ignored("MuJoCo's own", "user"),
}  # fmt: skip

_ELEMENTS = {
    "mujoco": (frozenset({""}), text("model")),
    "mujocoinclude": (frozenset({""}), {}),
    "compiler": (
        frozenset({"mujoco"}),
        {
            **text("angle eulerseq autolimits meshdir assetdir inertiafromgeom balanceinertia alignfree fitaabb"),
            **text("exactmeshinertia convexhull"),
            **numbers("boundmass boundinertia settotalmass inertiagrouprange"),
            **only("local", "MuJoCo has left it too", "coordinate"),
            **ignored(LOOKS, "texturedir discardvisual"),
            **ignored("a setting of MuJoCo's own compiler", "usethread strippath fusestatic saveinertial degree"),
        },
    ),
    "option": (
        frozenset({"mujoco"}),
        {
            **numbers("timestep gravity"),
            **only("0", "add an effect of a medium, such as rb.QuadraticDrag, to the scene", "wind density viscosity"),
            **ignored(_SOLVER, "integrator solver cone jacobian iterations tolerance impratio ls_iterations"),
            **ignored(_SOLVER, "ls_tolerance noslip_iterations noslip_tolerance ccd_iterations ccd_tolerance"),
            **ignored(_SOLVER, "sdf_iterations sdf_initpoints sleep_tolerance apirate mpr_iterations mpr_tolerance"),
            **ignored("without the flag 'override' of no effect", "o_margin o_solref o_solimp o_friction"),
            **ignored("there are no sensors and actuators", "magnetic actuatorgroupdisable"),
        },
    ),
    "flag": (
        frozenset({"option"}),
        {
            **text("gravity contact"),
            **only("enable", "jaxrb always has it", "limit constraint equality spring damper passive filterparent"),
            **only("disable", _SOFT, "override"),
            **ignored(_SOLVER, "frictionloss refsafe sensor midphase nativeccd island warmstart eulerdamp autoreset"),
            **ignored(_SOLVER, "multiccd energy fwdinv invdiscrete sleep clampctrl actuation"),
        },
    ),
    "default": (frozenset({"mujoco", "mujocoinclude", "default"}), text("class")),
    "asset": (frozenset({"mujoco"}), {}),
    "mesh": (
        frozenset({"asset", "default"}),
        {
            **text("name class inertia"),
            "file": Rule("file"),
            **numbers("scale vertex face"),
            **only("0", "place the geom instead", "refpos"),
            **only("1", "place the geom instead", "refquat"),
            **ignored(LOOKS, "normal texcoord smoothnormal material"),
            **ignored("jaxrb takes the whole hull", "maxhullvert octree_maxdepth"),
            **ignored("said by the file's name", "content_type"),
        },
    ),
    "worldbody": (frozenset({"mujoco"}), {}),
    "body": (
        _SPACES,
        {
            **_PLACE,
            **only("false", "drive it by rb.PrescribedMotion", "mocap"),
            **only("0", "add a force to the scene", "gravcomp"),
            **ignored(_SOLVER, "sleep user"),
        },
    ),
    "frame": (_SPACES, _PLACE),
    "replicate": (_SPACES, {**numbers("count offset euler"), **text("sep childclass")}),
    "inertial": (frozenset({"body"}), {**_PLACE, **numbers("mass diaginertia fullinertia")}),
    "joint": (_SPACES | {"default"}, _JOINT),
    "freejoint": (_SPACES, {**text("name align"), **numbers("group")}),
    "geom": (_SPACES | {"default"}, _GEOM),
    "contact": (frozenset({"mujoco"}), {}),
    "exclude": (frozenset({"contact"}), text("name body1 body2")),
    "keyframe": (frozenset({"mujoco"}), {}),
    "key": (
        frozenset({"keyframe"}),
        {
            **text("name"),
            **numbers("time qpos qvel"),
            **ignored("there are no actuators and mocap bodies", "act ctrl mpos mquat"),
        },
    ),
}  # fmt: skip

MJCF = Vocabulary(
    "mujoco",
    {tag: Element(*what) for tag, what in _ELEMENTS.items()},
    {
        **dict.fromkeys(("visual", "texture", "material", "skin", "camera", "light"), LOOKS),
        "statistic": LOOKS,
        "size": "MuJoCo's own memory",
        "custom": "numbers for other programs",
        "sensor": "sensors push nothing; read the state",
        "site": "a mark without mass",
    },
    {
        "actuator": "give the joint a rb.JointMotor or rb.JointServo",
        "tendon": "use rb.SpringDamper or rb.Distance",
        "equality": "use rb.BallJoint, rb.Weld or rb.Distance",
        "hfield": "jaxrb has no height field; use convex pieces",
        "deformable": "jaxrb's bodies are rigid",
        "flexcomp": "jaxrb's bodies are rigid",
        "composite": "write the bodies out",
        "attach": "write the other model's bodies here",
        "extension": "jaxrb runs no plugins",
        "plugin": "jaxrb runs no plugins",
        "pair": "give the bodies their friction",
    },
    frozenset({"body", "geom", "joint", "mesh"}),
)
