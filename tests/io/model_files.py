"""Small models for the readers of MJCF and URDF: together every convention that they must follow."""

BALL = '<geom type="sphere" size="0.1"/>'

# A lopsided tetrahedron with its corner off the origin.
OBJ = """v 0.1 0.2 0.3
v 0.5 0.2 0.3
v 0.1 0.5 0.3
v 0.1 0.2 0.8
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""

PENDULUM = """<mujoco><worldbody><body name="rod" pos="0 0 1" euler="0 40 0"><joint name="pin" type="hinge"
        axis="0 1 0"
pos="0 0 0.2" damping="0.1"/><geom type="capsule" size="0.03" fromto="0 0 0.2 0 0
        -0.4"/></body></worldbody></mujoco>"""

MJCF = {
    "sphere": f"<mujoco><worldbody><body><freejoint/>{BALL}</body></worldbody></mujoco>",
    "density": """<mujoco><worldbody><body pos="1 2 3"><freejoint/><geom type="box" size="0.1 0.2 0.3" density="700"/>
        </body></worldbody></mujoco>""",
    "mass": """<mujoco><worldbody><body><freejoint/><geom type="ellipsoid" size="0.1 0.2 0.3" mass="2.5"/></body>
        </worldbody></mujoco>""",
    "fromto": """<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom type="capsule" size="0.05"
        fromto="0.1 0 0 0.4 0.3 0.2"/><geom type="cylinder" size="0.1" fromto="0 0 0 0 -0.5
        0"/></body></worldbody></mujoco>""",
    "diagonal inertial": """<mujoco><worldbody><body euler="10 20 30"><freejoint/><inertial pos="0.1 0 -0.2" mass="3"
        diaginertia="0.2 0.3 0.4" euler="40 0 10"/><geom size="0.3"/></body></worldbody></mujoco>""",
    "full inertial": """<mujoco><worldbody><body><freejoint/><inertial pos="0 0.1 0" mass="2"
        fullinertia="0.5 0.6 0.7 0.05 -0.02 0.01"/></body></worldbody></mujoco>""",
    "nested and fixed": """<mujoco><worldbody><body pos="0 0 2" quat="0.8 0 0.6 0"><freejoint/><geom size="0.1"/>
        <body pos="0.3 0 0" euler="0 0 45"><geom type="box" size="0.1 0.05 0.02"/><body pos="0 0 0.2"
        axisangle="1 1 0 50">
        <geom type="cylinder" size="0.05 0.1" pos="0 0.1 0" zaxis="0 1
        1"/></body></body></body></worldbody></mujoco>""",
    "radians and eulerseq": """<mujoco><compiler angle="radian" eulerseq="ZYX"/><worldbody><body euler="0.3 0.2 0.1">
        <freejoint/><geom type="box" size="0.1 0.2 0.3" euler="0.5 -0.4 1.2" pos="0.1 0.2
        0.3"/></body></worldbody></mujoco>""",
    "lower-case eulerseq": """<mujoco><compiler eulerseq="zxy"/><worldbody><body euler="30 20 10"><freejoint/>
        <geom type="box" size="0.1 0.2 0.3" euler="50 -40 120"/></body></worldbody></mujoco>""",
    "axes": """<mujoco><worldbody><body xyaxes="0 1 0 0 0 1"><freejoint/><geom type="capsule" size="0.1 0.2"
        xyaxes="1 1 0 0 0 1" pos="0 0 0.5"/></body></worldbody></mujoco>""",
    "default classes": """<mujoco><default><geom density="500"/><default class="heavy"><geom density="8000" type="box"
        size="0.1 0.1 0.2"/></default></default><worldbody><body childclass="heavy"><freejoint/><geom/><geom
        class="main"
        type="sphere" size="0.1" pos="0 0 0.3"/></body></worldbody></mujoco>""",
    "inertia group": """<mujoco><compiler inertiagrouprange="0 1"/><worldbody><body><freejoint/><geom
        size="0.1" group="0"/>
        <geom type="box" size="0.3 0.3 0.3" group="3"/></body></worldbody></mujoco>""",
    "inertia from geoms": """<mujoco><compiler inertiafromgeom="true"/><worldbody><body><freejoint/><inertial
        pos="0 0 0"
        mass="9" diaginertia="1 1 1"/><geom type="box" size="0.1 0.2 0.4"/></body></worldbody></mujoco>""",
    "total mass": """<mujoco><compiler settotalmass="7"/><worldbody><body><freejoint/><geom size="0.1"/></body><body
        pos="1 0 0"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body></worldbody></mujoco>""",
    "frames and replicate": """<mujoco><worldbody><frame pos="1 0 0" euler="0 0 90"><replicate count="3"
        offset="0.5 0 0"
        euler="0 10 0"><body><freejoint/><geom type="box" size="0.1 0.2
        0.1"/></body></replicate></frame></worldbody></mujoco>""",
    "mesh": """<mujoco><compiler meshdir="parts"/><asset><mesh name="part" file="part.obj" scale="2 1 0.5"
        inertia="exact"/></asset><worldbody><body pos="0 0 1"><freejoint/><geom type="mesh" mesh="part"
        pos="0.1 0.2 0.3"
        euler="30 20 10"/></body></worldbody></mujoco>""",
    "mesh in the file": """<mujoco><asset><mesh name="wedge" vertex="0 0 0 1 0 0 0 1 0 0 0
        1"/></asset><worldbody><body>
        <freejoint/><geom type="mesh" mesh="wedge"/></body></worldbody></mujoco>""",
    "arm": """<mujoco><compiler autolimits="true"/><worldbody><body name="base" pos="0 0 0.5"><geom type="box"
        size="0.1 0.1 0.1"/><body name="upper" pos="0 0 0.1" euler="0 30 0"><joint name="shoulder" type="ball"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.4"/><body name="lower" pos="0 0 0.4" euler="0 60 0">
        <joint name="elbow" axis="0 1 0" stiffness="2" damping="0.1" ref="20" springref="35"/><geom type="capsule"
        size="0.02" fromto="0 0 0 0 0 0.3"/><body name="finger" pos="0.02 0 0.3"><joint name="grip"
        type="slide" axis="1 0 0"
        pos="0 0 0.05"/><geom type="ellipsoid" size="0.02 0.01
        0.05"/></body></body></body></body></worldbody></mujoco>""",
}  # fmt: skip

URDF = {
    "free root": """<robot name="r"><link name="base"><inertial><origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/><mass
        value="2"/>
        <inertia ixx="1" iyy="1.2" izz="1.5" ixy="0.1" ixz="-0.05" iyz="0.02"/></inertial><collision><origin
        xyz="0 0 0.1"
        rpy="0 1.5707963 0"/><geometry><cylinder radius="0.1" length="0.6"/></geometry></collision></link></robot>""",
    "tree": """<robot name="tree"><link name="base"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1"
        ixy="0" ixz="0"
        iyz="0"/></inertial><collision><geometry><mesh filename="package://robot/parts/part.obj" scale="1 2
        1"/></geometry>
        </collision></link><link name="plate"><inertial><origin xyz="0 0.2 0"/><mass value="0.5"/><inertia
        ixx="0.01" iyy="0.02"
        izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="arm"><inertial><origin xyz="0 0
        0.3"/><mass value="1"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="bolt"
        type="fixed"><parent
        link="base"/><child link="plate"/><origin xyz="0.5 0 0" rpy="0 0 0.7"/></joint><joint name="swivel"
        type="continuous">
        <parent link="plate"/><child link="arm"/><origin xyz="0 0 0.1" rpy="0.3 0 0"/><axis xyz="0 0
        1"/><dynamics damping="0.2"/>
        </joint></robot>""",
}  # fmt: skip


def written(folder):
    """Write every model into a folder, and the mesh that some use; `{name: file}`."""
    (folder / "parts").mkdir()
    (folder / "parts" / "part.obj").write_text(OBJ)
    found = {}
    for suffix, models in (("xml", MJCF), ("urdf", URDF)):
        for name, text in models.items():
            found[name] = folder / f"{name.replace(' ', '_')}.{suffix}"
            found[name].write_text(text)
    return found
