"""Carlson's integrals and Jacobi's functions against SciPy's, where no body's motion chooses the arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrb.math.elliptic import carlson, landen, sine_cosine

special = pytest.importorskip("scipy.special")


def test_carlson_s_integrals_are_scipy_s_however_unequal_the_arguments(dtype, tolerance):
    """Close to the separatrix two are nearly 0, and the series after the duplications has something to add.

    Not beyond 1e-200: SciPy's own R_J errs by a thousandth there, ours by 7e-16 (30 digits of mpmath).
    """
    random = np.random.default_rng(0)
    decades = tolerance(float64=150.0, float32=30.0)
    x, y = 10 ** random.uniform(-decades, 0.0, (2, 400))
    x[:20] = 0.0
    z = random.uniform(0.6, 1.0, 400)
    p = random.uniform(1.0, 1.2, 400)
    x, y, z, p = (np.asarray(v, dtype) for v in (x, y, z, p))
    first, third = jax.jit(carlson)(x, y, z, p)
    exact = [np.asarray(v, float) for v in (x, y, z, p)]
    near = tolerance(float64=2e-15, float32=2e-6)
    np.testing.assert_allclose(first, special.elliprf(*exact[:3]), rtol=near)
    np.testing.assert_allclose(third, special.elliprj(*exact), rtol=2 * near)


def test_jacobi_s_functions_are_scipy_s(dtype, tolerance):
    random = np.random.default_rng(1)
    complement = np.asarray(10 ** random.uniform(-12.0, 0.0, 400), dtype)
    phase = np.asarray(random.uniform(-0.5 * np.pi, 0.5 * np.pi, 400), dtype)
    chain = landen(jnp.asarray(complement))
    sine, cosine = sine_cosine(chain, jnp.asarray(phase))
    np.testing.assert_allclose(
        chain.quarter,
        special.ellipkm1(np.asarray(complement, float)),
        rtol=tolerance(float64=2e-15, float32=1e-6),
    )
    # SciPy's take m itself, which has lost 1 − m near 1: only what is far from there can be compared.
    far = complement > 1e-3
    m = 1.0 - np.asarray(complement, float)
    time = np.asarray(phase, float) / np.asarray(chain.mean, float)
    sn, cn, _, _ = special.ellipj(time, m)
    near = tolerance(float64=1e-12, float32=3e-6)
    np.testing.assert_allclose(np.asarray(sine)[far], sn[far], atol=near)
    np.testing.assert_allclose(np.asarray(cosine)[far], cn[far], atol=near)
