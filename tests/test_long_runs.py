"""What the methods of free flight keep over many steps: angular momentum to round-off, energy without a trend.

The same figures after 1e7 steps: `python -m jaxrb.bench.methods --steps 10000000`, and in docs/methods.md.
"""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.bench.methods import long_run
from jaxrb.integrators import METHODS

STEPS = 40_000
FULL = np.array([[1.0, 0.1, 0.05], [0.1, 2.0, 0.1], [0.05, 0.1, 2.5]])


@pytest.fixture(scope="module")
def run():
    """`run(name, rotation)`: a long run of a method, each made once."""
    return functools.cache(lambda name, rotation=rb.Quaternion: long_run(METHODS[name](), STEPS, rotation))


@pytest.mark.parametrize("rotation", [rb.Quaternion, rb.RotationMatrix], ids=lambda r: r.__name__)
@pytest.mark.parametrize("name", ["ThreeAxisSplitting", "MoserVeselov4"])
def test_angular_momentum_in_the_world_is_kept_to_round_off(run, tolerance, name, rotation):
    assert run(name, rotation).momentum < tolerance(float64=1e-13, float32=6e-5)


@pytest.mark.parametrize("name", ["ThreeAxisSplitting4", "MoserVeselov4"])
def test_energy_has_no_trend_beyond_round_off(run, tolerance, name):
    found = run(name)
    assert found.energy < tolerance(float64=1e-12, float32=1e-4)
    assert found.energy_trend < tolerance(float64=2e-13, float32=1e-4)


def test_energy_of_the_splitting_of_order_two_oscillates_and_does_not_grow(run, tolerance):
    found = run("ThreeAxisSplitting")
    assert found.energy < tolerance(float64=1e-5, float32=5e-5)
    assert found.energy_growth < tolerance(float64=1.02, float32=2.0)


def test_a_method_that_keeps_nothing_is_found_out(run, dtype):
    if dtype == jnp.float32:
        pytest.skip("round-off of float32 is larger than what Runge and Kutta lose")
    found = run("RungeKutta4")
    assert found.energy_trend > 1e-9
    assert found.energy_growth > 1.5
    assert found.momentum > 1e-10


def test_full_inertia_keeps_them_as_well(tolerance):
    found = long_run(METHODS["ThreeAxisSplitting"](), STEPS, inertia=FULL)
    assert found.momentum < tolerance(float64=1e-13, float32=6e-5)
    assert found.energy_growth < tolerance(float64=1.02, float32=2.0)
