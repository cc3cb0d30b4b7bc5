"""What jaxrb understands of URDF, and of MuJoCo's own additions to it (an element `mujoco` in the robot)."""

from jaxrb.io.models.vocabulary import LOOKS, MJCF, Element, Rule, Vocabulary, ignored, numbers, only, text

_SHAPE = frozenset({"geometry"})
_NO_MOTOR = "it bounds or describes a motor, and none is loaded"
_COMPILER = MJCF.elements["compiler"].attributes

_ELEMENTS = {
    "robot": (frozenset({""}), {**text("name"), **ignored("the format's version", "version")}),
    "link": (frozenset({"robot"}), {**text("name"), **ignored("not of the standard", "type")}),
    "inertial": (frozenset({"link"}), {}),
    "origin": (frozenset({"inertial", "collision", "joint"}), numbers("xyz rpy")),
    "mass": (frozenset({"inertial"}), numbers("value")),
    "inertia": (frozenset({"inertial"}), numbers("ixx iyy izz ixy ixz iyz")),
    "collision": (frozenset({"link"}), {**text("name"), **ignored("not of the standard", "group")}),
    "geometry": (frozenset({"collision"}), {}),
    "box": (_SHAPE, numbers("size")),
    "sphere": (_SHAPE, numbers("radius")),
    "cylinder": (_SHAPE, numbers("radius length")),
    "capsule": (_SHAPE, numbers("radius length")),
    "mesh": (_SHAPE, {"filename": Rule("file"), **numbers("scale")}),
    "joint": (
        frozenset({"robot"}),
        {
            **text("name"),
            "type": Rule(
                "needs",
                ("revolute", "continuous", "prismatic", "fixed", "floating", "spherical"),
                "jaxrb has no such joint",
            ),
        },
    ),
    "parent": (frozenset({"joint"}), text("link")),
    "child": (frozenset({"joint"}), text("link")),
    "axis": (frozenset({"joint"}), numbers("xyz")),
    "limit": (frozenset({"joint"}), {**numbers("lower upper"), **ignored(_NO_MOTOR, "effort velocity")}),
    "dynamics": (
        frozenset({"joint"}),
        {**numbers("damping"), **only("0", "jaxrb's joints have no dry friction", "friction")},
    ),
    "mujoco": (frozenset({"robot"}), {}),
    "compiler": (
        frozenset({"mujoco"}),
        {
            name: rule
            for name, rule in _COMPILER.items()
            if name not in ("discardvisual", "strippath", "fusestatic")
        }
        | only("true", "only what collides is read", "discardvisual")
        | ignored("files are found by their whole path", "strippath")
        | ignored("what moves together becomes one body", "fusestatic"),
    ),
    "option": (frozenset({"mujoco"}), MJCF.elements["option"].attributes),
}

URDF = Vocabulary(
    "robot",
    {tag: Element(*what) for tag, what in _ELEMENTS.items()},
    {
        "visual": LOOKS,
        "material": LOOKS,
        "size": "MuJoCo's own memory",
        **dict.fromkeys(("transmission", "safety_controller", "calibration"), _NO_MOTOR),
    },
    {
        "mimic": "jaxrb has no gear between joints",
        "gazebo": "an addition of Gazebo's; say what it means in the standard's words",
        "ros2_control": "give the joint a rb.JointMotor or rb.JointServo",
    },
    frozenset({"link", "joint"}),
)
