"""Models in MJCF and URDF for the fuzzer: whole ones to spoil, and what reads them."""

from pathlib import Path

import jax
import numpy as np

from jaxrb.io.models import Model, load_mjcf, load_urdf

_ARM = b"""<mujoco model="arm"><compiler angle="degree"/><option timestep="0.002" gravity="0 0 -9.81"/>
<default><geom density="500"/><default class="thin"><geom size="0.02"/></default></default>
<asset><mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
<worldbody><body name="upper" pos="0 0 1" euler="0 30 0"><joint name="shoulder" type="ball"/>
<geom class="thin" type="capsule" fromto="0 0 0 0 0 -0.4"/><body name="lower" pos="0 0 -0.4">
<joint name="elbow" type="hinge" axis="0 1 0" stiffness="2" damping="0.1"/>
<inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.01 0.01 0.002"/>
<geom type="mesh" mesh="wedge" contype="0" conaffinity="0"/></body></body></worldbody></mujoco>"""
_HEAP = b"""<mujoco><worldbody><geom type="plane" size="1 1 0.1" friction="0.7"/>
<body pos="0 0 0.5" quat="0.9 0.1 0.2 0.3"><freejoint/><geom type="box" size="0.1 0.2 0.05" mass="2"/></body>
<body pos="0 0 1"><freejoint/><geom type="sphere" size="0.1"/><geom type="ellipsoid" size="0.1 0.05 0.2" pos="0.1 0 0"/>
</body></worldbody><keyframe><key name="thrown" qvel="0 0 1 0 0 0 0 0 0 0 1 0"/></keyframe></mujoco>"""
_LINKS = b"""<robot name="door"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="frame"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="leaf"><inertial><origin xyz="0.4 0 0" rpy="0 0 0.3"/><mass value="10"/>
<inertia ixx="0.5" iyy="1.0" izz="0.6" ixy="0.01" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.4 0 0"/><geometry><box size="0.8 0.04 2"/></geometry></collision></link>
<joint name="hinge" type="continuous"><parent link="frame"/><child link="leaf"/><origin xyz="0 0 1" rpy="0 0 0"/>
<axis xyz="0 0 1"/><dynamics damping="0.2"/></joint></robot>"""


def mjcf() -> list[bytes]:
    """Whole models."""
    return [_ARM, _HEAP]


def urdf() -> list[bytes]:
    """Whole models."""
    return [_LINKS]


def read_mjcf(path: Path) -> str | None:
    """Read one; a complaint where what was accepted is no model."""
    return _unsound(load_mjcf(path, unsupported="report"))


def read_urdf(path: Path) -> str | None:
    """Read one; a complaint where what was accepted is no model."""
    return _unsound(load_urdf(path, unsupported="report"))


def _unsound(model: Model) -> str | None:
    numbers = [leaf for leaf in jax.tree.leaves((model.scene, model.state)) if np.ndim(leaf) or np.size(leaf)]
    bad = [leaf for leaf in numbers if np.asarray(leaf).dtype.kind == "f" and not np.isfinite(leaf).all()]
    return f"accepted a model with {np.asarray(bad[0]).ravel()[:3]}" if bad else None
