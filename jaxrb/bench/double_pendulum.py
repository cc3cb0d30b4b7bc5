"""The double pendulum to any number of digits: Taylor series in decimal arithmetic.

Two rods of 1 m and 1 kg hang one from the other. Their angles' series follow term by term from the equations of motion
by the rules for sums, products, quotients, sine and cosine of series; each step is as long as its last terms allow.
(Jorba and Zou 2005, "A software package for the numerical integration of ODEs by means of high-order Taylor methods".)
"""

from collections.abc import Sequence
from decimal import Decimal, localcontext
from typing import TypeAlias

Series: TypeAlias = list[Decimal]

_GUARD = 12  # digits beyond those asked for
_LONGEST = Decimal("0.1")  # [s] of a step, from rest as well, where the first terms say nothing


def angles_at(
    times: Sequence[float], start: Sequence[float], gravity: float = 9.81, digits: int = 50
) -> list[tuple[Decimal, Decimal]]:
    """Angles from the vertical [rad] at ascending `times` [s], let go at rest at the `start` angles.

    Each step is good to `digits`; how many of these are left at the end is a matter of chaos: a run with more digits
    shows it.
    """
    with localcontext() as context:
        context.prec = digits + _GUARD
        order = int(1.2 * digits) + 4
        state = [Decimal(start[0]), Decimal(start[1]), Decimal(0), Decimal(0)]
        now, found = Decimal(0), []
        for time in map(Decimal, times):
            while now < time:
                terms = _series(state, Decimal(gravity), order)
                step = min(_step(terms, digits), time - now)
                state = [_value(series, step) for series in terms]
                now += step
            found.append((state[0], state[1]))
        return found


def _step(terms: list[Series], digits: int) -> Decimal:
    """The step [s] after which the last two terms of all series are below one in 10^digits."""
    lengths = [_LONGEST]
    for series in terms:
        for k in (len(series) - 2, len(series) - 1):
            if series[k] != 0:
                lengths.append(((-digits * Decimal(10).ln() - abs(series[k]).ln()) / k).exp())
    return min(lengths)


def _value(series: Series, step: Decimal) -> Decimal:
    total = Decimal(0)
    for term in reversed(series):
        total = total * step + term
    return total


def _series(state: Sequence[Decimal], gravity: Decimal, order: int) -> list[Series]:
    """Terms 0 … order of both angles and of both rates.

    With δ = a − b the equations are 4/3 ä + ½ cos δ b̈ = p and ½ cos δ ä + 1/3 b̈ = q with p = −½ sin δ ḃ² − 3/2 g sin a
    and q = ½ sin δ ȧ² − ½ g sin b.
    """
    a, b, rate_a, rate_b = ([value] for value in state)
    apart, p, q, below = [], [], [], []
    waves_a, waves_b, waves = ([], []), ([], []), ([], [])
    squares_a, squares_b, turning_a, turning_b = [], [], [], []
    for k in range(order):
        apart.append(a[k] - b[k])
        for angle, (sines, cosines) in ((a, waves_a), (b, waves_b), (apart, waves)):
            _append_waves(angle, sines, cosines)
        sine, cosine = waves
        squares_a.append(_product(rate_a, rate_a, k))
        squares_b.append(_product(rate_b, rate_b, k))
        p.append(-_product(sine, squares_b, k) / 2 - 3 * gravity * waves_a[0][k] / 2)
        q.append(_product(sine, squares_a, k) / 2 - gravity * waves_b[0][k] / 2)
        below.append((Decimal(4) / 9 if k == 0 else 0) - _product(cosine, cosine, k) / 4)
        for turning, above in (
            (turning_a, p[k] / 3 - _product(cosine, q, k) / 2),
            (turning_b, 4 * q[k] / 3 - _product(cosine, p, k) / 2),
        ):
            known = sum((below[j] * turning[k - j] for j in range(1, k + 1)), Decimal(0))
            turning.append((above - known) / below[0])
        for series, slope in ((a, rate_a), (b, rate_b), (rate_a, turning_a), (rate_b, turning_b)):
            series.append(slope[k] / (k + 1))
    return [a, b, rate_a, rate_b]


def _product(x: Series, y: Series, k: int) -> Decimal:
    return sum((x[j] * y[k - j] for j in range(k + 1)), Decimal(0))


def _append_waves(angle: Series, sines: Series, cosines: Series) -> None:
    """The next terms of sine and cosine of a series."""
    k = len(sines)
    if k == 0:
        sines.append(_sine(angle[0]))
        cosines.append(_sine(angle[0] + _half_pi()))
        return
    sine, cosine = (
        sum((j * angle[j] * other[k - j] for j in range(1, k + 1)), Decimal(0)) for other in (cosines, sines)
    )
    sines.append(sine / k)
    cosines.append(-cosine / k)


def _half_pi() -> Decimal:
    """π/2 in the digits of the context, by Machin: π/4 = 4 arctan 1/5 − arctan 1/239."""
    return 2 * (4 * _arctan_of_inverse(5) - _arctan_of_inverse(239))


def _arctan_of_inverse(n: int) -> Decimal:
    term = Decimal(1) / n
    total, k, before = term, 1, None
    while total != before:
        before, term, k = total, -term / (n * n), k + 2
        total += term / k
    return total


def _sine(angle: Decimal) -> Decimal:
    """Taylor's series, of an angle that is not many turns."""
    term, total, k, before = angle, angle, 1, None
    while total != before:
        before = total
        term *= -angle * angle / ((k + 1) * (k + 2))
        k += 2
        total += term
    return total
