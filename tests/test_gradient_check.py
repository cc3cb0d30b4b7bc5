"""`rb.gradient_check`: losses whose gradient is known to be right or wrong, and what is said of them."""

import dataclasses
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxrb as rb
from jaxrb.accuracy.gradient_check import STEPS
from jaxrb.accuracy.gradient_check_command import checked_run, gradient_check_of_scene
from jaxrb.accuracy.gradient_check_differences import Differences
from jaxrb.accuracy.gradient_check_verdict import BIASED, JUMPING, RIGHT, ZERO, judged
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.scene.library import example_of
from jaxrb.view.gradient_figure import gradient_figure


def stopped(x):
    return lax.stop_gradient(x)


@jax.custom_jvp
def doubled_slope(x):
    return jnp.sin(x)


doubled_slope.defjvp(lambda p, t: (jnp.sin(p[0]), 2 * jnp.cos(p[0]) * t[0]))


@jax.custom_vjp
def wrong_in_reverse(x):
    return x**3


wrong_in_reverse.defvjp(lambda x: (x**3, x), lambda x, g: (2 * x**2 * g,))


def pendulum(x):
    """Height after 2 s of a pendulum from angle x, 200 steps."""

    def step(carry, _):
        angle, speed = carry
        speed = speed - 0.01 * 9.81 * jnp.sin(angle)
        return (angle + 0.01 * speed, speed), None

    return jnp.cos(lax.scan(step, (x, jnp.zeros_like(x)), None, length=200)[0][0])


def stepped_bounce(speed):
    """Final height of a ball thrown down at 2 m/s, reflected at the end of the step in which it overlaps: exactly −1.

    (Task 1 of Zhong et al. 2022: 480 steps of a second; the derivative of the time of impact is lost.)
    """
    dt = 1.0 / 480.0

    def step(carry, _):
        z, v = carry
        v = jnp.where((z < 0.1) & (v < 0), -v, v)
        return (z + dt * v, v), None

    return lax.scan(step, (jnp.ones_like(speed), speed), None, length=480)[0][0]


def logistic(x, length=120):
    return lax.fori_loop(0, length, lambda _, y: 3.9 * y * (1.0 - y), x)


def sawtooth(x):
    """Falls with slope −1 in steps of 3e-4, between which it rises with slope 0.1."""
    return -3e-4 * jnp.round(x / 3e-4) + 0.1 * (x - 3e-4 * jnp.round(x / 3e-4))


def fixed_point(x):
    """y = cos(x y) by 40 sweeps, of which only the last is differentiated."""
    y = stopped(lax.fori_loop(0, 40, lambda _, y: jnp.cos(x * y), jnp.ones_like(x)))
    return jnp.cos(x * y)


def from_zero(x):
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1.0)), 0.0)


# Loss, point, verdict in float64, and in float32 where that differs.
CASES = {
    "square": (lambda x: x**2, 1.3, "right"),
    "steep exponential": (lambda x: jnp.exp(20 * x), 0.3, "right"),
    "wave of short length": (lambda x: jnp.sin(300 * x), 0.3, "right"),
    "stationary point": (lambda x: 1 + x**2, 0.0, "right"),
    "triple zero": (lambda x: x**3, 0.0, "right"),
    "flat of order six": (lambda x: 2.0 + x**6, 0.0, "right"),
    "constant": (lambda x: 0 * x + 3.0, 0.7, "right"),
    "small number": (lambda x: jnp.sin(x * 1e6), 1e-6, "right"),
    "large offset": (lambda x: 1e4 + x**2, 2.0, "right"),
    "kink nearby": (lambda x: jnp.abs(x - 0.3) + x, 0.302, "right"),
    "jump nearby": (lambda x: x + jnp.where(x > 0.3, 1.0, 0.0), 0.302, "right"),
    "kink that is rounded": (lambda x: jnp.sqrt(x**2 + 1e-2), 0.0, "right"),
    "norm that is safe": (lambda x: jnp.sqrt(jnp.where(x > 0, x, 1.0)) * (x > 0), 0.5, "right"),
    "pendulum in a loop": (pendulum, 1.0, "right"),
    "logistic map, few turns": (lambda x: logistic(x, 5), 0.3, "right"),
    "half of it is stopped": (lambda x: x * stopped(x), 1.3, "biased"),
    "wrong rule": (doubled_slope, 0.4, "biased"),
    "wrong rule in reverse only": (wrong_in_reverse, 0.8, "biased"),
    "last sweep alone": (fixed_point, 0.9, "biased"),
    "slope off by a thousandth": (lambda x: stopped(0.003 * jnp.sin(x)) + 2 * jnp.sin(x), 0.5, "biased", "right"),
    "sawtooth": (sawtooth, 0.4, "biased"),
    "ball that bounces by steps": (stepped_bounce, -2.003, "biased"),
    "all of it is stopped": (lambda x: stopped(x) ** 2, 1.3, "zero"),
    "rounded": (lambda x: jnp.round(x * 1000.0) / 1000.0, 0.5301, "zero"),
    "staircase of comparisons": (lambda x: jnp.sum(jnp.where(x > jnp.arange(200) / 200.0, 0.005, 0.0)), 0.501, "zero"),
    "dead zone": (lambda x: jnp.maximum(x - 1.0, 0.0), 0.996, "zero"),
    "corner": (jnp.abs, 0.0, "jumping"),
    "ramp from here": (lambda x: jnp.maximum(x, 0.0), 0.0, "jumping"),
    "two slopes": (lambda x: jnp.maximum(x, -0.9 * x) + 5.0, 0.0, "jumping"),
    "ball that lands at the end of a step": (stepped_bounce, -2.0, "jumping", "biased"),
    "step from here": (lambda x: jnp.where(x >= 0, 1.0, 0.0), 0.0, "jumping"),
    "step in the middle": (jnp.sign, 0.0, "jumping"),
    "small step on a slope": (lambda x: x + jnp.where(x >= 0.5, 1e-4, 0.0), 0.5, "jumping"),
    "point taken out": (lambda x: jnp.where(x == 0, 1.0, x), 0.0, "jumping"),
    "cusp with a safe root": (lambda x: from_zero(jnp.abs(x)), 0.0, "jumping"),
    "cubic root with a safe one": (lambda x: jnp.sign(x) * from_zero(jnp.abs(x)), 0.0, "jumping"),
    "root of zero": (lambda x: jnp.sqrt(jnp.abs(x)), 0.0, "not finite"),
    "logarithm of zero": (lambda x: jnp.log(x), 0.0, "not finite"),
    "untaken branch": (lambda x: jnp.where(x > 0, jnp.sqrt(x), -x), -1.0, "not finite"),
    "norm of zero": (lambda x: jnp.sqrt(x * x) + x, 0.0, "not finite"),
    "end of the domain": (lambda x: jnp.arcsin(x), 1.0, "not finite"),
    "logistic map, many turns": (logistic, 0.3, "undetermined"),
    "doubling of the circle": (lambda x: jnp.sin(2.0**60 * x) + x, 0.3, "undetermined"),
    "drawn by lot": (lambda x: jnp.mod(jnp.sin(12.9898e7 * x) * 43758.5453, 1.0), 0.37, "undetermined"),
}  # fmt: skip


@pytest.fixture(scope="module")
def checked(dtype):
    return {name: rb.gradient_check(case[0], jnp.asarray(case[1], dtype)) for name, case in CASES.items()}


@pytest.mark.parametrize("name", list(CASES))
def test_verdicts_on_losses_that_are_known(checked, name, dtype):
    expected = CASES[name][3] if dtype == jnp.float32 and len(CASES[name]) > 3 else CASES[name][2]
    check = checked[name]
    assert check.verdict == expected, check.summary()
    assert check.ok == (expected == "right")


def smooth_losses(kind, count=300):
    """Random smooth functions with their slopes: offsets, waves, exponentials and powers of many sizes."""
    draw = np.random.default_rng(0)
    for _ in range(count):
        size = 10.0 ** draw.uniform(-2, 2)
        # Beside a larger offset the differences of float32 are round-off, and nothing can be told.
        offset = size * 10.0 ** draw.uniform(-3, 5 if kind is np.float64 else 1)
        wave, rise = draw.uniform(0.1, 30.0), draw.uniform(-3.0, 3.0)
        phase, x = draw.uniform(0.0, 6.0), draw.choice([-1, 1]) * 10.0 ** draw.uniform(-2, 2)

        w, r = wave / abs(x), rise / abs(x)

        def loss(t, o=offset, s=size, w=w, p=phase, r=r):
            return o + s * (np.sin(w * t + p) + np.exp(r * t) + (r * t) ** 3)

        slope = size * (w * np.cos(w * x + phase) + r * np.exp(r * x) + 3 * r * (r * x) ** 2)
        h = np.array(STEPS) * abs(x)
        values = (loss(x + side * h).astype(kind).astype(float) for side in (1, -1))
        d = Differences(h, float(kind(loss(x))), *values, float(np.finfo(kind).eps))
        yield d, slope, 1e-3 * np.abs(d.central).max()


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_smooth_losses_raise_no_false_alarm_and_wrong_slopes_do(kind):
    """300 smooth losses: the right slope is found right in all, and one off by a tenth of the largest wrong in all."""
    tolerance = 1e-5 if kind is np.float64 else 1e-2
    for d, slope, floor in smooth_losses(kind):
        assert judged(d, slope, slope, tolerance, floor).verdict == RIGHT
        off = slope + 100.0 * floor
        assert judged(d, off, off, tolerance, floor).verdict == BIASED
        assert judged(d, None, 0.0, tolerance, floor).verdict in (
            ZERO,
            RIGHT,
        )  # RIGHT where the slope is nothing


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_kinks_and_jumps_are_told_at_the_point_and_not_beside_it(kind):
    draw = np.random.default_rng(1)
    h = np.array(STEPS)
    for _ in range(100):
        size, slope, apart = 10.0 ** draw.uniform(-1, 2), draw.uniform(-1, 1), 10.0 ** draw.uniform(-4, -2)

        def values(kinked, at, s=size, m=slope):
            def loss(t):
                return 1.0 + np.sin(m * t) + s * (np.abs(t - at) if kinked else np.where(t >= at, 1.0, 0.0))

            rounded = (loss(side * h).astype(kind).astype(float) for side in (1, -1))
            return Differences(h, float(kind(loss(0.0))), *rounded, float(np.finfo(kind).eps))

        for kinked in (True, False):
            here, beside = values(kinked, 0.0), values(kinked, apart)
            true = slope - (size if kinked else 0.0)
            assert judged(here, slope, slope, 1e-2, 0.0).verdict == JUMPING
            assert judged(beside, true, true, 1e-2, 0.0).verdict != JUMPING


def test_directions_are_the_numbers_of_a_tree_in_their_own_units(dtype, tolerance):
    at = {"speed": np.array([2.0, -1.0]), "mass": 0.5, "count": 3, "name": "ball"}

    def loss(at):
        return at["count"] * at["mass"] * jnp.sum(at["speed"] ** 2)

    check = rb.gradient_check(loss, at)
    assert check.ok, check.summary()
    assert check.value == pytest.approx(7.5)
    assert check.precision == np.dtype(dtype).name
    slopes = {d.name: d.forward for d in check.directions}
    assert slopes == pytest.approx({"['mass']": 15.0, "['speed'][0]": 6.0, "['speed'][1]": -3.0})
    assert {d.name: d.scale for d in check.directions}["['speed'][1]"] == 2.0
    for d in check.directions:
        near = tolerance(float64=1e-8, float32=1e-2)
        assert d.reverse == pytest.approx(d.forward)
        assert d.finding.slope == pytest.approx(d.forward, rel=near)
        assert len(d.steps) == len(d.central) == len(d.right) == len(d.left) == len(STEPS)
    scaled = rb.gradient_check(loss, at, scale={"speed": 1e-3, "mass": 1e-3, "count": None, "name": None})
    assert {d.scale for d in scaled.directions} == {1e-3}


def test_many_numbers_are_looked_at_along_drawn_directions():
    def loss(x):
        return jnp.sum(jnp.sin(x)) + jnp.abs(x[7])

    at = jnp.linspace(0.0, 1.0, 40)
    check = rb.gradient_check(loss, at)
    assert [d.verdict for d in check.directions] == ["right"] * 6
    at = at.at[7].set(0.0)
    assert rb.gradient_check(loss, at, directions=2).verdict == "jumping"


def test_worst_direction_gives_the_verdict_and_the_table_says_which():
    def loss(x):
        return jnp.sin(x[0]) + lax.stop_gradient(x[1]) ** 2 + jnp.abs(x[2])

    check = rb.gradient_check(loss, jnp.asarray([0.3, 1.5, 0.0]))
    assert [d.verdict for d in check.directions] == ["right", "zero", "jumping"]
    assert check.verdict == "jumping"
    assert not check.ok
    text = check.summary()
    assert "not differentiable here" in text
    assert "1 of 3 directions: jumping" in text
    assert "value[1]" in text


def test_report_is_plain_json_also_where_nothing_is_finite(checked):
    for check in checked.values():
        plain = json.loads(check.to_json(), parse_constant=lambda c: pytest.fail(c))
        assert plain["verdict"] == check.verdict
        assert plain["directions"][0]["finding"]["why"]
    root = json.loads(checked["root of zero"].to_json())
    assert root["directions"][0]["forward"] is None
    kinked = json.loads(checked["two slopes"].to_json())["directions"][0]["finding"]
    assert (kinked["left"], kinked["right"]) == pytest.approx((-0.9, 1.0), rel=1e-3)


def test_mode_that_does_not_run_is_told_not_raised():
    def loss(x):
        return lax.while_loop(lambda y: y < 10.0, lambda y: 2.0 * y, x)

    check = rb.gradient_check(loss, jnp.asarray(1.5))
    assert check.ok
    assert check.directions[0].reverse is None
    assert "reverse" in check.failed
    assert "reverse mode does not run" in check.summary()
    check = rb.gradient_check(wrong_in_reverse, jnp.asarray(0.8))
    assert list(check.failed) == ["forward"]
    assert check.verdict == "biased"


def test_modes_that_differ_are_biased():
    d = Differences(np.array(STEPS), 0.0, np.array(STEPS), -np.array(STEPS), 2e-16)
    assert judged(d, 1.0, 1.0, 1e-5, 0.0).verdict == RIGHT
    assert judged(d, 1.0, 1.5, 1e-5, 0.0).why == "forward and reverse mode differ"


def test_mean_over_chance_has_a_variance_and_zero_derivatives_are_seen(tolerance):
    """x w has mean slope 1 and variance 1; a step blurred by chance has slope zero in every sample."""
    key = jax.random.key(0)

    def product(x, key):
        return x * (1.0 + jax.random.normal(key))

    check = rb.gradient_check(product, jnp.asarray(2.0), key=key, samples=400)
    (d,) = check.directions
    assert check.ok, check.summary()
    assert check.samples == 400
    assert d.variance == pytest.approx(1.0, rel=0.3)
    assert d.forward == pytest.approx(1.0, abs=0.2)

    def blurred(x, key):
        return jnp.where(x + 0.1 * jax.random.normal(key) > 0.0, 1.0, 0.0)

    check = rb.gradient_check(blurred, jnp.asarray(0.02), key=key, samples=4000, scale=1.0)
    assert check.verdict == "zero", check.summary()
    found = check.directions[0].finding
    density = math.exp(-0.5 * 0.2**2) / (0.1 * math.sqrt(2 * math.pi))
    seen = found.slope if found.coarse is None else found.coarse
    assert seen == pytest.approx(density, rel=0.4)


def test_chaos_shows_as_growth_with_the_horizon():
    def course(x):
        return lax.scan(lambda y, _: (3.9 * y * (1.0 - y),) * 2, x, None, length=60)[1]

    def over_time(x):
        return jnp.arange(60.0), course(x)

    check = rb.gradient_check(lambda x: course(x)[-1], jnp.asarray(0.3), over_time=over_time)
    times, lengths = check.growth
    assert len(times) == len(lengths) == 60
    assert check.growth_factor > 1e3
    assert "chaos" in check.summary()
    free = rb.gradient_check(
        lambda v: 3.0 * v,
        jnp.asarray(0.3),
        over_time=lambda v: (jnp.arange(1.0, 9.0), v * jnp.arange(1.0, 9.0)),
    )
    assert free.growth_factor == pytest.approx(8.0 / 5.0)
    assert "chaos" not in free.summary()


@pytest.mark.parametrize(
    ("error", "words", "make"),
    [
        (WrongStructure, "no floating array", lambda: rb.gradient_check(lambda x: 1.0, {"a": 3})),
        (WrongStructure, "one real number", lambda: rb.gradient_check(lambda x: 2.0 * x, jnp.ones(2))),
        (InvalidInput, "steps", lambda: rb.gradient_check(jnp.sum, jnp.ones(2), steps=[1e-3, 1e-2])),
        (InvalidInput, "scale", lambda: rb.gradient_check(jnp.sum, jnp.ones(2), scale=-1.0)),
        (InvalidInput, "directions", lambda: rb.gradient_check(jnp.sum, jnp.ones(2), directions=0)),
        (
            WrongStructure,
            "outside",
            lambda: jax.jit(lambda x: rb.gradient_check(jnp.sum, x).value)(jnp.ones(2)),
        ),
    ],
)
def test_what_cannot_be_checked_is_refused(error, words, make):
    with pytest.raises(error, match=words):
        make()


STOPPED = """
import jax
import jaxrb as rb

def pull(body, state, k):
    return rb.Wrench(-k * jax.lax.stop_gradient(state.position))

scene = rb.Scene(rb.Body(1.0, 1.0), rb.CustomForce(pull, 30.0))
state = scene.state(position=(1.0, 0.0, 0.0), velocity=(0.0, 0.5, 0.0))
duration, dt = 0.3, 0.01
"""


@pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="commands run in float64: once is enough")
def test_command_checks_a_scene_by_name_draws_and_prints(capsys, tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "brick.png"
    gradient_check_of_scene("thrown_brick", of="z", duration=0.2, dt=0.01, plot=picture)
    printed = capsys.readouterr().out
    assert "The gradient is right. 3 of 3 directions" in printed
    assert "20 steps of 0.01 s" in printed
    assert picture.stat().st_size > 10_000


@pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="commands run in float64: once is enough")
def test_command_ends_with_one_where_a_gradient_is_wrong(capsys, tmp_path):
    file = tmp_path / "stopped.py"
    file.write_text(STOPPED)
    with pytest.raises(SystemExit) as ended:
        gradient_check_of_scene(str(file), of="y", growth=True, json=True)
    assert ended.value.code == 1
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == "biased"
    assert found["steps"] == 30
    assert 1.0 < found["growth_factor"] < 3.0
    assert [d["finding"]["verdict"] for d in found["directions"]] == ["right", "biased", "right"]
    with pytest.raises(InvalidInput, match="body is 1"):
        gradient_check_of_scene(str(file), body=1)


@pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="commands run in float64: once is enough")
def test_run_that_fails_is_a_loss_that_is_not_finite(tmp_path):
    file = tmp_path / "overflow.py"
    file.write_text(
        STOPPED.replace("-k * jax.lax.stop_gradient(state.position)", "k * state.velocity * 1e15")
    )
    check, _ = checked_run(example_of(str(file)), 1, "velocity", method="ExplicitEuler")
    assert check.verdict == "not finite"


def test_figure_has_a_panel_for_each_direction_and_one_for_growth(checked):
    pytest.importorskip("matplotlib")
    for name in ("two slopes", "root of zero", "logistic map, many turns", "square"):
        figure = gradient_figure(checked[name], name)
        assert len(figure.axes) == 1
        assert checked[name].verdict in figure.axes[0].get_title()
    grown = dataclasses.replace(
        checked["square"], directions=4 * checked["square"].directions, growth=((0.0, 1.0), (0.0, 2.0))
    )
    assert sum(axes.axison for axes in gradient_figure(grown).axes) == 5
