"""E. Robot files and configurations: numbers 76 to 84 of the project's list of bad inputs.

All but what MuJoCo's own compiler refuses is refused before any process is started; 82, what is not supported, is in
io/test_models.py.
"""

import time

import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, LimitExceeded, UnknownName

SHELL = '<link name="l"><collision><geometry><mesh filename="{}"/></geometry></collision></link>'
BOLT = "<joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint>"
BALL = '<body name="{}"><freejoint/><geom size="0.1"/></body>'
DOCTYPE = "a document type is not read: its entities may name other files"


def model(inside="", head=""):
    return f"{head}<mujoco>\n<worldbody>{inside}{BALL.format('ball')}</worldbody></mujoco>"


def bomb():
    """Ten entities, each ten of the one before: 1e10 letters."""
    entities = "".join(f'<!ENTITY e{k} "{10 * f"&e{k - 1};"}">' for k in range(1, 11))
    return model(head=f'<?xml version="1.0"?><!DOCTYPE mujoco [<!ENTITY e0 "x">{entities}]>').replace(
        "ball", "&e10;"
    )


def link(name):
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><mass value="1"/>{inertia}</inertial></link>'


def robot(inside):
    return f"<robot name='r'>{inside}</robot>"


def deep(count):
    return model("<frame>" * count + "</frame>" * count)


def mesh(file):
    return (
        f'<mujoco><asset><mesh name="m" file="{file}"/></asset><worldbody><body><freejoint/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )


XXE = '<!DOCTYPE mujoco [<!ENTITY secret SYSTEM "file:///etc/passwd">]>'
BAD = {
    "entity bomb [76]": ("a.xml", bomb(), InvalidInput, DOCTYPE),
    "external entity [77]": ("a.xml", model(head=XXE).replace("ball", "&secret;"), InvalidInput, DOCTYPE),
    "external document type [77]": (
        "a.xml",
        model(head='<!DOCTYPE mujoco SYSTEM "http://a.example/b.dtd">'),
        InvalidInput,
        DOCTYPE,
    ),
    "external entity in a robot [77]": (
        "a.urdf",
        XXE.replace("mujoco", "robot") + "<robot name='&secret;'/>",
        InvalidInput,
        DOCTYPE,
    ),
    "depth of 50 000 [78]": (
        "a.xml",
        deep(50_000),
        LimitExceeded,
        r"a\.xml:2: elements are nested deeper than 64",
    ),
    "include outside [79]": (
        "a.xml",
        model('<include file="../secret.xml"/>'),
        InvalidInput,
        r"a\.xml:2: '\.\./secret\.xml' lies outside",
    ),
    "include of an absolute path [79]": (
        "a.xml",
        model('<include file="/etc/passwd"/>'),
        InvalidInput,
        "'/etc/passwd' lies outside",
    ),
    "include of itself [79]": (
        "a.xml",
        model('<include file="a.xml"/>'),
        InvalidInput,
        r"'a\.xml' is included a second time, or includes itself",
    ),
    "include of nothing [79]": (
        "a.xml",
        model('<include file="away.xml"/>'),
        InvalidInput,
        r"there is no file 'away\.xml'",
    ),
    "include through a link [79]": (
        "a.xml",
        model('<include file="link.xml"/>'),
        InvalidInput,
        r"'link\.xml' lies outside",
    ),
    "replicate 1e8 [80]": (
        "a.xml",
        model('<replicate count="100000000"><body/></replicate>'),
        LimitExceeded,
        r"a\.xml:2: .* unfolds to 1e\+08 bodies or more, above 10000",
    ),
    "replicate in replicate [80]": (
        "a.xml",
        model(2 * '<replicate count="9999">' + '<geom size="1"/>' + 2 * "</replicate>"),
        LimitExceeded,
        r"1e\+08 elements or more",
    ),
    "height field of 1e10 [81]": (
        "a.xml",
        '<mujoco><asset><hfield name="h" nrow="100000" ncol="100000"/></asset></mujoco>',
        LimitExceeded,
        r"a height field of 1e\+10 cells",
    ),
    "path of a mesh outside [83]": (
        "a.xml",
        mesh("../secret.stl"),
        InvalidInput,
        r"a\.xml:1: '\.\./secret\.stl' lies outside .* or give root=",
    ),
    "absolute path of a mesh [83]": (
        "a.xml",
        mesh("/etc/passwd"),
        InvalidInput,
        "'/etc/passwd' lies outside",
    ),
    "mesh from an address [83]": ("a.xml", mesh("http://a.example/b.stl"), InvalidInput, "is an address"),
    "mesh outside by its folder [83]": (
        "a.xml",
        mesh("b.stl").replace("<asset>", '<compiler meshdir=".."/><asset>'),
        InvalidInput,
        r"'\.\./b\.stl' lies outside",
    ),
    "package outside [83]": (
        "a.urdf",
        robot(SHELL.format("package://../../b.stl")),
        InvalidInput,
        "lies outside",
    ),
    "two bodies of one name [84]": (
        "a.xml",
        model("\n" + BALL.format("ball") + "\n"),
        InvalidInput,
        r"a\.xml:4: a second body has the name 'ball'; the first is at a\.xml:3",
    ),
    "two links of one name [84]": (
        "a.urdf",
        robot(2 * link("l")),
        InvalidInput,
        "a second link has the name 'l'",
    ),
    "NaN [84]": (
        "a.xml",
        model('<geom size="nan"/>'),
        InvalidInput,
        r"a\.xml:2: geom@size: 'nan' is no finite number",
    ),
    "infinity [84]": (
        "a.xml",
        model('<geom pos="0 inf 0"/>'),
        InvalidInput,
        r"geom@pos: 'inf' is no finite number",
    ),
    "text for a number [84]": (
        "a.xml",
        model('<geom size="0.1m"/>'),
        InvalidInput,
        r"geom@size: '0\.1m' is no finite number",
    ),
    "no XML": ("a.xml", "<mujoco><worldbody>", InvalidInput, r"a\.xml:1: this is no XML"),
    "another kind": ("a.xml", "<robot/>", InvalidInput, "begins with <robot>, not <mujoco>"),
    "an empty file": ("a.xml", "", InvalidInput, "this is no XML"),
}

# What the compiler itself refuses, in words of its own.
BAD_FOR_MUJOCO = {
    "unknown unit [84]": (
        "a.xml",
        "<mujoco><compiler angle='turns'/><worldbody/></mujoco>",
        "MuJoCo refuses it: .*'turns'",
    ),
    "a joint without its link [84]": ("a.urdf", robot(link("a") + BOLT), "MuJoCo refuses it: .*child"),
    "a mass that is negative [84]": (
        "a.urdf",
        robot(link("a")).replace('mass value="1"', 'mass value="-1"'),
        "MuJoCo refuses it: .*mass",
    ),
    "nothing that moves": (
        "a.xml",
        '<mujoco><worldbody><geom size="1"/></worldbody></mujoco>',
        "nothing in it moves",
    ),
}


def read(folder, name, text):
    file = folder / name
    file.write_text(text)
    return (rb.load_urdf if name.endswith("urdf") else rb.load_mjcf)(file)


@pytest.mark.parametrize("case", BAD)
def test_bad_robot_file_is_refused(case, tmp_path):
    """Within a second, and without a process: nothing that a file says is done before it was looked through."""
    name, text, kind, message = BAD[case]
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link.xml").symlink_to(tmp_path / "secret.xml")
    began = time.process_time()
    with pytest.raises(kind, match=message) as found:
        read(inner, name, text)
    assert type(found.value) is kind
    assert time.process_time() - began < 5.0


@pytest.mark.parametrize("case", BAD_FOR_MUJOCO)
def test_robot_that_cannot_be_is_refused(case, tmp_path):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra [mjcf])")
    name, text, message = BAD_FOR_MUJOCO[case]
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, name, text)


def test_unknown_names_and_units_are_refused_with_what_there_is(tmp_path):
    """[84] as far as it can arrive today."""
    with pytest.raises(UnknownName, match="did you mean RungeKutta4"):
        rb.rollout(
            rb.Scene(rb.Body(1.0, 1.0)),
            rb.Scene(rb.Body(1.0, 1.0)).state(),
            dt=1.0,
            steps=1,
            method="RungeKuta",
        )
    file = tmp_path / "a.csv"
    head = "# frame: body\ntime [s], wx [rad/s], wy [rad/s], wz [rad/s]\n"
    for text, message in (
        (head.replace("wx [rad/s]", "wx [turns]"), "unit 'turns'; write it as"),
        (head.replace("wy [rad/s]", "wx [rad/s]"), "column 'wx' stands there twice"),
        (f"{head}0, 1, nan, 3\n1, 1, 1, 1\n", "'angular_velocity' is nan"),
        (f"{head}0, 1, two, 3\n", "line 3, column 'wy' is 'two', not a number"),
    ):
        file.write_text(text)
        with pytest.raises(InvalidInput, match=message) as found:
            rb.read_recording(file)
        assert "a.csv" in str(found.value)
