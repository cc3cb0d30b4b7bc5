"""What a scene does not ask for is not in its program. Counted in the jaxpr after dead code is removed."""

import contextlib
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.interpreters import partial_eval

import jaxrb as rb

ARITHMETIC = {
    "add",
    "sub",
    "mul",
    "div",
    "neg",
    "sqrt",
    "rsqrt",
    "integer_pow",
    "square",
    "add_any",
    "dot_general",
}
BRICK = rb.Body(mass=2.0, inertia=(1.0, 2.0, 2.5))
BALL = rb.Body(mass=2.0, inertia=1.5)


def arithmetic(function, *arguments) -> Counter:
    """How often each arithmetic primitive stands in the program of `function`, with scalars and arrays alike."""
    closed = jax.make_jaxpr(function)(*arguments)
    live, _ = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    counts: Counter = Counter()

    def walk(jaxpr):
        for equation in jaxpr.eqns:
            inner = [p for p in equation.params.values() if hasattr(p, "eqns") or hasattr(p, "jaxpr")]
            for sub in inner:
                walk(getattr(sub, "jaxpr", sub))
            if not inner and equation.primitive.name in ARITHMETIC:
                counts[equation.primitive.name] += 1

    walk(live)
    return counts


_compiled: list[str] = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, _seconds, **_: _compiled.append(event) if "backend_compile" in event else None
)


@contextlib.contextmanager
def count_compiles():
    """Collects one entry for each program that is compiled inside."""
    _compiled.clear()
    yield _compiled


def program(scene, **options):
    state = scene.state(angular_velocity=(1.0, 2.0, 3.0), velocity=(1.0, 0.0, 0.0))
    return arithmetic(lambda scene, state, dt: rb.step(scene, state, None, dt, **options), scene, state, 1e-3)


def names_in(scene) -> str:
    state = scene.state()
    return jax.jit(lambda scene, state: rb.step(scene, state)).lower(scene, state).as_text(debug_info=True)


def hand_written_free_body(moments, p, q, v, w, t, dt):
    """RK4 of a free body as one would write it without an engine, number by number."""
    i1, i2, i3 = moments
    k1, k2, k3 = (i2 - i3) / i1, (i3 - i1) / i2, (i1 - i2) / i3

    def rate(q, w):
        q0, q1, q2, q3 = q
        a, b, c = (0.5 * x for x in w)
        qdot = (
            -q1 * a - q2 * b - q3 * c,
            q0 * a + q2 * c - q3 * b,
            q0 * b + q3 * a - q1 * c,
            q0 * c + q1 * b - q2 * a,
        )
        return (*qdot, k1 * (w[1] * w[2]), k2 * (w[2] * w[0]), k3 * (w[0] * w[1]))

    def shift(span, r):
        y = [x + span * d for x, d in zip((*q, *w), r, strict=True)]
        return y[:4], y[4:]

    half = 0.5 * dt
    r1 = rate(q, w)
    r2 = rate(*shift(half, r1))
    r3 = rate(*shift(half, r2))
    r4 = rate(*shift(dt, r3))
    q, w = shift(
        dt, [1 / 6 * a + 1 / 3 * b + 1 / 3 * c + 1 / 6 * d for a, b, c, d in zip(r1, r2, r3, r4, strict=True)]
    )
    scale = 1.0 / jnp.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return [x + dt * u for x, u in zip(p, v, strict=True)], [x * scale for x in q], w, t + dt


def test_empty_scene_is_exactly_a_hand_written_free_body():
    numbers = [tuple(jnp.ones(())[None] for _ in range(k)) for k in (3, 3, 4, 3, 3)]
    by_hand = arithmetic(hand_written_free_body, *numbers, jnp.zeros(()), jnp.asarray(1e-3))
    assert program(rb.Scene(BRICK)) == by_hand


def test_hand_written_free_body_computes_what_the_engine_computes(tolerance):
    scene = rb.Scene(BRICK)
    state = scene.state(position=(1, 2, 3), velocity=(4, 5, 6), angular_velocity=(1.0, 2.0, 3.0))
    new = rb.step(scene, state, None, 1e-2)
    p, q, w, t = hand_written_free_body(
        np.asarray([1.0, 2.0, 2.5], state.dtype), state.position[0], state.orientation.wxyz[0], state.velocity[0],
        state.angular_velocity[0], state.time, jnp.asarray(1e-2, state.dtype),
    )  # fmt: skip
    for ours, theirs in zip(
        (new.position[0], new.orientation.wxyz[0], new.angular_velocity[0], new.time),
        (jnp.stack(p), jnp.stack(q), jnp.stack(w), t), strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(ours, theirs, atol=tolerance(float64=1e-15, float32=1e-6))


def test_gravity_adds_only_its_own_equations():
    empty, falling = program(rb.Scene(BRICK)), program(rb.Scene(BRICK, rb.UniformGravity()))
    added = falling - empty
    assert not empty - falling
    # Four stages of m g and (m g)/m; 1/m once; the weighted sum of the accelerations, and v by it; for x the sum of
    # three accelerations, and v + dt/6 of it.
    per_stage, moved_velocity, moved_position = 2, 3, 3
    assert added["mul"] == 4 * per_stage + 4 * 3 + moved_velocity + moved_position
    assert added["add"] == 3 * 3 + 2 * 3 + moved_velocity + moved_position
    assert added["div"] == 2
    assert set(added) == {"mul", "add", "div"}


def test_spherical_body_has_no_gyroscopic_term():
    gyroscopic = program(rb.Scene(BRICK)) - program(rb.Scene(BALL))
    # 3 × (k ω ω) in 4 stages, 3 new stages of ω, its weighted sum, its update, and k = (I₂ − I₃)/I₁ three times.
    assert gyroscopic == Counter(mul=4 * 6 + 3 * 3 + 3 * 4 + 3, add=3 * 3 + 3 * 3 + 3, sub=3, div=3)
    scene = rb.Scene(BALL)
    state = scene.state(angular_velocity=(1.0, 2.0, 3.0))
    np.testing.assert_array_equal(rb.step(scene, state).angular_velocity, state.angular_velocity)


@pytest.mark.parametrize(
    "effect",
    [
        rb.UniformGravity(),
        rb.LinearDrag(coefficient=0.1),
        rb.QuadraticDrag(coefficient=0.4, area=0.02),
        rb.SpringDamper(stiffness=1.0),
        rb.BodyThruster(force=(0.0, 0.0, 1.0)),
        rb.PrescribedTorque(torque=(0.0, 0.0, 1.0)),
    ],
    ids=lambda effect: type(effect).__name__,
)
def test_effect_leaves_its_name_only_in_scenes_that_have_it(effect):
    name = type(effect).__name__
    assert name in names_in(rb.Scene(BRICK, effect))
    assert name not in names_in(rb.Scene(BRICK))
    others = rb.UniformGravity() if name != "UniformGravity" else rb.LinearDrag(coefficient=0.1)
    assert name not in names_in(rb.Scene(BRICK, others))


def test_no_applied_torque_is_not_a_zero_torque():
    scene = rb.Scene(BRICK)
    state = scene.state()
    without = arithmetic(lambda s: rb.step(scene, s, None), state)
    with_zero = arithmetic(lambda s, torque: rb.step(scene, s, torque), state, jnp.zeros((1, 3)))
    assert sum(without.values()) < sum(with_zero.values())


def test_new_numbers_cause_no_new_trace():
    traces = []

    @jax.jit
    def advance(scene, state, torque, dt):
        traces.append(1)
        return rb.step(scene, state, torque, dt)

    for k in range(1, 4):
        scene = rb.Scene(
            rb.Body(mass=1.0 * k, inertia=(1.0 * k, 2.0, 2.5)),
            (rb.UniformGravity((0.0, 0.0, -1.0 * k)), rb.LinearDrag(coefficient=k)),
        )
        state = scene.state(position=(k, 0, 0), angular_velocity=(0.1 * k, 0.2, 0.3))
        advance(scene, state, np.full((1, 3), 0.1 * k, state.dtype), 1e-3 * k)
    assert len(traces) == 1


def test_each_public_run_compiles_once():
    scene = rb.Scene(BRICK, rb.UniformGravity())
    step = rb.stepper(scene, dt=1e-3)
    state = scene.state(angular_velocity=(0.1, 0.2, 0.3))
    for run in (
        lambda k, s: rb.step(scene, s, None, 1e-3 * k),
        lambda k, s: step(s),
        lambda k, s: rb.rollout(scene, s, dt=1e-3 * k, steps=3).final,
        lambda k, s: rb.energy(scene, s),
    ):
        run(1, state)
        with count_compiles() as compiled:
            later = run(2, state)
            run(3, later if isinstance(later, rb.State) else state)
        assert not compiled, compiled
