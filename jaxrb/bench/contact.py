"""Speed of contact: random worlds of boxes on a floor, beside MuJoCo's own rollout in C where it is installed.

Both start from the same states and take the same steps; the deepest corner below the floor at the end stands beside
the speed, since a soft contact is cheaper than a hard one.
"""

import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from jaxrb.accuracy.mujoco_modules import mujoco_modules
from jaxrb.accuracy.timing import cpu_of_first, interleaved
from jaxrb.bench.peers import mujoco_version
from jaxrb.body import Body, replicate
from jaxrb.draws import drawn
from jaxrb.effects import RigidContact, UniformGravity
from jaxrb.geometry import Box, HalfSpace
from jaxrb.scene import Scene
from jaxrb.scene.rollout import rollout

WORKLOADS = ((1, 256, 500), (16, 16, 60), (64, 4, 30))  # boxes, worlds, steps
_HALF, _DENSITY, _DT, _FRICTION, _GRAVITY = 0.1, 1000.0, 2e-3, 0.5, 9.81


def rows() -> Iterator[dict[str, Any]]:
    """One row for each workload: body-steps a CPU second of each, their ratio, overlap; of one box also a gradient."""
    for boxes, worlds, steps in WORKLOADS:
        yield _row(boxes, worlds, steps)


def jobs_of(
    boxes: int, worlds: int, steps: int
) -> tuple[Scene, Any, Callable[[], Any], Callable[[], Any] | None]:
    """The scene, the worlds' states, a run of all of them, and the same in MuJoCo where it is installed."""
    places = [_world(boxes, seed) for seed in range(worlds)]
    scene, states = _scene(boxes, places)
    run = jax.jit(jax.vmap(functools.partial(_run, scene, steps)))
    peer = _mujoco_job(boxes, places, steps) if mujoco_version() else None
    return scene, states, functools.partial(run, states), peer


def gradient_jobs(scene: Scene, states: Any, steps: int) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """Where each world's box ends, and the gradient of that by all numbers of its start."""

    def end(state: Any) -> Any:
        return _run(scene, steps, state).final.position.sum()

    plain, slope = (jax.jit(jax.vmap(function)) for function in (end, jax.grad(end)))
    return functools.partial(plain, states), functools.partial(slope, states)


def _row(boxes: int, worlds: int, steps: int) -> dict[str, Any]:
    scene, states, run, peer = jobs_of(boxes, worlds, steps)
    first = cpu_of_first(run)
    seconds = interleaved([run, peer] if peer else [run], rounds=3)
    path = run()
    total = boxes * worlds * steps
    row = {
        "boxes": boxes,
        "worlds": worlds,
        "body-steps/CPU s": total / seconds[0],
        "overlap [mm]": 1e3 * _depth(path.final.position, path.final.orientation.wxyz),
        "Newton a step": float(path.contact.newton_steps[:, -1].mean()) / steps,
        "poor steps": int(path.contact.poor[:, -1].sum()),
        "first call [CPU s]": first,
        "gradient/run": None,
        "its first call [CPU s]": None,
        "MuJoCo": None,
        "its overlap [mm]": None,
        "ratio": None,
    }
    if peer:
        end = peer()
        row |= {
            "MuJoCo": total / seconds[1],
            "its overlap [mm]": 1e3 * _depth(end[..., :3], end[..., 3:]),
            "ratio": seconds[1] / seconds[0],
        }
    if boxes == 1:
        row |= _gradient(scene, states, steps)
    return row


def _gradient(scene: Scene, states: Any, steps: int) -> dict[str, float]:
    """Time over that of the run, and CPU time to begin."""
    plain, slope = gradient_jobs(scene, states, steps)
    first = cpu_of_first(slope)
    seconds = interleaved([plain, slope], rounds=3)
    return {"gradient/run": seconds[1] / seconds[0], "its first call [CPU s]": first}


def _run(scene: Scene, steps: int, state: Any) -> Any:
    return rollout(scene, state, dt=_DT, steps=steps, save_every=steps, on_error="flag")


def _scene(boxes: int, places: Any) -> tuple[Scene, Any]:
    body = Body.from_shape(Box((_HALF,) * 3), _DENSITY)
    effects = [UniformGravity((0.0, 0.0, -_GRAVITY)), RigidContact(HalfSpace(), friction=_FRICTION)]
    if boxes > 1:
        effects.append(RigidContact(friction=_FRICTION))
    scene = Scene(replicate(body, boxes), tuple(effects))
    dtype = jax.dtypes.canonicalize_dtype(float)
    columns = [np.stack(column).astype(dtype) for column in zip(*places, strict=True)]
    return scene, jax.vmap(scene.state)(*columns)


def _world(boxes: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A heap about to fall: places, attitudes, velocities, spins of each box."""
    random = drawn(seed)
    side = int(np.ceil(boxes ** (1 / 3)))
    grid = np.array([(x, y, z) for z in range(side + 1) for y in range(side) for x in range(side)])[:boxes]
    turn = random.normal(size=(boxes, 4))
    place = 0.36 * grid + [0.0, 0.0, 0.25] + random.uniform(-0.02, 0.02, (boxes, 3))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return place, turn, 0.5 * random.normal(size=(boxes, 3)), random.normal(size=(boxes, 3))


def _depth(position: Any, wxyz: Any) -> float:
    """How far [m] the lowest corner of any box is below the floor."""
    w, x, y, z = np.moveaxis(np.asarray(wxyz, float), -1, 0)
    row = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    lowest = np.asarray(position, float)[..., 2] - _HALF * np.abs(row).sum(axis=-1)
    return float(np.maximum(-lowest, 0.0).max())


def _mujoco_job(boxes: int, places: Any, steps: int) -> Any:
    """A call that runs all worlds in MuJoCo on one thread and returns the last poses (worlds, boxes, 7)."""
    mujoco, threads = mujoco_modules("rollout")
    bodies = "".join(
        f'<body><freejoint/><geom type="box" size="{_HALF} {_HALF} {_HALF}" density="{_DENSITY}"/></body>'
        for _ in range(boxes)
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{_DT}" gravity="0 0 {-_GRAVITY}"/>'
        f'<default><geom friction="{_FRICTION} 0 0"/></default>'
        f'<worldbody><geom type="plane" size="50 50 1"/>{bodies}</worldbody></mujoco>'
    )
    data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.empty((len(places), mujoco.mj_stateSize(model, kind)))
    for start, (place, turn, velocity, spin) in zip(starts, places, strict=True):
        data.qpos[:] = np.concatenate([place, turn], axis=1).ravel()
        data.qvel[:] = np.concatenate([velocity, spin], axis=1).ravel()
        mujoco.mj_getState(model, data, start, kind)

    def job() -> np.ndarray:
        mujoco.mj_resetData(model, data)
        states, _ = threads.rollout(model, data, starts, nstep=steps)
        return np.asarray(states)[:, -1, 1 : 1 + 7 * boxes].reshape(len(places), boxes, 7)

    return job
