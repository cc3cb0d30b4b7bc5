"""Which inertias some distribution of mass has, and what happens to the others."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotation_samples import largest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbWarning, WrongStructure

TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def turned(moments) -> np.ndarray:
    """A full tensor with these principal moments, symmetric to the last bit."""
    matrix = TURN @ np.diag(moments) @ TURN.T
    return 0.5 * (matrix + matrix.T)


@pytest.mark.parametrize("value", [0.4, (1.0, 2.0, 2.5), turned((1.0, 2.0, 2.5))])
def test_possible_inertias_pass_unchanged(value):
    found = rb.valid_inertia(value)
    assert largest(found.as_matrix() - np.asarray(rb.Inertia.of(value).as_matrix())) == 0


@pytest.mark.parametrize(
    "plate", [(1.0, 2.0, 3.0), turned((1.0, 2.0, 3.0)), (1.0, 1.0, 2.0), (0.1, 0.2, 0.1 + 0.2)]
)
def test_thin_plate_with_equality_is_accepted_in_silence(plate):
    """A + B = C exactly: all mass in a plane. Warnings are errors in this suite. (BAD_INPUTS 29)"""
    body = rb.Body(1.0, plate)
    assert body.inertia.rank == np.ndim(plate)


@given(masses=st.lists(st.floats(0.01, 100), min_size=4, max_size=8), seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_every_set_of_particles_off_a_plane_has_a_possible_inertia(masses, seed):
    r = np.random.default_rng(seed).normal(size=(len(masses), 3))
    m = np.asarray(masses)
    r = r - m @ r / m.sum()
    tensor = np.einsum(
        "k,kij->ij", m, np.sum(r * r, -1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
    )
    rb.valid_inertia(0.5 * (tensor + tensor.T))


BROKEN = {
    "triangle": ((1.0, 1.0, 3.0), "triangle inequality"),
    "triangle of a full tensor": (turned((1.0, 1.0, 3.0)), "triangle inequality"),
    "negative": ((2.0, 1.8, -0.1), "not positive"),
    "negative eigenvalue of a full tensor": (turned((2.0, 1.8, -0.1)), "not positive"),
    "zero moment": ((1.0, 0.9, 0.0), "not positive"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_impossible_inertias_are_refused_with_moments_and_mend(case):
    """BAD_INPUTS 25, 26, 28."""
    value, problem = BROKEN[case]
    with pytest.raises(
        InvalidInput, match=r"Body\.inertia has principal moments \[.*kg m².*on_invalid='project'"
    ) as caught:
        rb.Body(1.0, value)
    assert problem in str(caught.value)


@pytest.mark.parametrize("value", [0.0, -1.0, (0.0, 0.0, 0.0), (-1.0, -1.0, -1.0), np.zeros((3, 3))])
def test_inertia_without_a_positive_moment_is_refused(value):
    with pytest.raises(InvalidInput, match="must be positive"):
        rb.Body(1.0, value)


@pytest.mark.parametrize("case", [name for name in BROKEN if "triangle" in name])
def test_impossible_inertia_is_used_as_it_is_when_asked_only_to_warn(case):
    value, _ = BROKEN[case]
    with pytest.warns(JaxrbWarning, match="used as it is"):
        found = rb.valid_inertia(value, on_invalid="warn")
    assert largest(found.as_matrix() - np.asarray(rb.Inertia.of(value).as_matrix())) == 0


@pytest.mark.parametrize("case", BROKEN)
def test_projection_gives_the_nearest_possible_second_moments(case):
    """Σ = tr(I)/2 − I with negative parts cut off: the projected inertia is possible and projecting again is idle."""
    value, _ = BROKEN[case]
    with pytest.warns(JaxrbWarning, match="nearest possible"):
        found = rb.valid_inertia(value, on_invalid="project")
    before, after = (np.asarray(i.as_matrix(), np.float64) for i in (rb.Inertia.of(value), found))
    second = [0.5 * np.trace(m) * np.eye(3) - m for m in (before, after)]
    values, axes = np.linalg.eigh(second[0])
    assert largest(second[1] - axes @ np.diag(np.maximum(values, 0)) @ axes.T) < 1e-6
    assert type(found) is type(rb.Inertia.of(value))
    rb.valid_inertia(found)


def test_projection_keeps_the_order_of_principal_moments():
    with pytest.warns(JaxrbWarning):
        found = rb.valid_inertia((1.0, 3.0, 1.2), on_invalid="project")
    assert np.asarray(found.moments).argsort().tolist() == [0, 2, 1]


def test_what_has_no_possible_inertia_near_it_is_refused_even_for_projection():
    with pytest.raises(InvalidInput, match="must be positive"):
        rb.valid_inertia((-1.0, -2.0, -3.0), on_invalid="project")
    with (
        pytest.warns(JaxrbWarning, match="not positive"),
        pytest.raises(InvalidInput, match="thin rod, which has no moment about its axis"),
    ):
        rb.valid_inertia((1.0, 1.0, -0.1), on_invalid="project")


@pytest.mark.parametrize("excess", [2e-7, 9e-7])
def test_violation_within_six_digits_is_repaired_with_a_warning(excess):
    """Data sheets round to six digits: relative to the trace, that much is measurement. (BAD_INPUTS 28)"""
    with pytest.warns(JaxrbWarning, match="nearest possible is used"):
        body = rb.Body(1.0, np.asarray([1.0, 1.0, 2.0 + 4.0 * excess]))
    moments = np.asarray(body.inertia.moments)
    assert moments[2] <= moments[0] + moments[1] + 1e-15
    with pytest.raises(InvalidInput):
        rb.Body(1.0, np.asarray([1.0, 1.0, 2.0 + 4.0 * 2e-6]))


def test_asymmetry_within_six_digits_is_repaired_with_a_warning_and_more_is_refused():
    """BAD_INPUTS 27."""
    matrix = turned((1.0, 2.0, 2.5))
    matrix[0, 1] += 5.5 * 5e-7
    with pytest.warns(JaxrbWarning, match="not symmetric.*symmetric part is used"):
        body = rb.Body(1.0, matrix)
    assert largest(body.inertia.as_matrix() - 0.5 * (matrix + matrix.T)) < 1e-6
    matrix[0, 1] += 5.5 * 2e-6
    with pytest.raises(InvalidInput, match=r"not symmetric.*\(M \+ Mᵀ\)/2"):
        rb.Body(1.0, matrix)


@pytest.mark.parametrize("value", [np.nan, (1.0, np.inf, 1.0), np.full((3, 3), np.nan)])
def test_inertia_must_be_finite(value):
    with pytest.raises(InvalidInput, match="finite"):
        rb.Body(1.0, value)


def test_unknown_treatment_is_refused_and_the_three_are_named():
    with pytest.raises(WrongStructure, match="'raise', 'warn' or 'project'"):
        rb.valid_inertia(1.0, on_invalid="ignore")


def test_message_names_the_body_of_a_replicated_inertia():
    moments = np.asarray([[1.0, 1.0, 1.0], [1.0, 1.0, 3.0]])
    with pytest.raises(InvalidInput, match="of body 1 has principal moments"):
        rb.valid_inertia(rb.PrincipalInertia(moments))


def test_range_is_checked_in_the_precision_of_the_numbers(dtype):
    """Limits beyond float32 must not overflow there: warnings are errors in this suite. (BAD_INPUTS 24)"""
    rb.Body(np.asarray(2.0, dtype), np.asarray([1.0, 1.0, 1.0], dtype))
    with pytest.warns(JaxrbWarning, match="1e-20 kg.*is the unit right"):
        rb.Body(1e-20, 1.0)
    for mass in (1e-300, 1e300):
        with pytest.raises(InvalidInput, match=r"Body\.mass is 1e.300 kg.*larger units"):
            rb.Body(mass, 1.0)
    with pytest.warns(JaxrbWarning, match="Body.inertia is 1e-16"):
        rb.Body(1.0, 1e-16)


def test_traced_inertias_pass(dtype):
    """Inside a fit the numbers are not there to be looked at; the run's status catches what is wrong."""

    def trace(moments):
        return rb.Body(moments[0], moments).inertia.trace()

    wrong = np.asarray([1.0, 1.0, -7.0], dtype)
    assert float(jax.jit(trace)(wrong)) == -5.0
    assert jax.grad(trace)(jax.numpy.asarray(wrong)).tolist() == [1, 1, 1]
    assert (
        float(jax.jit(lambda i: rb.Body(1.0, i * np.eye(3)).inertia.trace())(np.asarray(-1.0, dtype))) == -3.0
    )
