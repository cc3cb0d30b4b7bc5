"""`rb.smoothed_gradient` against losses whose blurred gradient has a closed form."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.errors import InvalidInput, RunFailed, WrongStructure

KEY = jax.random.key(3)
SCALE = 0.2


def step(x):
    return jnp.where(x > 0.0, 1.0, 0.0)


def density(x):
    """Of the normal distribution of width `SCALE`: the slope of a blurred step."""
    return math.exp(-0.5 * (x / SCALE) ** 2) / (SCALE * math.sqrt(2.0 * math.pi))


# Loss, point, exact gradient of the blurred loss, orders that are free of bias.
CLOSED = {
    "step": (step, 0.1, density(0.1), (0, "interpolated")),
    "corner": (jnp.abs, 0.1, math.erf(0.1 / (SCALE * math.sqrt(2.0))), (0, 1, "interpolated")),
    "square": (lambda x: x**2, 0.7, 1.4, (0, 1, "interpolated")),
    "cube": (lambda x: x**3, 0.7, 3 * 0.49 + 3 * SCALE**2, (0, 1, "interpolated")),
    "wave": (jnp.sin, 0.7, math.cos(0.7) * math.exp(-0.5 * SCALE**2), (0, 1, "interpolated")),
}


@pytest.mark.parametrize(
    ("name", "antithetic"),
    [("step", True), ("corner", True), ("square", True), ("wave", True), ("cube", False)],
)
def test_estimates_are_those_of_the_closed_form(name, antithetic, dtype):
    """Over 400 keys: the mean within four of its errors of the truth, the scatter that which each estimate claims."""
    loss, at, exact, orders = CLOSED[name]

    def of(keys):
        return [
            jax.vmap(
                lambda key, order=order: rb.smoothed_gradient(
                    loss,
                    jnp.asarray(at, dtype),
                    scale=SCALE,
                    key=key,
                    samples=64,
                    order=order,
                    antithetic=antithetic,
                )
            )(keys)
            for order in orders
        ]

    every = jax.jit(of, compiler_options=QUICK)(jax.random.split(KEY, 400))
    for order, found in zip(orders, every, strict=True):
        assert found.gradient.dtype == dtype
        gradients, claimed = (np.asarray(x, np.float64) for x in (found.gradient, found.standard_error))
        scatter, usual = gradients.std(ddof=1), np.sqrt((claimed**2).mean())
        slack = 1e-6 * abs(exact)
        if order == "interpolated":  # biased by a share of the bias, less than one standard error of order 0
            slack += np.sqrt((np.asarray(every[0].standard_error, np.float64) ** 2).mean())
        else:
            assert scatter == pytest.approx(usual, rel=0.2, abs=slack)
        assert abs(gradients.mean() - exact) < 4.0 * scatter / 20.0 + slack


def test_first_order_is_blind_to_a_jump_and_says_so():
    found = rb.smoothed_gradient(step, jnp.asarray(0.1), scale=SCALE, key=KEY, samples=4096, order=1)
    assert float(found.gradient) == 0.0
    assert float(found.standard_error) == 0.0
    assert float(found.bias) == pytest.approx(-density(0.1), abs=4 * float(found.bias_error))
    assert "jumps within the noise" in found.summary()
    smooth = rb.smoothed_gradient(jnp.sin, jnp.asarray(0.1), scale=SCALE, key=KEY, samples=4096, order=1)
    assert abs(float(smooth.bias)) < 4 * float(smooth.bias_error)
    assert "no more than chance" in smooth.summary()


def test_pairs_make_first_order_of_a_square_exact(tolerance):
    found = rb.smoothed_gradient(lambda x: x**2, jnp.asarray(0.7), scale=SCALE, key=KEY, samples=8, order=1)
    assert float(found.gradient) == pytest.approx(1.4, rel=tolerance(float64=1e-14, float32=1e-5))
    assert float(found.standard_error) < tolerance(float64=1e-14, float32=1e-6)


def test_interpolation_takes_the_quieter_as_far_as_its_bias_may_go():
    """All of the first order where nothing jumps, next to nothing where it does; under a limit what Suh et al. say."""
    given = {"scale": SCALE, "key": KEY, "samples": 1024, "order": "interpolated"}
    at = jnp.asarray(0.1)
    smooth = rb.smoothed_gradient(jnp.sin, at, **given)
    assert float(smooth.share) > 0.98
    jumping = rb.smoothed_gradient(step, at, **given)
    assert 0.0 < float(jumping.share) < 0.02
    assert float(jumping.gradient) == pytest.approx(density(0.1), abs=4 * float(jumping.standard_error))
    radius = 2.0 * SCALE * float(rb.smoothed_gradient(step, at, **(given | {"order": 0})).standard_error)
    limited = rb.smoothed_gradient(step, at, bias_limit=2.5 * radius, **given)
    assert abs(float(limited.share * limited.bias)) * SCALE == pytest.approx(1.5 * radius, rel=1e-3)
    fooled = rb.smoothed_gradient(step, at, bias_limit=10.0, **given)
    assert float(fooled.share) == 1.0  # the variance alone would take the blind one
    assert float(fooled.gradient) == 0.0
    none = rb.smoothed_gradient(step, at, bias_limit=0.0, **given)
    assert float(none.share) == 0.0


def test_trees_have_a_blur_for_each_leaf_in_its_own_units(dtype):
    at = {"near": np.zeros((2,)), "far": 1e3, "count": 2}

    def loss(at):
        return at["count"] * jnp.sum(jnp.abs(at["near"])) + (at["far"] / 1e3) ** 2

    scale = {"near": 1e-3, "far": 10.0, "count": None}
    found = rb.smoothed_gradient(loss, at, scale=scale, key=KEY, samples=2000, order=1)
    assert found.gradient["count"] is None
    assert found.gradient["far"].dtype == dtype
    np.testing.assert_allclose(found.gradient["near"], [0.0, 0.0], atol=1e-6)
    assert float(found.gradient["far"]) == pytest.approx(2e-3, rel=1e-4)
    plain = json.loads(json.dumps(found.as_dict()))
    assert set(plain["gradient"]) == {"['near']", "['far']"}
    assert plain["samples"] == 2000
    assert plain["order"] == 1


def test_new_numbers_and_keys_are_not_compiled_anew():
    traces = []

    def loss(x):
        traces.append(1)
        return jnp.sum(x**2)

    for k in range(3):
        rb.smoothed_gradient(loss, jnp.ones(3) * k, scale=0.1 + k, key=jax.random.key(k), samples=8)
        if k == 0:
            first = len(traces)
    assert len(traces) == first


def test_ball_that_bounces_by_steps_has_its_slope_back():
    """The derivative of the steps is −0.1; blurred over several steps' travel values alone find the true −1."""

    def height(speed):
        def one(carry, _):
            z, v = carry
            v = jnp.where((z < 0.1) & (v < 0), -v, v)
            return (z + v / 480.0, v), None

        return lax.scan(one, (jnp.ones_like(speed), speed), None, length=480)[0][0]

    given = {"scale": 0.1, "key": KEY, "samples": 512}
    at = jnp.asarray(-2.003)
    zeroth = rb.smoothed_gradient(height, at, **given)
    assert float(zeroth.gradient) == pytest.approx(-1.0, abs=4 * float(zeroth.standard_error))
    assert float(zeroth.relative_error) < 0.1
    first = rb.smoothed_gradient(height, at, order=1, **given)
    assert float(first.gradient) == pytest.approx(-0.1, abs=0.05)
    assert "jumps within the noise" in first.summary()


def test_samples_that_are_not_finite_are_told_and_not_left_out():
    with pytest.raises(RunFailed, match="of 64 samples are not finite"):
        rb.smoothed_gradient(jnp.log, jnp.asarray(0.1), scale=SCALE, key=KEY, samples=64)
    found = rb.smoothed_gradient(jnp.log, jnp.asarray(0.1), scale=SCALE, key=KEY, samples=64, on_error="flag")
    assert int(found.not_finite) > 0
    assert np.isnan(float(found.gradient))


@pytest.mark.parametrize(
    ("error", "words", "more"),
    [
        (InvalidInput, "order", {"order": 2}),
        (InvalidInput, "scale", {"scale": 0.0}),
        (WrongStructure, "scale has 2 numbers", {"scale": [0.1, 0.1]}),
        (InvalidInput, "samples", {"samples": 1}),
        (WrongStructure, "no floating array", {"at": {"count": 3}}),
        (WrongStructure, "one real number", {"at": jnp.ones(2)}),
    ],
)
def test_what_cannot_be_smoothed_is_refused(error, words, more):
    given = {"at": jnp.asarray(0.1), "scale": SCALE, "key": KEY} | more
    with pytest.raises(error, match=words):
        rb.smoothed_gradient(step, given.pop("at"), **given)
