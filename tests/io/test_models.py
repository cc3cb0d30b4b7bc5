"""MJCF and URDF: masses, places, joints and contact as MuJoCo compiles them, and everything else by name."""

import json
import warnings

import jax
import jax.numpy as jnp
import model_files
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.body.validity import inertia_matrix
from jaxrb.cli import main
from jaxrb.errors import InvalidInput, LimitExceeded
from jaxrb.joints.kinds import BallJoint, Hinge, Slider

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra [mjcf])")
pytest.importorskip("scipy", reason="hulls of meshes need scipy (extra [mesh])")

ONCE = pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="words, not numbers: once is enough")
NAMES = [*model_files.MJCF, *model_files.URDF]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return model_files.written(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def models(files):
    return {
        name: (rb.load_urdf if name in model_files.URDF else rb.load_mjcf)(files[name], contact=False)
        for name in NAMES
    }


def compiled(file):
    """MuJoCo's own model and data, with a robot's root let go and nothing fused."""
    spec = mujoco.MjSpec.from_file(str(file)) if file.suffix == ".xml" else None
    if spec is None:
        spec = mujoco.MjSpec.from_string(file.read_text(), assets={"part.obj": model_files.OBJ.encode()})
        spec.compiler.fusestatic = False
        spec.worldbody.first_body().add_freejoint()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # settotalmass is deprecated in MuJoCo 4
        model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def masses(model, data):
    """Of each body that moves with what is fixed to it: mass, centre and inertia about it, in the world."""
    found = {}
    for carrier in sorted({int(i) for i in model.body_weldid if i}):
        parts = [i for i in range(model.nbody) if model.body_weldid[i] == carrier]
        mass = sum(model.body_mass[i] for i in parts)
        center = sum(model.body_mass[i] * data.xipos[i] for i in parts) / mass
        inertia = np.zeros((3, 3))
        for i in parts:
            turn, d = data.ximat[i].reshape(3, 3), data.xipos[i] - center
            inertia += turn @ np.diag(model.body_inertia[i]) @ turn.T
            inertia += model.body_mass[i] * (d @ d * np.eye(3) - np.outer(d, d))
        found[carrier] = (mass, center, inertia)
    return found


def rotation_of(wxyz):
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(wxyz, float))
    return matrix.reshape(3, 3)


def test_there_are_twenty_models():
    assert len(NAMES) == 20


@pytest.mark.parametrize("name", NAMES)
def test_mass_centre_and_inertia_are_those_that_mujoco_compiles(name, files, models):
    model = models[name]
    expected = masses(*compiled(files[name]))
    assert len(expected) == len(model.scene.bodies)
    for i, (mass, center, inertia) in enumerate(expected.values()):
        body, turn = model.scene.bodies[i], rotation_of(model.start["orientation"][i])
        np.testing.assert_allclose(body.mass, mass, rtol=1e-9)
        np.testing.assert_allclose(model.start["position"][i], center, rtol=1e-9, atol=1e-9)
        found = turn @ inertia_matrix(body.inertia) @ turn.T
        np.testing.assert_allclose(found, inertia, rtol=1e-9, atol=1e-9 * np.trace(inertia))


@pytest.mark.parametrize(
    "name", ["density", "fromto", "radians and eulerseq", "axes", "frames and replicate", "mesh"]
)
def test_shapes_have_the_mass_that_the_file_gives_them(name, models, dtype):
    """The engine's own closed forms of the shapes, against the compiler's numbers: the shapes are the right ones."""
    density = {"density": 700.0}.get(name, 1000.0)
    for body in models[name].scene.bodies:
        with jax.enable_x64(True):
            shape = body.shape
            own = shape.mass_properties(density)
            own = jax.tree.map(np.asarray, own)
        # MuJoCo rounds a mesh's numbers to float32, and a run in float32 the places of a body's parts.
        exact = 2e-7 if name == "mesh" or dtype == jnp.float32 else 1e-9
        np.testing.assert_allclose(own.mass, body.mass, rtol=exact)
        np.testing.assert_allclose(own.center_of_mass, body.center_of_mass, rtol=exact, atol=exact)
        wanted = inertia_matrix(body.inertia)
        np.testing.assert_allclose(
            inertia_matrix(own.inertia), wanted, rtol=0, atol=20 * exact * np.trace(wanted)
        )


def test_joints_move_as_in_mujoco(files, models, dtype):
    """A ball joint, a sprung hinge at an offset and a slider: half a second by Runge and Kutta in both."""
    if dtype != jnp.float64:
        pytest.skip("the compared digits are beyond float32")
    model = models["arm"]
    assert [type(model.scene.effects[k]) for k, _ in model.joints.values()] == [BallJoint, Hinge, Slider]
    given, data = compiled(files["arm"])
    given.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    given.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    given.opt.timestep = 1e-3
    for _ in range(500):
        mujoco.mj_step(given, data)
    mujoco.mj_kinematics(given, data)
    mujoco.mj_comPos(given, data)
    path = rb.rollout(model.scene, model.state, dt=1e-3, steps=500, save_every=500)
    np.testing.assert_allclose(path.final.position, data.xipos[2:], atol=2e-8)
    for i, q in enumerate(np.asarray(path.final.orientation.wxyz)):
        np.testing.assert_allclose(rotation_of(q), data.xmat[2 + i].reshape(3, 3), atol=2e-7)


TOUCHING = """<mujoco><default><geom type="box" size="0.1 0.1 0.1"/></default><worldbody>
<geom name="floor" type="plane" size="1 1 1" friction="0.3" zaxis="0 1 1"/>
<geom name="post" type="cylinder" size="0.1 0.5" contype="2" conaffinity="0" friction="0.9"/>
<body name="a"><freejoint/><geom friction="0.5"/></body><body name="b"><freejoint/><geom contype="2" conaffinity="3"
friction="0.7"/></body><body name="c"><freejoint/><geom contype="0" conaffinity="4"/></body><body name="d"><freejoint/>
<geom contype="4" conaffinity="0"/><geom type="sphere" size="0.3" contype="0" conaffinity="0"/></body><body name="e">
<freejoint/><geom/></body><body name="ghost"><freejoint/><geom contype="0" conaffinity="0"/></body></worldbody>
<contact><exclude body1="a" body2="e"/></contact></mujoco>"""


def test_bodies_touch_whom_they_touch_in_mujoco(tmp_path):
    """All in one place: each pair that may touch does, in MuJoCo, and is let by the scene's rules."""
    file = tmp_path / "touching.xml"
    file.write_text(TOUCHING)
    model = rb.load_mjcf(file)
    given, data = compiled(file)
    data.qpos.reshape(-1, 7)[:, :3] = np.random.default_rng(0).uniform(-0.02, 0.02, (6, 3))
    mujoco.mj_forward(given, data)
    expected = {tuple(sorted(given.geom_bodyid[pair].tolist())) for pair in data.contact.geom}
    friction = {
        tuple(sorted(given.geom_bodyid[c.geom].tolist())): c.friction[0]
        for c in data.contact
        if c.geom.min() > 1
    }
    names, still, between, found = model.bodies, {}, {}, set()
    for effect in model.scene.effects[1:]:
        members = effect.chosen(len(names))
        value = np.broadcast_to(effect.friction, len(names))
        if effect.against is None:
            pairs = [(i, j) for i in members for j in members if i < j]
            first, second = np.array(pairs).T
            for i, j in np.array(pairs)[effect.may_touch(first, second)]:
                between[i + 1, j + 1] = max(value[i], value[j])
        else:
            found |= {(0, i + 1) for i in members}
            still |= {(type(s).__name__, names[i]): value[i] for s, _ in effect.against for i in members}
    assert found | set(between) == expected
    assert len(between) > 2
    assert (1, 5) not in between
    assert between == pytest.approx(friction)
    assert still["HalfSpace", "a"] == pytest.approx(0.5)
    assert still["Cylinder", "b"] == pytest.approx(0.9)
    assert isinstance(
        model.scene.bodies[3].shape, rb.Box
    )  # what touches nothing is no part of a shape that touches
    assert any("geom[]" in finding.path for finding in model.ignored)


UNSUPPORTED = """<mujoco model="much">
<option density="1.2" integrator="RK4"><flag filterparent="disable"/></option>
<default><joint armature="0.1"/><site size="0.1"/></default>
<asset><hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/><material name="red"/></asset>
<worldbody><light pos="0 0 3"/><geom type="hfield" hfield="hills"/><body name="a"><freejoint/>
<geom name="g" size="0.1" margin="0.1" rgba="1 0 0 1" solref="0.01 1" wobble="3"/><site name="mark"/></body>
<body name="b" pos="0 0 1" gravcomp="0.5"><joint name="j1"
range="-10 10" frictionloss="1"/><joint name="j2" axis="0 1 0"/><geom size="0.1"/></body></worldbody>
<tendon><fixed name="t"><joint joint="j1" coef="1"/></fixed></tendon>
<equality><connect body1="a" body2="b" anchor="0 0 0"/></equality>
<actuator><motor name="m" joint="j1"/></actuator><sensor><gyro site="mark"/></sensor></mujoco>"""

LISTED = {
    (2, "/mujoco/option@density"), (2, "/mujoco/option/flag@filterparent"), (3, "/mujoco/default/joint@armature"),
    (4, "/mujoco/asset/hfield[hills]"), (5, "/mujoco/worldbody/geom@type"),
    (6, "/mujoco/worldbody/body/geom[g]@margin"),
    (6, "/mujoco/worldbody/body/geom[g]@wobble"), (7, "/mujoco/worldbody/body[b]@gravcomp"),
    (7, "/mujoco/worldbody/body/joint[j1]@frictionloss"), (9, "/mujoco/tendon"), (10, "/mujoco/equality"),
    (11, "/mujoco/actuator"), (7, "joint[j1]"), (8, "joint[j2]"),
}  # fmt: skip
UNCHANGED = {
    (2, "/mujoco/option@integrator"), (3, "/mujoco/default/site"), (4, "/mujoco/asset/material[red]"),
    (5, "/mujoco/worldbody/light"), (6, "/mujoco/worldbody/body/geom[g]@rgba"),
    (6, "/mujoco/worldbody/body/geom[g]@solref"), (6, "/mujoco/worldbody/body/site[mark]"), (11, "/mujoco/sensor"),
}  # fmt: skip


def test_everything_unsupported_is_listed_with_its_line(tmp_path):
    """[82] Refused by default; with unsupported="report" the rest is read, and nothing is missing from the list."""
    file = tmp_path / "much.xml"
    file.write_text(UNSUPPORTED)
    with pytest.raises(
        InvalidInput, match=r"12 parts are not supported:\n  much\.xml:2: /mujoco/option@density"
    ):
        rb.load_mjcf(file)
    model = rb.load_mjcf(file, unsupported="report")
    assert {(f.line, f.path.split("=")[0]) for f in model.unsupported} == LISTED
    assert {(f.line, f.path.split("=")[0]) for f in model.ignored} == UNCHANGED
    assert all(finding.why and finding.file == "much.xml" for finding in (*model.unsupported, *model.ignored))
    assert "not supported: 14" in model.summary()
    assert model.bodies == ("a", "b")


# A hand excluded without its arm, geoms of one body that differ, two joints between the same bodies, a ball joint with
# a spring and stops, an angle beyond a turn, contact with friction beside contact without.
SIMPLIFIED = """<mujoco><default><geom size="0.1"/></default><worldbody><geom type="plane" size="1 1 1" condim="1"/>
<body name="a" pos="0 0 1"><freejoint/><geom friction="0.5"/><geom pos="0.3 0 0" friction="0.9"/>
<body name="hand" pos="0 0 0.3"><geom/></body></body>
<body name="b" pos="0 0 3"><joint name="ball" type="ball" stiffness="2" range="0 30"/><geom/></body>
<body name="c" pos="2 0 3"><joint name="wound" range="-400 10"/><joint name="more" type="slide"/><geom/></body>
</worldbody><contact><exclude body1="hand" body2="b"/></contact></mujoco>"""


@ONCE
def test_what_is_simplified_is_told(tmp_path):
    file = tmp_path / "simple.xml"
    file.write_text(SIMPLIFIED)
    model = rb.load_mjcf(file, unsupported="report", limit_stiffness=10.0)
    told = {finding.path: [] for finding in model.unsupported}
    for finding in model.unsupported:
        told[finding.path].append(finding.why)
    assert "all parts are excluded, since they are one body" in told["exclude[hand]"][0]
    assert "differ in contype, conaffinity, condim or friction" in told["body[a]"][0]
    assert "friction for all geoms or for none; 3 was taken" in told["geom@condim"][0]
    assert "rb.AngularSpring" in told["joint[ball]"][0]
    assert "stops of a ball joint" in told["joint[ball]"][1]
    assert "jaxrb counts no turns" in told["joint[wound]"][0]
    assert "a second joint between the same two bodies" in told["joint[more]"][0]


@ONCE
def test_a_model_whose_contact_is_off_or_without_friction(tmp_path):
    smooth = (
        '<geom type="plane" size="1 1 1" condim="1"/><body><freejoint/><geom size="0.1" condim="1"/></body>'
    )
    file = tmp_path / "smooth.xml"
    file.write_text(f"<mujoco><worldbody>{smooth}</worldbody></mujoco>")
    (touch,) = rb.load_mjcf(file).scene.effects[1:]
    assert touch.friction is None or float(np.max(touch.friction)) == 0.0
    off = '<option><flag contact="disable"/></option>'
    file.write_text(f"<mujoco>{off}<worldbody>{smooth}</worldbody></mujoco>")
    assert not any(
        isinstance(e, rb.RigidContact) for e in rb.load_mjcf(file, unsupported="report").scene.effects
    )


ROLLS = """<mujoco><option cone="elliptic" impratio="10"/><worldbody>
<geom type="plane" size="9 9 1" friction="1 0.02 0.001"/>
<body pos="0 0 0.1"><freejoint/><geom size="0.1" condim="6" friction="0.5 0.001 0.01"/></body>
<body pos="5 0 0.1"><freejoint/><geom size="0.1" condim="4" friction="0.5 0.03 0.01"/></body></worldbody></mujoco>"""


@ONCE
def test_a_model_that_resists_rolling_and_spinning(tmp_path):
    """The larger number of the two where the pair's condim counts it; MuJoCo's numbers mean what they mean here."""
    file = tmp_path / "rolls.xml"
    file.write_text(ROLLS)
    model = rb.load_mjcf(file, unsupported="report")
    floor, mutual = model.scene.effects[1:]
    assert floor.friction == 1.0
    np.testing.assert_allclose(floor.spinning_resistance, [0.02, 0.03], rtol=1e-6)
    np.testing.assert_allclose(floor.rolling_resistance, [0.01, 0.0], rtol=1e-6)
    np.testing.assert_allclose(mutual.rolling_resistance, [0.01, 0.0], rtol=1e-6)
    assert [f.why for f in model.unsupported if "different condim" in f.why]
    given, data = compiled(file)
    data.qvel[[0, 4]] = 1.0, 10.0
    mujoco.mj_step(given, data, round(0.5 / given.opt.timestep))
    assert 1.0 - data.qvel[0] == pytest.approx(5 / 7 * 9.81 * 0.01 / 0.1 * data.time, rel=0.03)


@ONCE
def test_a_model_read_wrongly_says_how_to_read_it(tmp_path):
    file = tmp_path / "one.xml"
    with pytest.raises(InvalidInput, match=r"one\.xml: there is no such file"):
        rb.load_mjcf(file)
    file.write_text('<mujoco><include file="two.xml"/><include file="two.xml"/></mujoco>')
    (tmp_path / "two.xml").write_text("<mujocoinclude/>")
    with pytest.raises(InvalidInput, match=r"'two\.xml' is included a second time"):
        rb.load_mjcf(file)
    with pytest.raises(rb.WrongStructure, match="choose 'refuse' or 'report'"):
        rb.load_mjcf(file, unsupported="ignore")


def test_stops_want_a_stiffness(tmp_path):
    file = tmp_path / "stop.xml"
    file.write_text(model_files.PENDULUM.replace('damping="0.1"', 'range="-10 40" ref="10"'))
    with pytest.raises(
        InvalidInput, match=r"stop\.xml:1: joint\[pin\]: stops need a stiffness.*limit_stiffness"
    ):
        rb.load_mjcf(file)
    effect, _ = rb.load_mjcf(file, limit_stiffness=50.0).joints["pin"]
    (stop,) = rb.load_mjcf(file, limit_stiffness=50.0).scene.effects[effect].drives
    np.testing.assert_allclose(np.rad2deg([stop.lower, stop.upper]), [-20.0, 30.0], rtol=1e-6)
    assert stop.stiffness == 50.0


def test_a_keyframe_starts_a_run(tmp_path):
    file = tmp_path / "key.xml"
    body = '<body><freejoint/><geom type="box" size="0.1 0.1 0.1" pos="0.2 0 0"/></body>'
    key = '<key name="thrown" time="2" qpos="1 2 3 0.8 0 0 0.6" qvel="1 0 0 0 0 2"/>'
    file.write_text(f"<mujoco><worldbody>{body}</worldbody><keyframe>{key}</keyframe></mujoco>")
    model = rb.load_mjcf(file, keyframe="thrown")
    given, data = compiled(file)
    mujoco.mj_resetDataKeyframe(given, data, 0)
    mujoco.mj_forward(given, data)
    motion = np.zeros(6)
    mujoco.mj_objectVelocity(given, data, mujoco.mjtObj.mjOBJ_BODY, 1, motion, 0)
    np.testing.assert_allclose(model.start["position"][0], data.xipos[1], atol=1e-12)
    np.testing.assert_allclose(model.start["velocity"][0], motion[3:], atol=1e-12)
    np.testing.assert_allclose(model.start["angular_velocity"][0], [0, 0, 2], atol=1e-12)
    assert model.state.time == 2.0
    with pytest.raises(InvalidInput, match="no keyframe 'caught'; there are thrown"):
        rb.load_mjcf(file, keyframe="caught")


def test_roots_of_robots_keep_their_mass(files, tmp_path):
    model = rb.load_urdf(files["tree"], contact=False)
    assert model.bodies == ("base", "arm")
    assert float(model.scene.bodies[0].mass) == pytest.approx(2.5)
    fixed = rb.load_urdf(files["tree"], fixed=True)
    assert fixed.bodies == ("arm",)
    assert fixed.scene.effects[1].bodies == (0, None)
    standing = tmp_path / "standing.urdf"
    text = model_files.URDF["tree"].replace('"base"', '"world"')
    standing.write_text(text.replace("package://robot/parts/", ""))
    (tmp_path / "part.obj").write_text(model_files.OBJ)
    assert rb.load_urdf(standing).bodies == ("arm",)


@pytest.mark.parametrize("ending", ["xml", "urdf"])
def test_simulate_takes_a_model(ending, tmp_path, capsys):
    file = tmp_path / f"one.{ending}"
    file.write_text(model_files.MJCF["density"] if ending == "xml" else model_files.URDF["free root"])
    main(["simulate", str(file), "--duration", "0.02", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert (told["bodies"], told["dt_s"], told["steps"]) == (1, 0.002, 10)


def test_limits_are_named(files):
    with pytest.raises(LimitExceeded, match="max_memory=20000000"):
        rb.load_mjcf(files["sphere"], max_memory=20_000_000)
    with pytest.raises(LimitExceeded, match="unfolds to 3 bodies or more, above 2"):
        rb.load_mjcf(files["arm"], max_bodies=2)
    with pytest.raises(LimitExceeded, match=r"timeout=0\.01 s"):
        rb.load_mjcf(files["sphere"], timeout=0.01)
    with pytest.raises(LimitExceeded, match="max_bytes=10"):
        rb.load_mjcf(files["sphere"], max_bytes=10)


def test_too_little_memory_is_never_the_fault_of_the_model(files):
    """At 128 MiB there is room for half of MuJoCo's modules: what that said was told as a refusal of the model."""
    limits, ended = range(96 * 2**20, 176 * 2**20, 8 * 2**20), []
    for most in limits:
        try:
            rb.load_mjcf(files["sphere"], max_memory=most)
        except LimitExceeded:
            ended.append(most)
    assert ended == list(limits[: len(ended)])  # and where that was enough, more is
    rb.load_mjcf(files["sphere"])


ARM = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="a" pos="0 0 2"><freejoint/><geom size="0.1"/>
<body name="b"><joint type="hinge" axis="0 1 0"/><geom size="0.1"/><body name="c"><joint type="hinge" axis="1 0 0"/>
<geom size="0.1"/></body></body></body></worldbody></mujoco>"""


def test_robots_with_joints_touch_whom_they_touch_in_mujoco(tmp_path):
    """Neighbours in the tree do not meet; all meet the floor."""
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    model = rb.load_mjcf(file)
    given, data = compiled(file)
    met = {tuple(sorted(given.geom_bodyid[pair] - 1)) for pair in data.contact.geom}
    contact = model.scene.prepared(model.state.dtype).contact
    assert (
        {pair for m in contact.meetings for pair in zip(m.first.tolist(), m.second.tolist())}
        == met
        == {(0, 2)}
    )
    assert [o.members for o in contact.obstacles] == [(0, 1, 2)]
