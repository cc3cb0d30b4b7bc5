"""Compiling a model with MuJoCo, in a process of its own: this file is run, never imported.

It gets, on its standard input, a line of JSON (the document, limits, names and lengths of the meshes) and then the
meshes' bytes, and answers with one JSON object. It opens no file of the model: what the document may name was read by
`survey.py`. Poses are composed here, in float64, by MuJoCo's own functions.
"""

import importlib
import json
import os
import sys
import warnings
from typing import Any

# Beyond these bits MuJoCo does something else than what a document says.
_NO_GRAVITY, _NO_CONTACT = "mjDSBL_GRAVITY", "mjDSBL_CONTACT"


def main() -> None:
    """Answer one job."""
    job = json.loads(sys.stdin.buffer.readline())
    assets = {name: sys.stdin.buffer.read(size) for name, size in job["assets"].items()}
    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no part of the answer
    # Loaded before the limit holds: cut short in that, it says of a good model that MuJoCo refuses it.
    mujoco = importlib.import_module("mujoco")
    try:
        _limit(job["max_memory"])
        found = _compiled(mujoco, job, assets)
    except MemoryError:
        found = {"memory": True}
    except Exception as error:
        said = " ".join(str(error).split())
        found = {"memory": True} if "allocate memory" in said else {"error": said}
    json.dump(found, answer)
    answer.flush()


def _limit(most: int) -> None:
    try:
        import resource
    except ImportError:  # no such limits on Windows; the time limit holds there too
        return
    if _taken() > most:
        raise MemoryError
    for kind, value in ((resource.RLIMIT_AS, most), (resource.RLIMIT_FSIZE, 0), (resource.RLIMIT_CORE, 0)):
        resource.setrlimit(kind, (value, value))


def _taken() -> int:
    """Address space of this process [bytes], zero where the system does not tell."""
    try:
        with open("/proc/self/statm") as told:
            return int(told.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def _compiled(mujoco: Any, job: dict[str, Any], assets: dict[str, bytes]) -> dict[str, Any]:
    warned: list[str] = []
    mujoco.set_mju_user_warning(lambda text: warned.append(str(text)))
    warnings.showwarning = lambda message, *_: warned.append(str(message))
    spec = mujoco.MjSpec.from_string(job["document"], assets=assets)
    spec.compiler.fusestatic = False  # or names that messages and excludes speak of are gone
    if job["free_root"]:
        for body in spec.worldbody.bodies:
            if not body.joints:
                body.add_freejoint()
    inline = {mesh.name: list(mesh.uservert) for mesh in spec.meshes if not mesh.file}
    files = {mesh.name: mesh.file for mesh in spec.meshes if mesh.file}
    model = spec.compile()
    if model.nbody - 1 > job["max_bodies"]:
        return {"too_many": model.nbody - 1}
    data = mujoco.MjData(model)
    key = _keyframe(mujoco, model, job["keyframe"])
    if key is not None:
        mujoco.mj_resetDataKeyframe(model, data, key)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    disabled = int(model.opt.disableflags)
    flags = mujoco.mjtDisableBit
    return {
        "name": spec.modelname,
        "timestep": model.opt.timestep,
        "gravity": [0.0, 0.0, 0.0] if disabled & int(getattr(flags, _NO_GRAVITY)) else model.opt.gravity.tolist(),
        "contact": not disabled & int(getattr(flags, _NO_CONTACT)),
        "time": data.time,
        "bodies": [_body(mujoco, model, data, i) for i in range(model.nbody)],
        "joints": [_joint(model, j) for j in range(model.njnt)],
        "geoms": [_geom(mujoco, model, g, files, inline) for g in range(model.ngeom)],
        "excludes": [[int(s) >> 16, int(s) & 0xFFFF] for s in model.exclude_signature],
        "warnings": warned,
    }  # fmt: skip


def _keyframe(mujoco: Any, model: Any, wanted: str | int | None) -> int | None:
    if wanted is None:
        return None
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, wanted) if isinstance(wanted, str) else wanted
    if not 0 <= number < model.nkey:
        names = [model.key(k).name or str(k) for k in range(model.nkey)]
        raise ValueError(f"there is no keyframe {wanted!r}; there are {', '.join(names) or 'none'}")
    return number


def _composed(mujoco: Any, outer: tuple[Any, Any], inner: tuple[Any, Any]) -> tuple[Any, Any]:
    import numpy as np

    position, turn = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(position, turn, *outer, *inner)
    return position, turn


def _in_carrier(mujoco: Any, model: Any, body: int, carrier: int) -> tuple[Any, Any]:
    """The pose of a body in the frame of the body that carries it, at the model's reference position."""
    import numpy as np

    pose = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    while body != carrier:
        pose = _composed(mujoco, (model.body_pos[body], model.body_quat[body]), pose)
        body = int(model.body_parentid[body])
    return pose


def _body(mujoco: Any, model: Any, data: Any, i: int) -> dict[str, Any]:
    """A body; `carrier` is the nearest one above it that moves by itself, or the world: they move as one."""
    import numpy as np

    carrier = int(model.body_weldid[i])
    position, turn = _in_carrier(mujoco, model, i, carrier)
    motion = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, i, motion, 0)
    above = int(model.body_weldid[model.body_parentid[i]])
    place = position * 0, turn * 0
    if carrier == i and i:
        parent = int(model.body_parentid[i])
        on = _in_carrier(mujoco, model, parent, above)
        place = _composed(mujoco, on, (model.body_pos[i], model.body_quat[i]))
    return {
        "name": model.body(i).name,
        "carrier": carrier,
        "above": above,
        "mass": float(model.body_mass[i]),
        "inertia": model.body_inertia[i].tolist(),
        "inertia_pose": [model.body_ipos[i].tolist(), model.body_iquat[i].tolist()],
        "pose": [position.tolist(), turn.tolist()],
        "pose_above": [place[0].tolist(), place[1].tolist()],
        "world_pose": [data.xpos[i].tolist(), data.xquat[i].tolist()],
        "angular_velocity": motion[:3].tolist(),
        "velocity": motion[3:].tolist(),
    }


def _joint(model: Any, j: int) -> dict[str, Any]:
    q, v = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
    free = int(model.jnt_type[j]) == 0
    poly = [*_row(model, "jnt_stiffnesspoly", j), *_row(model, "dof_dampingpoly", v)]
    return {
        "name": model.joint(j).name,
        "type": ("free", "ball", "slide", "hinge")[int(model.jnt_type[j])],
        "body": int(model.jnt_bodyid[j]),
        "axis": model.jnt_axis[j].tolist(),
        "point": model.jnt_pos[j].tolist(),
        "range": model.jnt_range[j].tolist() if model.jnt_limited[j] else None,
        "stiffness": float(model.jnt_stiffness[j]),
        "damping": float(model.dof_damping[v]),
        "spring_rest": 0.0 if free else float(model.qpos_spring[q] - model.qpos0[q]),
        "reference": 0.0 if free else float(model.qpos0[q]),
        "more_terms": any(poly) or any(_row(model, "jnt_springyield", j)),
    }


def _row(model: Any, name: str, i: int) -> list[float]:
    """Of an array that older releases of MuJoCo have not, nothing."""
    found = getattr(model, name, None)
    return [] if found is None or i >= len(found) else found[i].ravel().tolist()


def _geom(mujoco: Any, model: Any, g: int, files: dict[str, str], inline: dict[str, Any]) -> dict[str, Any]:
    body = int(model.geom_bodyid[g])
    kinds = ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
    kind = kinds[int(model.geom_type[g])] if int(model.geom_type[g]) < len(kinds) else "sdf"
    pose = model.geom_pos[g].copy(), model.geom_quat[g].copy()
    found: dict[str, Any] = {}
    if kind == "mesh":
        mesh = int(model.geom_dataid[g])
        name = model.mesh(mesh).name
        # The compiler moves a mesh to its centre and principal axes; back to the frame of its file.
        back_position, back_turn = model.mesh_pos[mesh].copy() * 0, model.mesh_quat[mesh].copy() * 0
        mujoco.mju_negPose(back_position, back_turn, model.mesh_pos[mesh], model.mesh_quat[mesh])
        pose = _composed(mujoco, pose, (back_position, back_turn))
        found = {
            "mesh": name,
            "file": files.get(name),
            "vertices": inline.get(name),
            "scale": model.mesh_scale[mesh].tolist(),
        }
    carried = _composed(mujoco, _in_carrier(mujoco, model, body, int(model.body_weldid[body])), pose)
    return found | {
        "name": model.geom(g).name,
        "body": body,
        "type": kind,
        "size": model.geom_size[g].tolist(),
        "pose": [carried[0].tolist(), carried[1].tolist()],
        "contype": int(model.geom_contype[g]),
        "conaffinity": int(model.geom_conaffinity[g]),
        "condim": int(model.geom_condim[g]),
        "friction": model.geom_friction[g].tolist(),
    }


if __name__ == "__main__":
    main()
