"""What holds for every scene and start: laws of physics, symmetries, and what a program may not depend on.

Hypothesis chooses the numbers, the same in every run; one compiled program serves nearly all properties. JAXRB_EXAMPLES
sets how many starts each property is tried on.
"""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some
from rotation_samples import QUICK

import jaxrb as rb

EXAMPLES = int(os.environ.get("JAXRB_EXAMPLES", "15"))
STEPS, DT = 24, 0.01
ALWAYS = settings(
    max_examples=EXAMPLES, derandomize=True, deadline=None, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip


def draws(shape, low=-1.0, high=1.0):
    """Arrays of numbers with few digits, zero and the ends among them."""
    count = int(np.prod(shape))
    one = some.floats(low, high, width=16) if low < 0 else some.floats(low, high)
    return some.lists(one, min_size=count, max_size=count).map(lambda x: np.reshape(x, shape).astype(float))


@some.composite
def starts(draw):
    """Numbers of two bodies of full inertia with a spring between them: (mass, inertia, motion, gravity)."""
    second = draw(draws((2, 3), 0.2, 1.0))  # second moments: any positive ones belong to a body
    turned = draw(draws((2, 3)))
    turns = [np.asarray(rb.RotationMatrix.exp(v).matrix, float) for v in turned]
    moments = second.sum(axis=1, keepdims=True) - second
    matrix = np.stack([r @ np.diag(m) @ r.T for r, m in zip(turns, moments)])
    q = draw(draws((2, 4)))
    q = np.where(np.linalg.norm(q, axis=1, keepdims=True) < 0.1, [1.0, 0, 0, 0], q)
    return {
        "mass": draw(draws((2,), 0.5, 2.0)),
        "inertia": 0.5 * (matrix + np.swapaxes(matrix, 1, 2)),
        "position": draw(draws((2, 3))) + np.asarray([[0, 0, 0], [3, 0, 0]]),
        "wxyz": q / np.linalg.norm(q, axis=1, keepdims=True),
        "velocity": draw(draws((2, 3))),
        "spin": 2.0 * draw(draws((2, 3))),
        "gravity": draw(draws((3,))),
        "dt": np.asarray(DT),
    }


def scene_of(n):
    m = n["inertia"]
    six = jnp.stack([m[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=-1)
    body = rb.Body(n["mass"], rb.FullInertia(six), center_of_mass=jnp.zeros((2, 3), six.dtype))
    spring = rb.SpringDamper(
        2.0, rest_length=1.0, point_a=(0.1, 0.2, 0.0), point_b=(0.0, 0.1, -0.3), body_b=1
    )
    return rb.Scene(body, (rb.UniformGravity(n["gravity"]), spring))


def numbers_of(state):
    return {
        "position": state.position,
        "wxyz": state.orientation.wxyz,
        "velocity": state.velocity,
        "spin": state.angular_velocity,
    }


def end_of(n, method):
    scene = scene_of(n)
    zero = jnp.zeros((), n["mass"].dtype)
    start = rb.body.State(n["position"], rb.Quaternion(n["wxyz"]), n["velocity"], n["spin"], zero)
    path = rb.rollout(scene, start, dt=n["dt"], steps=STEPS, save_every=STEPS, method=method, on_error="flag")
    kept = jax.vmap(lambda s: (rb.energy(scene, s), rb.momentum(scene, s), rb.angular_momentum(scene, s)))(
        path.states
    )
    final = path.final
    end = {
        "position": final.position,
        "wxyz": final.orientation.wxyz,
        "velocity": final.velocity,
        "spin": final.angular_velocity,
    }
    return end, kept


@pytest.fixture(scope="module")
def run(dtype):
    """`run(numbers)` → the state at the end, and (energy, momentum, angular momentum) at both ends."""
    program = jax.jit(lambda n: end_of(n, "RungeKutta4"), compiler_options=QUICK)

    def host(n):
        return jax.tree.map(lambda x: np.asarray(x, float), program(typed(n, dtype)))

    return host


def typed(n, dtype):
    return {name: jnp.asarray(value, dtype) for name, value in n.items()}


@pytest.fixture(scope="module")
def near(tolerance):
    """`near(a, b)`: the same up to round-off; quaternions up to their sign."""

    def check(one, other, float64=1e-11):
        allowed = tolerance(float64=float64, float32=3e-4)
        for name in one:
            a, b = one[name], other[name]
            if name == "wxyz":
                b = b * np.sign(np.sum(a * b, axis=-1, keepdims=True))
            assert np.abs(a - b).max() <= allowed, name

    return check


def product(p, q):
    """Hamilton product of wxyz."""
    return np.concatenate(
        [[p[0] * q[0] - p[1:] @ q[1:]], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])]
    )


@ALWAYS
@given(n=starts())
def test_momenta_are_kept_without_outside_forces(run, tolerance, n):
    """The spring is between the bodies: its forces cancel, and its moments but for the error of the steps."""
    _, (_, momentum, angular) = run(n | {"gravity": np.zeros(3)})
    assert np.abs(momentum[1] - momentum[0]).max() <= tolerance(float64=1e-13, float32=1e-5)
    assert np.abs(angular[1] - angular[0]).max() <= tolerance(float64=1e-6, float32=1e-4)


@ALWAYS
@given(n=starts())
def test_error_of_the_energy_falls_with_the_fourth_power_of_the_step(run, dtype, n):
    if dtype == jnp.float32:
        pytest.skip("the error lies below round-off")
    _, (energy, _, _) = run(n)
    coarse = abs(energy[1] - energy[0])
    half, _ = run(n | {"dt": np.asarray(0.5 * DT)})
    _, (later, _, _) = run(n | half | {"dt": np.asarray(0.5 * DT)})
    fine = abs(later[1] - energy[0])
    # The energy's own error is of order four or five; next to a change of its sign any ratio is possible.
    assert fine <= coarse / 10 or fine <= 1e-9


@ALWAYS
@given(n=starts(), axis=draws((3,)), shift=draws((3,)), boost=draws((3,)))
def test_result_moves_with_the_frame(run, near, n, axis, shift, boost):
    """Turned, shifted and moving along: Galilei. But for the error of the steps (1e-10 here).

    Within a step of Runge and Kutta quaternions are not of length one, and what they then do to the spring's points is
    no rotation: that part of the error differs from frame to frame.
    """
    r = np.asarray(rb.RotationMatrix.exp(axis).matrix, float)
    q = np.asarray(rb.Quaternion.exp(axis).wxyz, float)
    turned = n | {
        "position": n["position"] @ r.T + shift,
        "velocity": n["velocity"] @ r.T + boost,
        "wxyz": np.stack([product(q, own) for own in n["wxyz"]]),
        "gravity": r @ n["gravity"],
    }
    here, _ = run(n)
    there, _ = run(turned)
    expected = {
        "position": here["position"] @ r.T + shift + boost * STEPS * DT,
        "velocity": here["velocity"] @ r.T + boost,
        "wxyz": np.stack([product(q, own) for own in here["wxyz"]]),
        "spin": here["spin"],
    }
    near(expected, there, float64=1e-8)


@ALWAYS
@given(n=starts())
def test_order_of_the_bodies_does_not_matter(near, n):
    swapped = {k: v[::-1] if np.ndim(v) and len(v) == 2 else v for k, v in n.items()}
    first, _ = run_free(n)
    second, _ = run_free(swapped)
    near(first, {name: value[::-1] for name, value in second.items()})


@ALWAYS
@given(n=starts())
def test_mirror_image_moves_as_the_mirror_image(near, n):
    """x → −x: polar vectors turn their x, axial ones their y and z."""
    polar, axial = np.asarray([-1.0, 1, 1]), np.asarray([1.0, -1, -1])
    image = n | {
        "position": n["position"] * polar,
        "velocity": n["velocity"] * polar,
        "gravity": n["gravity"] * polar,
        "spin": n["spin"] * axial,
        "wxyz": n["wxyz"] * np.append(1.0, axial),
        "inertia": n["inertia"] * np.outer(polar, polar),
    }
    here, _ = run_free(n)
    there, _ = run_free(image)
    expected = {
        "position": here["position"] * polar,
        "velocity": here["velocity"] * polar,
        "spin": here["spin"] * axial,
        "wxyz": here["wxyz"] * np.append(1.0, axial),
    }
    near(expected, there)


@ALWAYS
@given(n=starts())
def test_symmetric_method_runs_back_to_where_it_began(tolerance, n):
    """Turn every velocity round and go on for as long."""
    there, _ = run_free(n)
    back, _ = run_free(n | there | {"velocity": -there["velocity"], "spin": -there["spin"]})
    off = max(
        np.abs(back["position"] - n["position"]).max(),
        np.abs(back["velocity"] + n["velocity"]).max(),
        np.abs(back["spin"] + n["spin"]).max(),
        np.abs(np.abs(np.sum(back["wxyz"] * n["wxyz"], axis=1)) - 1.0).max(),
    )
    assert off <= tolerance(float64=1e-11, float32=2e-4)


_FREE = {}


def run_free(n):
    """As `run`, by a symmetric method, and with a spring that is the same seen from both bodies: central."""
    dtype = jnp.float64 if jax.config.jax_enable_x64 else jnp.float32
    if dtype not in _FREE:

        def program(n):
            scene = scene_of(n)
            spring = rb.SpringDamper(2.0, rest_length=1.0, body_b=1)
            return end_of_scene(rb.Scene(scene.bodies, (scene.effects[0], spring)), n)

        _FREE[dtype] = jax.jit(program, compiler_options=QUICK)
    return jax.tree.map(lambda x: np.asarray(x, float), _FREE[dtype](typed(n, dtype)))


def end_of_scene(scene, n):
    zero = jnp.zeros((), n["mass"].dtype)
    start = rb.body.State(n["position"], rb.Quaternion(n["wxyz"]), n["velocity"], n["spin"], zero)
    method = rb.ImplicitMidpoint()
    final = rb.rollout(
        scene, start, dt=n["dt"], steps=STEPS, save_every=STEPS, method=method, on_error="flag"
    ).final
    end = {
        "position": final.position,
        "wxyz": final.orientation.wxyz,
        "velocity": final.velocity,
        "spin": final.angular_velocity,
    }
    return end, None


@pytest.fixture(scope="module")
def hundred(dtype):
    """Starts chosen once, as a list and as one batch."""
    found = []
    collect = settings(ALWAYS, max_examples=EXAMPLES)(given(n=starts())(lambda n: found.append(n)))
    collect()
    return found, {name: jnp.asarray(np.stack([n[name] for n in found]), dtype) for name in found[0]}


def test_batch_gives_what_each_gives_alone(run, near, hundred):
    ends, _ = jax.jit(jax.vmap(lambda n: end_of(n, "RungeKutta4")), compiler_options=QUICK)(hundred[1])
    for k, n in enumerate(hundred[0]):
        near(run(n)[0], {name: np.asarray(value[k], float) for name, value in ends.items()})


def test_compiled_gives_what_uncompiled_gives(near, hundred, dtype):
    """One step, each operation by itself."""
    n = typed(hundred[0][-1], dtype)

    def step(n):
        zero = jnp.zeros((), dtype)
        state = rb.body.State(n["position"], rb.Quaternion(n["wxyz"]), n["velocity"], n["spin"], zero)
        new = rb.step(scene_of(n), state, None, n["dt"], method="ExplicitEuler")
        return {
            "position": new.position,
            "velocity": new.velocity,
            "spin": new.angular_velocity,
            "wxyz": new.orientation.wxyz,
        }

    compiled = jax.jit(step, compiler_options=QUICK)(n)
    with jax.disable_jit():
        each = step(n)
    near(*(jax.tree.map(lambda x: np.asarray(x, float), end) for end in (compiled, each)))


def test_derivative_is_that_of_differences(dtype, hundred):
    """Of a sum of the end along a direction through all numbers of the start and the scene."""
    if dtype == jnp.float32:
        pytest.skip("differences of float32 have two digits")
    names = ("position", "velocity", "spin", "mass", "inertia", "gravity")
    batch, random = hundred[1], np.random.default_rng(0)
    at = {name: batch[name] for name in names}
    along = {name: jnp.asarray(random.normal(size=at[name].shape)) for name in names}
    along["inertia"] = along["inertia"] + jnp.swapaxes(along["inertia"], -1, -2)

    def value(moved, n):
        end, _ = end_of(n | moved, "RungeKutta4")
        return sum(
            jnp.sum(x * jnp.cos(jnp.arange(x.size, dtype=x.dtype)).reshape(x.shape)) for x in end.values()
        )

    def both(moved, way, n):
        return jax.jvp(lambda m: value(m, n), (moved,), (way,))

    program = jax.jit(jax.vmap(both), compiler_options=QUICK)
    exact = np.asarray(program(at, along, batch)[1])
    h = 1e-5
    ends = [program({k: at[k] + sign * h * along[k] for k in names}, along, batch)[0] for sign in (1, -1)]
    difference = np.asarray(ends[0] - ends[1]) / (2 * h)
    assert np.abs(exact - difference).max() <= 1e-6 * np.abs(exact).max()
