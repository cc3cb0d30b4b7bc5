"""The parts of the fit: coordinates of inertia, arrow-shaped least squares, free fall."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference_flights import TENSOR

from jaxrb.errors import InvalidInput, NotIdentifiable
from jaxrb.fit import find_flights, fit_free_fall
from jaxrb.fit.chain import solve_chain
from jaxrb.fit.flights import STANDARD_GRAVITY
from jaxrb.fit.least_squares import (
    CONVERGED,
    NOT_FINITE,
    OUT_OF_ITERATIONS,
    levenberg_marquardt,
)
from jaxrb.fit.metre import metric_scale
from jaxrb.fit.parametrise import (
    MassMoments,
    coordinates_from_inertia,
    coordinates_from_moments,
    coordinates_from_ratios,
    inertia_from_coordinates,
    moments_from_coordinates,
    moved_ratios,
    ratios_from_coordinates,
)
from jaxrb.fit.problem import Alone, Prior
from jaxrb.fit.wishes import wishes_of
from jaxrb.io import Recording


def test_coordinates_of_an_inertia_lead_back_to_it(tolerance):
    near = tolerance(float64=1e-14, float32=1e-6)
    tensor = jnp.asarray(TENSOR)
    np.testing.assert_allclose(inertia_from_coordinates(coordinates_from_inertia(tensor)), TENSOR, atol=near)
    ratios = ratios_from_coordinates(coordinates_from_ratios(tensor))
    np.testing.assert_allclose(ratios, TENSOR / np.trace(TENSOR), atol=near)


def test_coordinates_of_ten_moments_lead_back_to_them(tolerance):
    near = tolerance(float64=1e-13, float32=1e-5)
    # About an origin outside the centre of mass: 2 kg at (0.1, −0.2, 0.3) m.
    center = np.array([0.1, -0.2, 0.3])
    about_origin = TENSOR + 2.0 * (center @ center * np.eye(3) - np.outer(center, center))
    moments = MassMoments(jnp.asarray(2.0), jnp.asarray(2.0 * center), jnp.asarray(about_origin))
    back = moments_from_coordinates(coordinates_from_moments(moments))
    for found, given in zip(back, moments):
        np.testing.assert_allclose(found, given, atol=near)
    jacobian = jax.jacfwd(lambda m: coordinates_from_moments(m))(moments)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(jacobian))


@pytest.mark.parametrize("seed", range(5))
def test_any_coordinates_give_moments_that_a_body_can_have(seed):
    random = np.random.default_rng(seed)
    with jax.enable_x64(True):
        six = np.linalg.eigvalsh(np.asarray(inertia_from_coordinates(jnp.asarray(2 * random.normal(size=6)))))
        five = np.asarray(ratios_from_coordinates(jnp.asarray(2 * random.normal(size=5))))
    for moments in (six, np.linalg.eigvalsh(five)):
        assert np.all(moments > 0)
        assert moments[0] + moments[1] > moments[2]
    assert np.trace(five) == pytest.approx(1.0, abs=1e-12)


def test_both_ways_are_inverse_also_in_their_derivatives():
    with jax.enable_x64(True):
        theta = coordinates_from_ratios(jnp.asarray(TENSOR))
        there = jax.jacfwd(lambda t: coordinates_from_ratios(ratios_from_coordinates(t)))(theta)
    np.testing.assert_allclose(there, np.eye(5), atol=1e-12)


@pytest.mark.parametrize("moments", [(1.0, 1.0, 2.5), (1.0, 1.0, 2.0), (1.0, -1.0, 1.0)])
def test_moments_that_no_body_has_are_refused(moments):
    with pytest.raises(InvalidInput, match="no distribution of mass"):
        coordinates_from_inertia(jnp.diag(jnp.asarray(moments)))


# Decays with one rate in common, and a height of each segment's own: y = a_s exp(−k t).
RATE, HEIGHTS = 1.3, np.array([0.5, 1.0, 2.0, 4.0])
MOMENTS = np.linspace(0.0, 2.0, 20)


def decay(shared, local, data):
    time, value, present = data
    return present * (local[0] * jnp.exp(-shared[0] * time) - value)


DECAY = Alone(decay)


@pytest.fixture(scope="module")
def decays():
    noise = 0.01 * np.random.default_rng(1).normal(size=(4, 20))
    value = HEIGHTS[:, None] * np.exp(-RATE * MOMENTS) + noise
    present = np.ones((4, 20))
    present[1, 15:] = 0.0
    return np.tile(MOMENTS, (4, 1)), value, present


def solve(data, *, shared=(0.2,), weight=(1.0, 1.0, 1.0, 1.0), free=(1.0,), **options):
    with jax.enable_x64(True):
        data = jax.tree.map(lambda array: jnp.asarray(array)[:, None], data)
        return levenberg_marquardt(
            DECAY, jnp.asarray(shared), jnp.ones((4, 1, 1)), data,
            weight=jnp.asarray(weight), free=jnp.asarray(free), **options,
        )  # fmt: skip


def dense(data, rows):
    """The same problem without any structure, by SciPy."""
    from scipy.optimize import least_squares

    time, value, present = data

    def residual(z):
        return np.concatenate([present[s] * (z[1 + s] * np.exp(-z[0] * time[s]) - value[s]) for s in rows])

    return least_squares(residual, np.array([0.2, 1.0, 1.0, 1.0, 1.0]), xtol=1e-14, ftol=1e-14, gtol=1e-14)


def test_the_arrow_finds_what_a_dense_solver_finds(decays):
    found, expected = solve(decays), dense(decays, range(4))
    assert int(found.status) == CONVERGED
    np.testing.assert_allclose(np.asarray(found.shared), expected.x[:1], atol=1e-6)
    np.testing.assert_allclose(np.asarray(found.local)[:, 0, 0], expected.x[1:], atol=1e-6)
    assert float(found.cost) == pytest.approx(expected.cost, rel=1e-9)


def test_the_information_is_that_of_the_dense_normal_equations(decays):
    n = jax.tree.map(np.asarray, solve(decays).normal)
    border, own = n.border[:, 0], n.local[:, 0]
    schur = np.sum(n.shared - border @ np.linalg.solve(own, np.swapaxes(border, 1, 2)), axis=0)
    jacobian = dense(decays, range(4)).jac
    assert 1 / schur[0, 0] == pytest.approx(np.linalg.inv(jacobian.T @ jacobian)[0, 0], rel=1e-4)


def test_a_segment_without_weight_is_left_out(decays):
    spoilt = (decays[0], decays[1].copy(), decays[2])
    spoilt[1][2] = np.linspace(0, 50, 20)
    found, expected = solve(spoilt, weight=(1.0, 1.0, 0.0, 1.0)), dense(spoilt, (0, 1, 3))
    np.testing.assert_allclose(np.asarray(found.shared), expected.x[:1], atol=1e-6)
    assert float(found.local[2, 0, 0]) == 1.0


def test_a_held_parameter_stays(decays):
    found = solve(decays, free=(0.0,))
    assert float(found.shared[0]) == pytest.approx(0.2, abs=0.0)
    assert int(found.status) == CONVERGED


def test_how_it_ended_is_said(decays):
    assert int(solve(decays, shared=(np.nan,)).status) == NOT_FINITE
    assert int(solve(decays, max_iterations=2).status) == OUT_OF_ITERATIONS


def test_a_chain_is_solved_as_the_dense_matrix_is():
    random = np.random.default_rng(3)
    links = np.concatenate([random.normal(size=(4, 2, 2)), np.zeros((1, 2, 2))])
    dense, right = np.zeros((10, 10)), random.normal(size=(10, 3))
    for w in range(5):
        here = slice(2 * w, 2 * w + 2)
        dense[here, here] = 8.0 * np.eye(2) + 0.5
        if w < 4:
            there = slice(2 * w + 2, 2 * w + 4)
            dense[here, there], dense[there, here] = links[w], links[w].T
    with jax.enable_x64(True):
        blocks = jnp.stack([jnp.asarray(dense[2 * w : 2 * w + 2, 2 * w : 2 * w + 2]) for w in range(5)])
        found = solve_chain(blocks, jnp.asarray(links), jnp.asarray(right.reshape(5, 2, 3)))
    np.testing.assert_allclose(np.asarray(found).reshape(10, 3), np.linalg.solve(dense, right), atol=1e-13)


def test_huber_lets_a_spoilt_sample_pull_no_more_than_its_bound(decays):
    spoilt = (decays[0], decays[1].copy(), decays[2])
    spoilt[1][2, 5] += 3.0
    plain, robust = (abs(float(solve(spoilt, huber=h).shared[0]) - RATE) for h in (np.inf, 0.02))
    assert robust < 0.03 < plain


def test_a_prior_holds_what_the_data_do_not(decays):
    with jax.enable_x64(True):
        sure = Prior(jnp.array([2.0]), jnp.array([[1e9]]))
    assert float(solve(decays, prior=sure).shared[0]) == pytest.approx(2.0, abs=1e-6)


def test_moved_ratios_are_products_of_triangular_matrices():
    random = np.random.default_rng(0)
    with jax.enable_x64(True):
        here, step = random.normal(size=5), random.normal(size=5)

        def lower(five):
            matrix = np.diag([*np.exp(five[:2]), 1.0])
            matrix[1, 0], matrix[2, 0], matrix[2, 1] = five[2:]
            return matrix

        moved = lower(np.asarray(moved_ratios(jnp.asarray(here), jnp.asarray(step))))
    np.testing.assert_allclose(moved, lower(here) @ lower(step), atol=1e-13)


def falling(seed: int, tosses: int = 30, gravity: float = 9.5, noise: float = 2e-4) -> Recording:
    """Tosses at rest, then in flight, then at rest, with a drift of each toss's own that no model knows."""
    random = np.random.default_rng(seed)
    t = np.arange(20) / 100.0
    places = []
    for _ in range(tosses):
        own = gravity + 0.05 * random.normal()
        z = 1.0 + 0.5 * t - 0.5 * own * t**2
        z = np.concatenate([np.full(20, z[0]), z, np.full(20, z[-1])])
        x = np.concatenate([np.zeros(20), 0.3 * t, np.full(20, 0.3 * t[-1])])
        places.append(np.stack([x, 0 * z, z], axis=-1) + noise * random.normal(size=(60, 3)))
    return Recording([np.arange(60) / 100.0] * tosses, position=places)


def test_free_fall_is_found_with_a_right_error_bar():
    results = []
    for seed in range(30):
        recording = falling(seed)
        results.append(fit_free_fall(recording, find_flights(recording)))
    error = np.array([r.acceleration[2] + 9.5 for r in results]) / [r.standard_error[2] for r in results]
    assert abs(error.mean()) < 1.0
    assert 0.6 < error.std() < 1.5


def test_flights_are_cut_at_the_contacts():
    found = find_flights(falling(0))
    assert len(found) == 30
    for flight in found.flights:
        first = flight.start - 60 * flight.toss
        assert 19 <= first <= 24
        assert 36 <= first + len(flight) <= 41


def test_a_recording_that_never_falls_is_refused():
    time, place = np.arange(100) / 100.0, np.zeros((100, 3))
    with pytest.raises(InvalidInput, match=r"no free fall.*length_unit"):
        find_flights(Recording(time, position=place))


def test_millimetres_read_as_metres_are_refused():
    recording = falling(0)
    assert recording.position is not None
    with pytest.raises(InvalidInput, match="length_unit"):
        find_flights(Recording(recording.time, position=1e3 * recording.position, length=recording.length))


def test_free_fall_needs_two_tosses():
    recording = falling(0, tosses=1)
    with pytest.raises(InvalidInput, match="at least two"):
        fit_free_fall(recording, find_flights(recording))


def test_a_wrong_metre_is_found_with_a_right_error_bar():
    """Lengths 3 % too long, 30 tosses; whatever is believed of gravity is in the error bar."""
    found, fall = [], None
    for seed in range(30):
        recording = falling(seed, gravity=1.03 * 9.8)
        fall = fit_free_fall(recording, find_flights(recording))
        found.append(metric_scale(fall, 9.8, None, "falling"))
    off = np.array([(metre.value - 0.03) / metre.error for metre in found])
    assert abs(off.mean()) < 1.0
    assert 0.6 < off.std() < 1.5
    assert all(metre.tried.needed for metre in found)
    rough = metric_scale(fall, STANDARD_GRAVITY, None, "falling")
    assert rough.error == pytest.approx(np.hypot(found[-1].error, 0.015 / 9.81), rel=0.01)
    # Two beliefs of equal weight meet half way.
    seen = found[-1]
    half = metric_scale(fall, 9.8, (0.0, seen.error), "falling")
    assert half.value == pytest.approx(0.5 * seen.value)
    assert half.error == pytest.approx(seen.error / np.sqrt(2.0))
    right = falling(0, gravity=9.8)
    assert not metric_scale(fit_free_fall(right, find_flights(right)), 9.8, None, "falling").tried.needed
    with pytest.raises(NotIdentifiable, match="two tosses"):
        metric_scale(None, 9.8, None, "one toss")


def test_the_metre_is_among_the_nuisances_of_recordings_that_show_it():
    recording, nothing = falling(0, tosses=2), (None, None, 100)
    for nuisances, wanted in (
        ("auto", True),
        (("metric_scale",), True),
        ((), False),
        (("linear_drag",), False),
    ):
        found = wishes_of(recording, None, False, nuisances, False, *nothing)
        assert found.metre is wanted
        assert "metric_scale" not in (*found.always, *found.among)
    assert not wishes_of(falling(0, tosses=1), None, False, "auto", False, *nothing).metre
    without = Recording(recording.time, np.ones((len(recording.time), 3)), length=recording.length)
    assert not wishes_of(without, None, False, "auto", False, *nothing).metre
    with pytest.raises(InvalidInput, match="leaves no trace"):
        wishes_of(without, None, False, ("metric_scale",), False, *nothing)
