"""Whether a scene pays for what it calls for and no more, in figures.

jaxrb bench --what effects
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.cost import cost, count_equations, count_operations, names
from jaxrb.accuracy.differences import difference
from jaxrb.accuracy.recommend import recommend
from jaxrb.accuracy.timing import interleaved
from jaxrb.bench.absent import EFFECTS, same_program
from jaxrb.bench.workloads import row
from jaxrb.body.body import Body, replicate
from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.effects.drag import LinearDrag, QuadraticDrag
from jaxrb.effects.gravity import UniformGravity
from jaxrb.effects.thruster import PrescribedTorque
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.scene.contact_library import CONTACT_SCENES
from jaxrb.scene.library import SCENES as SMOOTH
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene
from jaxrb.scene.step import step

BODIES, STEPS, SCENES = 1000, 200, 500


def rows() -> Iterator[dict[str, Any]]:
    """The figures, a row at a time."""
    yield row("a sphere under gravity over a program written by hand, 1000 worlds", sphere_ratio(), "×", 1.2)
    yield from reports()
    violations, dropped = recommendations()
    yield row(
        f"recommendations for {SCENES} random scenes that change the motion beyond the tolerance",
        violations,
        "scenes",
        0,
    )
    yield row("effects that they dropped, of each scene's three", dropped / SCENES, "a scene", None)
    yield from kinds()
    names = list(SMOOTH | CONTACT_SCENES)
    differing = [name for name in names if not same_program(name)]
    what = f"of {len(names)} scenes, those whose program shows that {len(EFFECTS)} effects were taken from it again"
    yield row(f"{what} {differing or ''}".rstrip(), len(differing), "scenes", 0)
    yield from sizes()
    yield from first_frames()


def sphere_ratio() -> float:
    """CPU time of a rollout of one sphere under gravity over that of the same steps written out, in 1000 worlds."""
    scene = Scene(Body(1.0, 0.4), UniformGravity())
    random = drawn(0)
    velocity, omega = random.normal(size=(2, BODIES, 1, 3))

    def start(velocity: Any, omega: Any) -> State:
        return scene.state(velocity=velocity, angular_velocity=omega)

    states = jax.vmap(start)(jnp.asarray(velocity), jnp.asarray(omega))
    engine = jax.jit(jax.vmap(lambda s: rollout(scene, s, dt=1e-3, steps=STEPS, save_every=STEPS).final))
    numbers = (
        states.position[:, 0].T, states.orientation.as_quaternion_array()[:, 0].T, states.velocity[:, 0].T,
        states.angular_velocity[:, 0].T,
    )  # fmt: skip
    by_hand = jax.jit(lambda p, q, v, w: hand_written_sphere(p, q, v, w, 1e-3, STEPS))
    mine, theirs = interleaved([lambda: engine(states), lambda: by_hand(*numbers)], rounds=31)
    return mine / theirs


def hand_written_sphere(p: Any, q: Any, v: Any, w: Any, dt: float, steps: int) -> Any:
    """Runge–Kutta 4 of spheres under gravity as one would write it without an engine; components first, worlds last."""
    g = jnp.asarray([0.0, 0.0, -9.81], p.dtype)[:, None]
    a, b, c = 0.5 * w

    def rate(q: Any) -> Any:
        q0, q1, q2, q3 = q
        return jnp.stack(
            [
                -q1 * a - q2 * b - q3 * c, q0 * a + q2 * c - q3 * b, q0 * b + q3 * a - q1 * c,
                q0 * c + q1 * b - q2 * a,
            ]
        )  # fmt: skip

    def step(_: Any, carry: Any) -> Any:
        p, q, v = carry
        k1 = rate(q)
        k2 = rate(q + 0.5 * dt * k1)
        k3 = rate(q + 0.5 * dt * k2)
        k4 = rate(q + dt * k3)
        q = q + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        q = q / jnp.sqrt(jnp.sum(q * q, axis=0))
        return p + dt * v + 0.5 * dt * dt * g, q, v + dt * g

    return jax.lax.fori_loop(0, steps, step, (p, q, v))


def reports() -> Iterator[dict[str, Any]]:
    """Whether the shares of a report add up, and whether a step without an effect costs what the report said."""
    effects = (
        UniformGravity(), LinearDrag(0.1, angular_coefficient=0.05), QuadraticDrag(coefficient=0.4, area=0.02)
    )  # fmt: skip
    scene = Scene(replicate(Body(1.0, (1.0, 2.0, 2.5)), BODIES), effects)
    state = scene.state(angular_velocity=[(0.1, 0.2, 1.0)] * BODIES, velocity=[(1.0, 0.0, 0.0)] * BODIES)
    # Each report is a measurement of its own, of newly compiled programs; single ones scatter by 0.05.
    found, *others = (cost(scene, state, rounds=31) for _ in range(5))
    sums = [report.shares_add_up_to for report in (found, *others)]
    what = f"shares of 1000 bodies' cost report add up to (five reports: {min(sums):.2f} … {max(sums):.2f})"
    yield row(what, float(np.median(sums)), "of the step", "0.85…1.15")
    again = {effect.index: effect for effect in others[0].effects}
    for effect in found.effects:
        ratio = (1.0 - again[effect.index].share) / (1.0 - effect.share)
        yield row(f"step without {effect.name}, measured again over the report's", ratio, "×", "0.75…1.25")


def sizes() -> Iterator[dict[str, Any]]:
    """The program of one step of each built-in scene: equations, operations of the compiled step, CPU s to compile."""
    for name, build in SMOOTH.items():
        example = build()
        start = time.process_time()
        traced = jax.jit(lambda s, y: step(s, y)).trace(example.scene, example.state())
        text = traced.lower().compile().as_text()
        seconds = time.process_time() - start
        yield row(f"{name}: equations of a step", count_equations(traced.jaxpr.jaxpr), "", None)
        yield row(f"{name}: operations of a step", count_operations(text or ""), "", None, seconds)


def kinds() -> Iterator[dict[str, Any]]:
    """Operations of a step of one body under gravity, by what the body can do."""
    brick = Body(1.0, (1.0, 2.0, 2.5))
    bodies = {
        "free, three moments": brick,
        "free, one moment": Body(1.0, 0.4),
        "in a plane": brick.restricted("xy", "z"),
        "on an axle": brick.restricted("", "z"),
        "a point": Body.point(1.0),
        "fixed": brick.fixed(),
    }
    for name, body in bodies.items():
        scene = Scene(body, UniformGravity())
        text = jax.jit(lambda s, y: step(s, y)).lower(scene, scene.state()).compile().as_text()
        yield row(
            f"operations of a step under gravity: a body {name}", count_operations(text or ""), "", None
        )
    yield row("a free planar body over a program written by hand, 1000 bodies", planar_ratio(), "×", 1.2)


def planar_ratio() -> float:
    """CPU time of bodies that move in a plane over that of x, y and an angle written out; both by Runge–Kutta 4."""
    random = drawn(0)
    velocity, omega = random.normal(size=(2, BODIES, 3)) * np.array([[[1.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]]])
    scene = Scene(replicate(Body(1.0, (1.0, 2.0, 2.5)).restricted("xy", "z"), BODIES))
    state = scene.state(velocity=velocity, angular_velocity=omega)
    numbers = (velocity[:, 0], velocity[:, 1], omega[:, 2], *np.zeros((3, BODIES)))

    def step_by_hand(_: Any, carry: Any) -> Any:
        u, v, w, x, y, angle = carry
        return u, v, w, x + 1e-3 * u, y + 1e-3 * v, angle + 1e-3 * w

    by_hand = jax.jit(lambda numbers: jax.lax.fori_loop(0, STEPS, step_by_hand, numbers))
    engine = jax.jit(lambda s: rollout(scene, s, dt=1e-3, steps=STEPS, save_every=STEPS).final)
    numbers = jax.tree.map(jnp.asarray, numbers)
    mine, theirs = interleaved([lambda: engine(state), lambda: by_hand(numbers)], rounds=31)
    return mine / theirs


_FIRST_FRAME = """
import sys, time
import jaxrb as rb
if sys.argv[1:]:
    rb.enable_compilation_cache(sys.argv[1])
box = rb.Body.from_shape(rb.Box((0.1, 0.1, 0.1)), density=500.0)
scene = rb.Scene(box, (rb.UniformGravity(), rb.RigidContact(rb.HalfSpace(), friction=0.5)))
rb.step(scene, scene.state(position=(0, 0, 0.1)), dt=2e-3).position.block_until_ready()
print(time.process_time())
"""


def first_frames(repeats: int = 3) -> Iterator[dict[str, Any]]:
    """CPU seconds from Python's start to the first step of a box on a plane, without and with programs kept on disk."""
    with tempfile.TemporaryDirectory() as folder:
        kept = os.path.join(folder, "kept")
        environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}

        def seconds(*arguments: str) -> float:
            command = [sys.executable, "-c", _FIRST_FRAME, *arguments]
            done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
            return float(done.stdout)

        seconds(kept)  # fills the folder
        found = np.array([(seconds(), seconds(kept)) for _ in range(repeats)])
    cold, warm = np.median(found, axis=0)
    yield row("Python start to first box-on-plane frame", cold, "CPU s", 4.0)
    yield row("the same in a second process, with enable_compilation_cache", warm, "CPU s", 1.5)


def recommendations() -> tuple[int, int]:
    """Of `SCENES` random scenes, how many recommendations miss the tolerance of 1e-3, and effects dropped in all."""
    violations = dropped = 0
    random = drawn(1)
    for _ in range(SCENES):
        size = 10.0 ** random.uniform(-7, 0, size=4)
        effects = (
            UniformGravity((0.0, 0.0, -size[0])), LinearDrag(size[1], angular_coefficient=size[2]),
            PrescribedTorque(size[3] * random.normal(size=3)),
        )  # fmt: skip
        scene, start = Scene(Body(1.0, (1.0, 2.0, 2.5)), effects), random.normal(size=(2, 1, 3)).tolist()
        state = scene.state(velocity=start[0], angular_velocity=start[1])
        found = recommend(scene, state, 2.0, 1e-3, steps=64)
        # Judged at other times, with another step.
        judged = difference(scene, found.scene, state, 2.0 / 96, 96, RungeKutta4())
        violations += judged.largest > 1.02e-3
        dropped += len(found.dropped)
        assert set(found.kept) | set(found.dropped) == set(names(scene))
    return violations, dropped
