"""Weights of stabilised explicit Adams methods, and the one-step methods that start them.

Adams–Bashforth of order p takes y₁ = y₀ + h Σ wⱼ f₋ⱼ over p stored derivatives. Over k > p of them, k − p weights stay
free after the p order conditions. They are spent on the parasitic roots: the largest gain of the sum over all phases
from `_CUTOFF` to π, the part of the spectrum that no smooth solution occupies, is made as small as it can be (minimax,
by Lawson's reweighting; Lawson 1961, thesis, UCLA). That allows about twice the step of Adams–Bashforth.
"""

import dataclasses
import functools

import numpy as np
from numpy.polynomial import legendre

_CUTOFF = 0.8  # [rad a step]: the damping begins here; a smooth solution turns by less
_SWEEPS = 60


@dataclasses.dataclass(frozen=True)
class Scheme:
    """A method of `order` p over `nodes` k stored derivatives, started by a Runge–Kutta method of order `start`."""

    order: int
    nodes: int
    start: int

    def steps(self, cycles: int) -> int:
        """Number of steps in the start and `cycles` turns of the ring of derivatives."""
        return self.nodes - 1 + self.nodes * cycles

    def cycles(self, steps: float) -> int:
        """The least number of turns, at least one, that makes at least so many steps."""
        return max(1, -int(-(steps - self.nodes + 1) // self.nodes))


# Nodes by measurement: fewer cost stability, more cost loads from memory. The order is the key.
SCHEMES = {
    scheme.order: scheme
    for scheme in (
        Scheme(6, 8, 5),
        Scheme(7, 9, 5),
        Scheme(8, 10, 5),
        Scheme(9, 12, 5),
        Scheme(10, 13, 5),
        Scheme(11, 14, 8),
        Scheme(12, 17, 8),
    )
}


@functools.cache
def adams_weights(order: int, nodes: int) -> np.ndarray:
    """Weights (nodes,) of the derivatives at −(nodes − 1), …, −1, 0 steps, oldest first; exact for degree < order."""
    x = np.arange(1.0 - nodes, 1.0)
    center, scale = (nodes - 1) / 2, (nodes + 1) / 2  # Legendre polynomials on [−(nodes − 1), 1]
    conditions = legendre.legvander((x + center) / scale, order - 1).T
    wanted = scale * _integrals(center / scale, (1 + center) / scale, order)
    if nodes == order:
        weights = np.linalg.solve(conditions, wanted)
    else:
        base = np.linalg.lstsq(conditions, wanted, rcond=None)[0]
        weights = _damped(base, np.linalg.svd(conditions)[2][order:].T, x)
    for _ in range(3):  # the order conditions to the last digit
        residual = wanted.astype(np.longdouble) - conditions.astype(np.longdouble) @ weights
        weights = weights + np.linalg.lstsq(conditions, residual.astype(float), rcond=None)[0]
    return _rounded(np.asarray(weights, float), x)


def _integrals(start: float, end: float, count: int) -> np.ndarray:
    """Integrals of the Legendre polynomials of degree < count."""
    antiderivatives = [legendre.legint(row) for row in np.eye(count)]
    return np.array([legendre.legval(end, a) - legendre.legval(start, a) for a in antiderivatives])


def _damped(base: np.ndarray, free: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The weights base + free·z of least largest gain |Σ w e^(iφx)| / |e^(iφ) − 1| for φ in [_CUTOFF, π]."""
    phase = np.linspace(_CUTOFF, np.pi, 200)
    gain = np.exp(1j * np.outer(phase, x)) / np.abs(np.exp(1j * phase) - 1)[:, None]
    emphasis, weights = np.ones(phase.size), base
    for _ in range(_SWEEPS):
        root = np.sqrt(emphasis)[:, None]
        system = np.vstack([root * gain.real, root * gain.imag])
        weights = base + free @ np.linalg.lstsq(system @ free, -system @ base, rcond=None)[0]
        emphasis = emphasis * np.abs(gain @ weights)
        emphasis = emphasis / emphasis.mean()
    return weights


def _rounded(weights: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The weights with their two smallest changed so that sum and first moment are exact as stored.

    An error of 1e-16 in the sum acts at every step: it is a wrong speed of time.
    """
    weights = weights.copy()
    i, j = np.argsort(np.abs(weights))[:2]
    for _ in range(6):
        precise = weights.astype(np.longdouble)
        missing = [float(1 - precise.sum()), float(np.longdouble(0.5) - (precise * x).sum())]
        weights[[i, j]] += np.linalg.solve(np.array([[1, 1], [x[i], x[j]]]), missing)
    return weights


def ring_weights(scheme: Scheme) -> np.ndarray:
    """(nodes, nodes): row r holds the weights in the order of the ring's slots when slot r is the next to be written.

    Slots r, r + 1, … then hold the derivatives from the oldest to the newest.
    """
    weights = adams_weights(scheme.order, scheme.nodes)
    return np.stack([np.roll(weights, r) for r in range(scheme.nodes)])


def interpolation(scheme: Scheme) -> np.ndarray:
    """(nodes, nodes) matrix that takes integrals of Legendre polynomials over a turn to weights of the ring.

    With the slots at steps −(nodes − 1), …, 0 and Legendre polynomials on [−nodes, 0].
    """
    nodes = scheme.nodes
    slots = np.arange(1.0 - nodes, 1.0)
    return np.linalg.inv(legendre.legvander(2 * slots / nodes + 1, nodes - 1).T)


def starter(scheme: Scheme) -> tuple[np.ndarray, np.ndarray]:
    """Stage matrix (s, s) and weights (s,) of the Runge–Kutta method that makes the first nodes − 1 steps."""
    rows, weights = _STARTERS[scheme.start]
    stages = np.zeros((len(weights), len(weights)))
    for i, row in enumerate(rows):
        stages[i, : len(row)] = row
    return stages, np.array(weights)


# Dormand and Prince 1980, J. Comput. Appl. Math. 6, 19: order 5 in 6 stages; and, of order 8 in 12 stages, Hairer,
# Nørsett, Wanner, "Solving Ordinary Differential Equations I", 1993, section II.5 (DOP853).
_STARTERS: dict[int, tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]] = {
    5: (
        (
            (),
            (1 / 5,),
            (3 / 40, 9 / 40),
            (44 / 45, -56 / 15, 32 / 9),
            (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
            (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        ),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    ),
    8: (
        (
            (),
            (0.05260015195876773,),
            (0.0197250569845379, 0.0591751709536137),
            (0.02958758547680685, 0.0, 0.08876275643042054),
            (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
            (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
            (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
            (
                0.03709200011850479,
                0.0,
                0.0,
                0.17038392571223998,
                0.10726203044637328,
                -0.015319437748624402,
                0.008273789163814023,
            ),
            (
                0.6241109587160757,
                0.0,
                0.0,
                -3.3608926294469414,
                -0.868219346841726,
                27.59209969944671,
                20.154067550477894,
                -43.48988418106996,
            ),
            (
                0.47766253643826434,
                0.0,
                0.0,
                -2.4881146199716677,
                -0.590290826836843,
                21.230051448181193,
                15.279233632882423,
                -33.28821096898486,
                -0.020331201708508627,
            ),
            (
                -0.9371424300859873,
                0.0,
                0.0,
                5.186372428844064,
                1.0914373489967295,
                -8.149787010746927,
                -18.52006565999696,
                22.739487099350505,
                2.4936055526796523,
                -3.0467644718982196,
            ),
            (
                2.273310147516538,
                0.0,
                0.0,
                -10.53449546673725,
                -2.0008720582248625,
                -17.9589318631188,
                27.94888452941996,
                -2.8589982771350235,
                -8.87285693353063,
                12.360567175794303,
                0.6433927460157636,
            ),
        ),
        (
            0.054293734116568765,
            0.0,
            0.0,
            0.0,
            0.0,
            4.450312892752409,
            1.8915178993145003,
            -5.801203960010585,
            0.3111643669578199,
            -0.1521609496625161,
            0.20136540080403034,
            0.04471061572777259,
        ),
    ),
}
