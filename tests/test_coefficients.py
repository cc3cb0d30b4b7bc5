"""The published numbers in the methods, by the conditions they are to meet. Plain arithmetic in float64."""

import numpy as np
import pytest

from jaxrb.integrators.adams_weights import SCHEMES, adams_weights, interpolation, ring_weights, starter
from jaxrb.integrators.splitting import BLANES_MOAN_4, BLANES_MOAN_6, STRANG


def rooted_trees(order):
    """All rooted trees of so many nodes, each the sorted tuple of its branches: a leaf put at every node of each."""
    if order == 1:
        return {()}

    def grown(tree):
        yield tuple(sorted((*tree, ())))
        for i, branch in enumerate(tree):
            for larger in grown(branch):
                yield tuple(sorted((*tree[:i], larger, *tree[i + 1 :])))

    return {larger for tree in rooted_trees(order - 1) for larger in grown(tree)}


def nodes_of(tree):
    return 1 + sum(nodes_of(branch) for branch in tree)


def density(tree):
    """γ: the nodes times the densities of the branches."""
    return nodes_of(tree) * np.prod([density(branch) for branch in tree], initial=1.0)


def weight(stages, tree):
    """Of each stage, Butcher's elementary weight."""
    return np.prod([stages @ weight(stages, branch) for branch in tree], axis=0, initial=1.0) * np.ones(
        len(stages)
    )


@pytest.mark.parametrize("order", [5, 8])
def test_runge_kutta_methods_that_start_a_run_meet_all_conditions_of_their_order(order):
    """Σ b Φ(t) = 1/γ(t) for each rooted tree t of at most that many nodes (Butcher 1963)."""
    scheme = next(scheme for scheme in SCHEMES.values() if scheme.start == order)
    stages, weights = starter(scheme)
    np.testing.assert_array_equal(stages, np.tril(stages, -1))
    trees = [tree for nodes in range(1, order + 1) for tree in rooted_trees(nodes)]
    assert len(trees) == {5: 17, 8: 200}[order]
    missed = [weights @ weight(stages, tree) - 1.0 / density(tree) for tree in trees]
    assert np.abs(missed).max() < 1e-13
    # And no more than that: the conditions tell one order from the next.
    assert (
        max(abs(weights @ weight(stages, tree) - 1.0 / density(tree)) for tree in rooted_trees(order + 1))
        > 1e-6
    )


def test_each_order_from_six_to_twelve_has_a_scheme_and_is_exact_for_polynomials_below_it():
    assert list(SCHEMES) == list(range(6, 13))
    for order, scheme in SCHEMES.items():
        nodes = scheme.nodes
        x = np.arange(1.0 - nodes, 1.0)
        weights = adams_weights(order, nodes)
        # ∫₀¹ ((x + c)/s)^k dx with the powers scaled to the range of the nodes, or round-off hides the last ones.
        center, scale = (nodes - 1) / 2, (nodes + 1) / 2
        for k in range(order):
            wanted = ((1 + center) ** (k + 1) - center ** (k + 1)) / ((k + 1) * scale**k)
            assert weights @ ((x + center) / scale) ** k == pytest.approx(
                wanted, abs=1e-14 * np.abs(weights).sum()
            )
        for row, ring in enumerate(ring_weights(scheme)):
            np.testing.assert_array_equal(np.roll(ring, -row), weights)
        # The weights of a whole turn: the integral of each Legendre polynomial over it.
        values = np.polynomial.legendre.legvander(2 * x / nodes + 1, nodes - 1)
        np.testing.assert_allclose(values.T @ interpolation(scheme), np.eye(nodes), atol=1e-9)


def swung(parts, steps):
    """Angle and speed of a pendulum after 2 s of kicks and drifts."""
    angle, speed = 1.0, 0.5
    for _ in range(steps):
        for first, second in parts:
            speed -= 2.0 / steps * first * np.sin(angle)
            angle += 2.0 / steps * (first + second) * speed
            speed -= 2.0 / steps * second * np.sin(angle)
    return np.array([angle, speed])


@pytest.mark.parametrize(
    ("parts", "order", "steps", "worst"),
    [(STRANG, 2, 20, 3e-3), (BLANES_MOAN_4, 4, 20, 1e-6), (BLANES_MOAN_6, 6, 20, 1e-9)],
    ids=["Strang", "order 4", "order 6"],
)
def test_compositions_have_their_order_and_read_the_same_backwards(parts, order, steps, worst):
    flat = [number for pair in parts for number in pair]
    assert flat == pytest.approx(flat[::-1], abs=1e-15)
    assert sum(flat) == pytest.approx(1.0, abs=1e-15)
    exact = swung(BLANES_MOAN_6, 640)
    coarse, fine = (np.abs(swung(parts, n) - exact).max() for n in (steps, 2 * steps))
    assert coarse < worst
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)
