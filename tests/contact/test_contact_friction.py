"""Friction against exact answers: a block that slides, sticks, slips in turns, rocks."""

import jax
import numpy as np
import pytest
from contact_scenes import G, block, block_numbers, continued, long_run, motion, state, worlds

SPEEDS, FRICTIONS = (0.5, 1.0, 2.0), (0.3, 0.5, 0.8)
THETAS = np.radians([2.0, 10.0, 20.0, 30.0, 45.0, 60.0])
COUNT = 18


@pytest.fixture(scope="module")
def run(dtype):
    """`run(numbers, motions, dt, goes)`: 400 steps a go, `COUNT` blocks at most; states (worlds, steps, 1, ...)."""
    program = continued(block, 400)
    place = jax.jit(jax.vmap(lambda n, m: state(block(n), m)))

    def many(numbers, moves, dt, goes):
        count = len(numbers)
        dt = list(np.broadcast_to(np.asarray(dt, float), (count,)))
        filled = [worlds([*v, *[v[-1]] * (COUNT - count)], dtype) for v in (numbers, moves, dt)]
        states = long_run(program, filled[0], place(*filled[:2]), filled[2], goes)
        return jax.tree.map(lambda x: x[:count], states)

    return many


def test_block_stops_after_v_squared_over_two_mu_g(run, tolerance):
    """To first order in the step: the error is near −v dt/2, and halved with the step; then it rests, flat."""
    cases = [(v, mu, dt) for dt in (2e-3, 1e-3) for v in SPEEDS for mu in FRICTIONS]
    starts = [motion((0, 0, 0.02), (v, 0, 0)) for v, _, _ in cases]
    found = run([block_numbers(mu) for _, mu, _ in cases], starts, [dt for *_, dt in cases], 2)
    v, mu, dt = np.array(cases).T
    error = found.position[:, -1, 0, 0] - v * v / (2 * mu * G)
    assert (np.abs(error) <= v * dt).all()
    assert error / (v * dt) == pytest.approx(-0.5, abs=tolerance(float64=5e-3, float32=0.02))
    coarse, fine = np.split(error, 2)
    assert coarse / fine == pytest.approx(2.0, abs=tolerance(float64=0.01, float32=0.08))
    assert np.abs(found.velocity[:, -1]).max() <= tolerance(float64=1e-9, float32=1e-5)
    assert np.abs(found.position[..., 2] - 0.02).max() <= tolerance(float64=1e-11, float32=1e-6)


def test_block_on_an_incline_slides_beyond_the_tangent_and_sticks_below(run, tolerance):
    """To 0.1 % of tan θ; what slides does so with g (sin θ − μ cos θ)."""
    cases = [(theta, share) for share in (0.999, 1.001) for theta in THETAS]
    numbers = [block_numbers(share * np.tan(t), (G * np.sin(t), 0.0, -G * np.cos(t))) for t, share in cases]
    found = run(numbers, [motion((0, 0, 0.02))] * len(cases), 1e-3, 1)
    theta, share = np.array(cases).T
    speed = found.velocity[:, -1, 0, 0]
    expected = G * np.sin(theta) * (1 - share) * 0.4
    slides = share < 1
    assert speed[slides] == pytest.approx(expected[slides], rel=tolerance(float64=1e-6, float32=0.05))
    assert np.abs(found.position[~slides, -1, 0, :2]).max() <= tolerance(float64=1e-9, float32=1e-5)
    assert np.abs(speed[~slides]).max() <= tolerance(float64=1e-9, float32=1e-4)


def test_block_sticks_and_slips_under_a_force_that_swings(run):
    """1 kg at μ = 0.8 under 8 cos t N slips by 4 and 13 mm at up to 0.04 m/s; the phases are those of the bisection."""
    spans = (4e-3, 2e-3)
    found = run([block_numbers(0.8, push=(8.0, 1.0))] * 2, [motion((0, 0, 0.02))] * 2, spans, 9)
    for world, dt in enumerate(spans):
        times = dt * np.arange(found.position.shape[1])
        exact, slips = stick_slip(8.0, 0.8 * G, times)
        assert exact.min() < -8e-3
        assert np.abs(found.position[world, :, 0, 0] - exact).max() <= 0.1 * dt
        near = slips | np.roll(slips, 3) | np.roll(slips, -3)
        speed = np.abs(found.velocity[world, :, 0, 0])
        assert speed[slips].max() == pytest.approx(0.0394, abs=0.3 * dt)
        assert speed[~near].max() <= 1e-4


def test_block_stays_while_the_force_is_below_the_limit(run, tolerance):
    """0.1 N and a thousandth below it, where the friction's share of each corner changes all the time."""
    numbers = [block_numbers(0.8, push=(0.8 * G - short, 1.0)) for short in (0.1, 0.008)]
    found = run(numbers, [motion((0, 0, 0.02))] * 2, 2e-3, 9)
    assert np.abs(found.position[..., 0, :2]).max() <= tolerance(float64=1e-8, float32=1e-5)
    assert np.abs(found.angular_velocity).max() <= tolerance(float64=1e-7, float32=1e-4)


def stick_slip(force, limit, times):
    """Positions of 1 kg under `force` cos t with friction `limit`, and which times lie in a phase of slip."""
    position, slips = np.zeros_like(times), np.zeros(times.shape, bool)
    start, where, sign = 0.0, 0.0, 1.0
    while start < times[-1]:

        def speed(t, t0=start, s=sign):
            return force * (np.sin(t) - np.sin(t0)) - s * limit * (t - t0)

        def way(t, t0=start, s=sign):
            swing = force * (np.cos(t0) - np.cos(t)) - force * np.sin(t0) * (t - t0)
            return swing - 0.5 * s * limit * (t - t0) ** 2

        crest = np.pi * round(start / np.pi)
        low, high = max(crest, start) + np.arccos(limit / force), crest + np.pi / 2
        for _ in range(80):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if sign * speed(middle) > 0 else (low, middle)
        now = (times >= start) & (times <= low)
        slips |= now
        position[now] = where + way(times[now])
        where += way(low)
        position[times > low] = where
        start, sign = crest + np.pi - np.arccos(limit / force), -sign
    return position, slips


def test_rocking_block_loses_at_an_impact_what_housner_says(run, tolerance):
    """ω₊/ω₋ = 1 − (3/2) sin²α, released at 0.03 rad. To first order in the step; extrapolated to 1e-3 and better."""
    widths, high, tilt = (0.02, 0.05, 0.08), 0.2, 0.03
    low = [high * np.cos(tilt) + b * np.sin(tilt) for b in widths]
    numbers = [block_numbers(5.0, half=(b, 0.05, high)) for b in widths] * 2
    starts = [motion((0, 0, z), turn=(0, tilt, 0)) for z in low] * 2
    dt = np.repeat([5e-4, 2.5e-4], 3)
    found = run(numbers, starts, dt, 2)
    alpha = np.arctan(np.array(widths) / high)
    exact = 1 - 1.5 * np.sin(alpha) ** 2
    turning = found.angular_velocity[..., 0, 1]
    peak = np.abs(turning).argmax(axis=1)
    world = np.arange(6)
    # The step of the impact holds a part of each phase: from one before it to one after.
    coarse, fine = np.split(turning[world, peak + 2] / turning[world, peak], 2)
    assert np.abs(fine - exact).max() <= 0.55 * np.abs(coarse - exact).max() <= 0.01
    assert 2 * fine - coarse == pytest.approx(exact, abs=tolerance(float64=2e-4, float32=1e-3))
    assert np.abs(found.position[..., 0, 1]).max() <= tolerance(float64=1e-12, float32=1e-5)
