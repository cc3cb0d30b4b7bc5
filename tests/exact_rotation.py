"""Torque-free rotation without the engine: Taylor series in whole numbers, 54 digits behind the point.

Whole numbers of Python are ten times as fast as mpmath. Order and step leave 1e-27 after 16 revolutions, and so the
derivatives, which are differences of the same smooth function; checked against `shared/oracle`.
"""

import math
from fractions import Fraction

import numpy as np

BITS = 180
ORDER = 34


def fixed(value) -> int:
    """A number as a multiple of 2⁻¹⁸⁰."""
    value = Fraction(value)
    return (value.numerator << BITS) // value.denominator


def inverse(matrix):
    """Of a 3×3 matrix of fractions, by cofactors."""

    def minor(i, j):
        a, b, c, d = (matrix[r][s] for r in range(3) if r != i for s in range(3) if s != j)
        return (-1) ** (i + j) * (a * d - b * c)

    determinant = sum(matrix[0][j] * minor(0, j) for j in range(3))
    return [[minor(j, i) / determinant for j in range(3)] for i in range(3)]


def tensor(six):
    """xx, yy, zz, xy, xz, yz as a matrix of fractions."""
    xx, yy, zz, xy, xz, yz = map(Fraction, six)
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


def rotated(omega, six, time):
    """wxyz and ω, seven whole numbers, after `time` from the identity; exact inputs: floats or fractions."""
    matrix = tensor(six)
    i, k = ([[fixed(x) for x in row] for row in m] for m in (matrix, inverse(matrix)))
    w, q = [fixed(x) for x in omega], [1 << BITS, 0, 0, 0]
    steps = max(1, math.ceil(2.0 * abs(float(time)) * math.sqrt(sum(float(x) ** 2 for x in omega))))
    step = fixed(Fraction(time) / steps)
    for _ in range(steps):
        w, q = _step(w, q, i, k, step)
    return q + w


def _apply(matrix, v):
    return [sum(m * x for m, x in zip(row, v) if m) >> BITS for row in matrix]


def _step(w, q, i, k, step):
    """One step: the Taylor coefficients by recursion, times the powers of the step."""
    ws, qs, ls = [[x] for x in w], [[x] for x in q], [[x] for x in _apply(i, w)]
    for n in range(ORDER):

        def conv(a, b, n=n):
            return sum(a[r] * b[n - r] for r in range(n + 1)) >> BITS

        net = [
            conv(ls[1], ws[2]) - conv(ls[2], ws[1]),
            conv(ls[2], ws[0]) - conv(ls[0], ws[2]),
            conv(ls[0], ws[1]) - conv(ls[1], ws[0]),
        ]
        turn = [
            -conv(qs[1], ws[0]) - conv(qs[2], ws[1]) - conv(qs[3], ws[2]),
            conv(qs[0], ws[0]) + conv(qs[2], ws[2]) - conv(qs[3], ws[1]),
            conv(qs[0], ws[1]) + conv(qs[3], ws[0]) - conv(qs[1], ws[2]),
            conv(qs[0], ws[2]) + conv(qs[1], ws[1]) - conv(qs[2], ws[0]),
        ]
        new = [(x * step) // ((n + 1) << BITS) for x in _apply(k, net)]
        for row, x in zip(ws, new):
            row.append(x)
        for row, x in zip(ls, _apply(i, new)):
            row.append(x)
        for row, x in zip(qs, turn):
            row.append((x * step) // ((2 * n + 2) << BITS))
    return [sum(row) for row in ws], [sum(row) for row in qs]


def as_floats(numbers):
    """Fixed-point numbers as an array."""
    return np.array([x / (1 << BITS) for x in numbers])


def attitude_error(exact, wxyz) -> float:
    """2·min|a ∓ b| [rad] of the exact attitude and a computed one, the difference formed exactly."""
    given = [fixed(float(x)) for x in wxyz]
    squares = [sum(float(Fraction(a + s * b, 1 << BITS)) ** 2 for a, b in zip(exact, given)) for s in (1, -1)]
    return 2.0 * math.sqrt(min(squares))


def jacobian(omega, six, time, columns):
    """Derivatives (7, len(columns)) of wxyz and ω with respect to ω (0–2), the six (3–8) and time (9).

    Differences over 1e-17 on either side, so exact to 1e-27.
    """
    at = [Fraction(x) for x in (*omega, *six, time)]
    h = Fraction(1, 10**17)
    result = []
    for column in columns:
        ends = []
        for side in (1, -1):
            x = list(at)
            x[column] += side * h
            ends.append(rotated(x[:3], x[3:9], x[9]))
        result.append([float(Fraction(a - b, 1 << BITS) / (2 * h)) for a, b in zip(*ends)])
    return np.array(result).T
