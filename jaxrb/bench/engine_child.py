"""One engine in a process of its own, in whichever Python has it: it runs worlds of one body when told.

    python engine_child.py mjx

Reads a line of JSON: `kind` ("free" or "box"), `mass` [kg], `moments` (3,) [kg m²], `half` (3,) [m], `dt` [s], `steps`,
`friction`, `gravity` [m/s²], `q` (w, 7) place and turn wxyz, `v` (w, 6) velocity in the world and spin in the body, and
answers with what getting ready took. Then for each line "run", "gradient" or "end" one answer.
"""

import importlib
import json
import os
import resource
import sys
import time

import numpy as np

MODEL = """<mujoco><option timestep="{dt!r}" gravity="0 0 {gravity!r}" integrator="{method}"/>
<default><geom friction="{friction!r} 0 0" condim="3"/></default><worldbody>{floor}<body><freejoint/>
<inertial pos="0 0 0" mass="{mass!r}" diaginertia="{moments}"/>{shape}</body></worldbody></mujoco>"""


def model_text(work, method=None):
    free = work["kind"] == "free"
    half = " ".join(map(repr, work["half"]))
    solid = f'<geom type="box" size="{half}"/>'
    # Brax needs a shape, if only one that touches nothing.
    hollow = '<geom type="sphere" size="0.1" contype="0" conaffinity="0"/>'
    return MODEL.format(
        dt=work["dt"], gravity=work["gravity"], method=method or ("RK4" if free else "Euler"), mass=work["mass"],
        friction=work["friction"], moments=" ".join(map(repr, work["moments"])),
        floor="" if free else '<geom type="plane" size="50 50 1"/>', shape=hollow if free else solid,
    )  # fmt: skip


def in_mujoco(work):
    mujoco, rollout = importlib.import_module("mujoco"), importlib.import_module("mujoco.rollout")
    model = mujoco.MjModel.from_xml_string(model_text(work))
    data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.empty((len(work["q"]), mujoco.mj_stateSize(model, kind)))
    for row, q, v in zip(starts, work["q"], work["v"], strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_getState(model, data, row, kind)

    def run():
        mujoco.mj_resetData(model, data)  # else it starts warm from the last world
        return np.asarray(rollout.rollout(model, data, starts, nstep=work["steps"])[0])[:, -1, 1:8]

    return run, None


def _of_jax(end, work, slope=True):
    """A vmapped run of `end(q, v) -> (7,)`, and the derivative of where it ends by its first speed."""
    import jax

    q, v = (jax.numpy.asarray(work[name], float) for name in ("q", "v"))
    forward = jax.jit(jax.vmap(end))
    back = jax.jit(jax.vmap(jax.grad(lambda v, q: end(q, v).sum())))
    return (lambda: np.asarray(forward(q, v))), (lambda: np.asarray(back(v, q))) if slope else None


def in_mjx(work):
    import jax

    mujoco, mjx = importlib.import_module("mujoco"), importlib.import_module("mujoco.mjx")
    model = mujoco.MjModel.from_xml_string(model_text(work))
    put, data = mjx.put_model(model), mjx.make_data(model)

    def end(q, v):
        now = data.replace(qpos=q, qvel=v)
        return jax.lax.fori_loop(0, work["steps"], lambda _, d: mjx.step(put, d), now).qpos

    # Its contact solve is a loop of unknown length, which JAX does not take backwards.
    return _of_jax(end, work, slope=work["kind"] == "free")


def in_brax(work):
    import jax
    from brax.io import mjcf
    from brax.positional import pipeline

    system = mjcf.loads(model_text(work, "Euler"))  # the only one it has

    def end(q, v):
        state = pipeline.init(system, q, v)
        step = lambda _, s: pipeline.step(system, s, jax.numpy.zeros(0))  # noqa: E731
        last = jax.lax.fori_loop(0, work["steps"], step, state)
        return jax.numpy.concatenate([last.x.pos[0], last.x.rot[0]])

    return _of_jax(end, work)


def _slope(y, moments, gravity, xp):
    """Of place, turn, velocity and spin (13,) of a free body."""
    w, x, y_, z, a, b, c = (y[3], y[4], y[5], y[6], y[10], y[11], y[12])
    i1, i2, i3 = moments
    turn = [
        0.5 * (-x * a - y_ * b - z * c), 0.5 * (w * a + y_ * c - z * b), 0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y_ * a),
    ]  # fmt: skip
    spin = [(i2 - i3) * b * c / i1, (i3 - i1) * c * a / i2, (i1 - i2) * a * b / i3]
    return xp([y[7], y[8], y[9], *turn, 0.0 * w, 0.0 * w, gravity + 0.0 * w, *spin])


def in_diffrax(work):
    import diffrax
    import jax.numpy as jnp

    field = lambda t, y, _: _slope(y, work["moments"], work["gravity"], jnp.stack)  # noqa: E731
    span = work["dt"] * work["steps"]

    def end(q, v):
        tolerance = 1e-9 if q.dtype == jnp.float64 else 1e-6
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(field), diffrax.Tsit5(), 0.0, span, work["dt"], jnp.concatenate([q, v]),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance), max_steps=4096,
        )  # fmt: skip
        return jnp.asarray(found.ys)[0, :7]

    return _of_jax(end, work)


def in_heyoka(work):
    heyoka = importlib.import_module("heyoka")
    names = [f"y{i}" for i in range(13)]
    y = heyoka.make_vars(*names)
    field = list(zip(y, _slope(y, work["moments"], work["gravity"], list), strict=True))
    solver = heyoka.taylor_adaptive(field, [0.0] * 13, tol=1e-9)
    starts, span = np.concatenate([work["q"], work["v"]], axis=1), work["dt"] * work["steps"]

    def run():
        found = np.empty((len(starts), 7))
        for row, first in zip(found, starts, strict=True):
            solver.time, solver.state[:] = 0.0, first
            solver.propagate_until(span)
            row[:] = solver.state[:7]
        return found

    return run, None


def in_jaxrb(work):
    import jax.numpy as jnp

    from jaxrb.body.body import Body
    from jaxrb.effects.gravity import UniformGravity
    from jaxrb.effects.rigid_contact import RigidContact
    from jaxrb.geometry.primitives import Box, HalfSpace
    from jaxrb.math.quaternion import Quaternion
    from jaxrb.scene.rollout import rollout
    from jaxrb.scene.scene import Scene

    touch = (RigidContact(HalfSpace(), friction=work["friction"]),) if work["kind"] == "box" else ()
    body = Body(work["mass"], tuple(work["moments"]), shape=Box(tuple(work["half"])))
    scene = Scene(body, (UniformGravity((0.0, 0.0, work["gravity"])), *touch))
    how = {"dt": work["dt"], "steps": work["steps"], "save_every": work["steps"], "on_error": "flag"}

    def end(q, v):
        last = rollout(scene, scene.state(q[:3], Quaternion(q[3:]), v[:3], v[3:]), **how).final
        return jnp.concatenate([last.position[0], last.orientation.as_quaternion_array()[0]])

    return _of_jax(end, work)


ENGINES = {
    "jaxrb": in_jaxrb, "mujoco": in_mujoco, "mjx": in_mjx, "brax": in_brax, "diffrax": in_diffrax,
    "heyoka": in_heyoka,
}  # fmt: skip


def clock():
    """CPU time; time by the clock where a device works, for which the process only waits."""
    return time.process_time() if os.environ.get("JAX_PLATFORMS", "cpu") == "cpu" else time.perf_counter()


def timed(call):
    before = clock()
    found = call()
    return clock() - before, found


def main():
    engine, work = sys.argv[1], json.loads(sys.stdin.readline())
    prepare, (run, gradient) = timed(lambda: ENGINES[engine](work))
    first, end = timed(run)
    ready = {"prepare_cpu_s": prepare, "first_cpu_s": first, "from_start_cpu_s": time.process_time()}
    again, _ = timed(run)
    print(json.dumps(ready | {"compile_cpu_s": max(first - again, 0.0)}), flush=True)
    for line in sys.stdin:
        told = line.strip()
        if told == "run":
            answer = {"cpu_s": timed(run)[0]}
        elif told == "gradient":
            answer = {"cpu_s": None if gradient is None else (gradient(), timed(gradient)[0])[1]}
        else:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            answer = {"end": np.asarray(end, float).tolist(), "peak_mb": peak}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
