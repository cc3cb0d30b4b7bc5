"""Euler's equation made ready for a run: inverses, invariants, accelerations and implicit steps against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrb.body.euler_equation import solver
from jaxrb.body.inertia import FullInertia, PrincipalInertia
from jaxrb.math.vector import cross

COUNT = 20


def full(components):
    xx, yy, zz, xy, xz, yz = components
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.fixture(scope="module", params=["full", "principal"])
def bodies(request, dtype):
    """Inertias, their matrices (20, 3, 3), and spins, torques (20, 3); each full tensor has products of all signs."""
    random = np.random.default_rng(3)
    spins, torques = random.normal(size=(2, COUNT, 3)).astype(dtype)
    moments = random.uniform(1.0, 1.9, (COUNT, 3)).astype(dtype)
    if request.param == "principal":
        return (
            PrincipalInertia(jnp.asarray(moments)),
            np.einsum("ni,ij->nij", moments, np.eye(3)),
            spins,
            torques,
        )
    turns = np.linalg.qr(random.normal(size=(COUNT, 3, 3)))[0]
    matrices = np.einsum("nik,nk,njk->nij", turns, np.asarray(moments, float), turns)
    six = matrices[:, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)].astype(dtype)
    exact = np.array([full(np.asarray(row, float)) for row in six])
    return FullInertia(jnp.asarray(six)), exact, spins, torques


def test_inverse_its_invariants_and_the_response_are_those_of_the_matrix(bodies, tolerance):
    inertia, matrices, _, torques = bodies
    made = solver(inertia)
    inverses = np.linalg.inv(np.asarray(matrices, float))
    near = {"rtol": tolerance(float64=1e-13, float32=3e-5), "atol": tolerance(float64=1e-14, float32=3e-6)}
    np.testing.assert_allclose(made.inverted().as_matrix(), inverses, **near)
    np.testing.assert_allclose(made.response(torques), np.einsum("nij,nj->ni", inverses, torques), **near)
    trace, minors, determinant = made.inverse_invariants()
    # det(x − A) = x³ − e₁ x² + e₂ x − e₃.
    wanted = np.array([np.poly(matrix) for matrix in inverses])
    np.testing.assert_allclose(np.stack([-trace, minors, -determinant], axis=-1), wanted[:, 1:], **near)


def test_acceleration_and_its_second_derivative_are_those_of_the_matrix_form(bodies, tolerance):
    inertia, matrices, spins, torques = bodies
    made = solver(inertia)
    inverses = jnp.asarray(np.linalg.inv(np.asarray(matrices, float)).astype(spins.dtype))

    def plain(spin):
        momentum = jnp.einsum("nij,nj->ni", jnp.asarray(matrices, spin.dtype), spin)
        return jnp.einsum("nij,nj->ni", inverses, jnp.cross(momentum, spin) + torques)

    def second(function):
        """The curvature along a way of the spins' own: Euler's equation is quadratic in ω."""
        way = jnp.asarray(torques)
        along = lambda x: jax.jvp(function, (x,), (way,))[1]  # noqa: E731
        return jax.jvp(along, (jnp.asarray(spins),), (way,))

    near = {"rtol": tolerance(float64=1e-12, float32=1e-4), "atol": tolerance(float64=1e-13, float32=2e-5)}
    ours = lambda spin: made.acceleration(spin, jnp.asarray(torques))  # noqa: E731
    np.testing.assert_allclose(ours(jnp.asarray(spins)), plain(jnp.asarray(spins)), **near)
    for found, wanted in zip(second(ours), second(plain), strict=True):
        np.testing.assert_allclose(found, wanted, **near)


@pytest.mark.parametrize("driven", [True, False], ids=["driven", "free"])
def test_implicit_velocity_solves_its_equation_by_four_steps_of_newton(bodies, driven, tolerance):
    """Quadratic convergence: 0.2 rad a step from the spin itself; a fault in the Jacobian converges linearly."""
    inertia, matrices, spins, torques = bodies
    start, torque, span = jnp.asarray(spins), jnp.asarray(torques) if driven else None, 0.2
    made = solver(inertia)
    end = made.implicit_velocity(start, start, torque, span, 4)
    matrices = jnp.asarray(matrices, spins.dtype)
    momentum = jnp.einsum("nij,nj->ni", matrices, end)
    net = cross(momentum, end) if torque is None else cross(momentum, end) + torque
    residual = jnp.einsum("nij,nj->ni", matrices, end - start) - span * net
    assert float(jnp.abs(residual).max()) < tolerance(float64=1e-14, float32=4e-6)
