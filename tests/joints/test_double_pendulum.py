"""The double pendulum in decimal arithmetic: its digits hold, its energy stays."""

import math
from decimal import Decimal, localcontext

from jaxrb.bench.double_pendulum import _series, _value, angles_at


def test_more_digits_change_nothing_that_fewer_claim():
    few, more = (angles_at([0.5, 2.0], [1.5, math.pi / 2], digits=digits) for digits in (25, 32))
    for one, other in zip(few, more, strict=True):
        assert max(abs(x - y) for x, y in zip(one, other, strict=True)) < Decimal("1e-21")
    assert abs(few[1][0] - Decimal("1.5")) > 1  # it has moved


def test_small_swings_go_with_the_slower_mode():
    # (4/3, 1/2; 1/2, 1/3) θ¨ = −g (3/2, 0; 0, 1/2) θ: its slower mode is θ2 = r θ1 at ω² = λ g.
    a, b, c = 4 / 9 - 1 / 4, -(4 / 3 * 0.5 + 1 / 3 * 1.5), 1.5 * 0.5
    least = (-b - math.sqrt(b * b - 4 * a * c)) / (2 * a)
    ratio = (1.5 - 4 / 3 * least) / (0.5 * least)
    size = 1e-7
    (first, second), *_ = angles_at([1.0], [size, ratio * size], digits=25)
    swing = math.cos(math.sqrt(least * 9.81))
    assert abs(float(first) / size - swing) < 1e-12
    assert abs(float(second) / (ratio * size) - swing) < 1e-12


def test_energy_stays():
    with localcontext() as context:
        context.prec = 40
        state = [Decimal(2), Decimal(-1), Decimal(3), Decimal(5)]
        terms = _series(state, Decimal("9.81"), 30)
        ends = [[_value(series, step) for series in terms] for step in (Decimal(0), Decimal("0.005"))]
    energy = [_energy(*(float(x) for x in end)) for end in ends]
    assert abs(energy[1] - energy[0]) < 1e-13 * abs(energy[0])
    assert abs(float(ends[1][0] - ends[0][0])) > 0.01


def _energy(a, b, rate_a, rate_b, g=9.81):
    kinetic = 2 / 3 * rate_a**2 + rate_b**2 / 6 + 0.5 * math.cos(a - b) * rate_a * rate_b
    return kinetic - g * (1.5 * math.cos(a) + 0.5 * math.cos(b))
