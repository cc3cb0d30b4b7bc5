"""What the methods of free flight keep over many steps: angular momentum to round-off, energy without a trend.

The same figures after 1e7 steps: `python -m jaxrb.bench.methods --steps 10000000`, and in docs/methods.md.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb import integrators
from jaxrb.bench.methods import long_run

STEPS = 100_000
EXACT = ["ThreeAxisSplitting4", "MoserVeselov", "MoserVeselov4", "MoserVeselov6"]


@pytest.mark.parametrize("rotation", [rb.Quaternion, rb.RotationMatrix], ids=lambda r: r.__name__)
@pytest.mark.parametrize("name", ["ThreeAxisSplitting", "ThreeAxisSplitting4", "MoserVeselov4"])
def test_angular_momentum_in_the_world_is_kept_to_round_off(tolerance, name, rotation):
    found = long_run(integrators.METHODS[name](), STEPS, rotation)
    assert found.momentum < tolerance(float64=1e-13, float32=6e-5)


@pytest.mark.parametrize("name", EXACT)
def test_energy_is_kept_to_round_off(tolerance, name):
    found = long_run(integrators.METHODS[name](), STEPS)
    assert found.energy < tolerance(float64=2e-13, float32=1e-4)


def test_energy_of_the_splitting_of_order_two_has_no_trend(dtype):
    found = long_run(integrators.ThreeAxisSplitting(), STEPS)
    assert found.energy < 2e-5
    # A straight line through an oscillation has a slope of its own, the less the longer the run.
    assert found.energy_trend < (0.1 if dtype == jnp.float64 else 0.3) * found.energy


def test_a_method_that_keeps_nothing_is_found_out(dtype):
    if dtype == jnp.float32:
        pytest.skip("round-off of float32 is larger than what Runge and Kutta lose")
    found = long_run(rb.RungeKutta4(), STEPS)
    assert found.energy_trend > 1e-9
    assert found.momentum > 1e-9


def test_full_inertia_keeps_them_as_well(tolerance):
    inertia = np.array([[1.0, 0.1, 0.05], [0.1, 2.0, 0.1], [0.05, 0.1, 2.5]])
    for name in ("ThreeAxisSplitting", "MoserVeselov4"):
        found = long_run(integrators.METHODS[name](), STEPS, inertia=inertia)
        assert found.momentum < tolerance(float64=1e-13, float32=6e-5)
        assert found.energy_trend < tolerance(float64=1e-6, float32=1e-4)
