"""Twins of real throws: a wheel gives the scale, an accelerometer the flight and the centre of mass, drag is found."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fit_flights import throws

import jaxrb as rb
from jaxrb.bench import identification as bench
from jaxrb.fit import ParametersNotIdentifiable, find_flights, fit_inertia
from jaxrb.io import Recording, read_recording, write_recording

TENSOR = np.array([[3.0e-3, 2e-4, 1e-4], [2e-4, 4.1e-3, -3e-4], [1e-4, -3e-4, 5.2e-3]])  # [kg m²]
ARM = (0.01, -0.02, 0.015)  # [m]
RACKET = np.diag([0.00121, 0.0164, 0.01748])  # [kg m²]


def eigenvalue_error(found, tensor) -> float:
    """Mean relative error of the principal moments."""
    moments = np.linalg.eigvalsh(np.asarray(found.inertia.as_matrix(), float))
    return float(np.mean(np.abs(moments / np.linalg.eigvalsh(tensor) - 1.0)))


@pytest.fixture(scope="module")
def wheeled():
    """Eight throws with a wheel, an accelerometer, drag, a biased gyroscope, and a hand before and after."""
    if not jax.config.jax_enable_x64:
        pytest.skip("a fit runs in float64 whatever the flag; the racket shows that here")
    tosses = throws(TENSOR, 1, 8, rate=250.0, wheel=0.02, arm=ARM, handled=0.3, linear=0.02, bias=0.05)
    return tosses, fit_inertia(tosses)


def test_a_wheel_gives_the_scale(wheeled):
    _, found = wheeled
    assert found.scale_known
    assert abs(found.trace - np.trace(TENSOR)) < 4 * found.trace_error < 0.01 * np.trace(TENSOR)
    assert eigenvalue_error(found, TENSOR) < 2e-3


def test_the_nuisances_that_are_there_are_chosen(wheeled):
    _, found = wheeled
    needed = {tried.name for tried in found.nuisance.tried if tried.needed}
    assert needed == {"linear_drag", "gyro_bias"}
    drag, error, unit = found.nuisance.values["linear_drag"]
    assert abs(drag[0] - 0.02) < 4 * error[0]
    assert unit == "1/s"
    assert "not needed" in found.summary()


def test_flights_are_found_by_the_accelerometer(wheeled):
    tosses, found = wheeled
    flights = find_flights(tosses)
    assert flights.cut_by == found.nuisance.cut_by == "accelerometer"
    assert len(flights) == tosses.tosses
    for flight in flights.flights:
        first = flight.start - tosses.starts[flight.toss]
        assert 75 <= first <= 80  # 0.3 s of handling at 250 Hz
        assert 240 <= first + len(flight) <= 250


def test_throws_with_wheels_of_their_own_are_fitted_together(wheeled):
    """The same recordings one by one, as a sequence: the same numbers, to the last digits."""
    tosses, found = wheeled
    bounds = list(zip(tosses.starts[:-1], tosses.starts[1:]))
    parts = [
        Recording(tosses.time[a:b], tosses.angular_velocity[a:b], specific_force=tosses.specific_force[a:b],
                  internal_momentum=tosses.internal_momentum[a:b])
        for a, b in bounds
    ]  # fmt: skip
    again = fit_inertia(parts)
    np.testing.assert_allclose(again.trace, found.trace, rtol=1e-9)
    lacking = Recording(tosses.time[:50], tosses.angular_velocity[:50])
    with pytest.raises(rb.InvalidInput, match="'internal_momentum' is missing"):
        fit_inertia([parts[0], lacking])


def test_wheel_and_accelerometer_survive_a_file(wheeled, tmp_path):
    tosses, _ = wheeled
    for suffix in (".csv", ".npz"):
        back = read_recording(write_recording(tosses, tmp_path / f"throws{suffix}"))
        np.testing.assert_allclose(back.internal_momentum, tosses.internal_momentum, rtol=1e-15)
        np.testing.assert_allclose(back.specific_force, tosses.specific_force, rtol=1e-15)
    text = "# frame: body\ntime [s], wx [deg/s], wy [deg/s], wz [deg/s], fx [g], fy [g], fz [g]\n"
    (tmp_path / "phone.csv").write_text(text + "0, 180, 0, 0, 0, 0, 1\n0.01, 180, 0, 0, 0, 0, 1\n")
    phone = read_recording(tmp_path / "phone.csv")
    np.testing.assert_allclose(phone.angular_velocity[0], [np.pi, 0, 0])
    np.testing.assert_allclose(phone.specific_force[0], [0, 0, 9.80665])


def test_an_accelerometer_shows_where_the_centre_of_mass_is(wheeled):
    tosses, _ = wheeled
    found = fit_inertia(
        tosses, nuisances=("linear_drag", "gyro_bias"), centre_of_mass=True, required=["scale"]
    )
    arm, error, _ = found.nuisance.values["lever_arm"]
    assert np.all(np.abs(arm - ARM) < 4 * error)
    assert error.max() < 1e-3
    assert found.identifiable["centre of mass"]


@pytest.mark.parametrize(("what", "components"), [("mass", 1), ("scale", 1), ("centre of mass", 3)])
def test_what_no_torque_free_flight_shows_is_refused(what, components):
    tosses = throws(TENSOR, 2, 4, rate=200.0)
    with pytest.raises(ParametersNotIdentifiable, match=what) as refusal:
        fit_inertia(tosses, nuisances=(), required=[what])
    assert refusal.value.null_vectors.shape == (components, 10)
    with pytest.raises(rb.InvalidInput, match="known are scale, mass"):
        fit_inertia(tosses, required=["colour"])


def test_a_wheel_at_rest_gives_no_scale():
    tosses = throws(TENSOR, 2, 4, rate=200.0, wheel=1e-30)
    still = Recording(tosses.time, tosses.angular_velocity, internal_momentum=0 * tosses.angular_velocity,
                      length=tosses.length)  # fmt: skip
    with pytest.raises(rb.NotIdentifiable, match="wheel at rest"):
        fit_inertia(still)


def test_each_toss_of_a_flipping_racket_converges_from_a_sphere():
    """One compiled program for tosses of different lengths."""
    for seed in range(4):
        toss = throws(RACKET, seed, 1, duration=0.85 + 0.03 * seed, rate=200.0, size=14.0, noise=0.05,
                      direction=(0.03, 1, 0.02), linear=0.005, quadratic=0.002)  # fmt: skip
        found = fit_inertia(toss, nuisances=("linear_drag", "quadratic_drag"))
        assert found.nuisance.spin_noise < 0.06
        assert eigenvalue_error(found, RACKET / np.trace(RACKET)) < 0.02


def test_random_starts_reach_the_optimum_also_when_flipping():
    """The figures of `jaxrb bench --what identification`, in small."""
    if not jax.config.jax_enable_x64:
        pytest.skip("computed in float64 whatever the flag")
    with jax.enable_x64(True):
        program = jax.jit(bench.fit_batch, compiler_options=rb.compiler_options())
        for direction in bench.DIRECTIONS.values():
            times, spin = bench.flight(direction)
            data = bench.packed(times, spin, 0.02)
            measured = bench.noisy_batch(spin, 0.02, 100, data[0], True)
            starts = jnp.asarray(bench.random_starts(100)).at[0].set(0.0)
            ended, iterations = program(starts, *measured, *data)
            cost = np.asarray(ended.cost)
            assert np.mean(cost <= cost[0] * (1 + 1e-6)) >= 0.99
            # Half the sum of squares of 603 numbers less eight unknowns: this is the optimum.
            assert cost[0] == pytest.approx(0.5 * 595, rel=0.15)
            assert np.median(np.asarray(iterations)) <= 25
