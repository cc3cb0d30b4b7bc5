"""The inertia tensor: its kinds, parallel axes, axes of rotation, principal axes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import largest, unit_vectors

from jaxrb import Body, FullInertia, Inertia, PrincipalInertia, Quaternion, SphericalInertia, principal_axes
from jaxrb.body.euler_equation import FullSolver, solver
from jaxrb.body.mass_properties import of_particles
from jaxrb.errors import WrongStructure


@pytest.fixture(scope="module")
def particles(dtype):
    """Masses (12,) and positions (12, 3) of an irregular body."""
    draw = np.random.default_rng(0)
    return draw.uniform(0.1, 2.0, 12).astype(dtype), draw.normal(size=(12, 3)).astype(dtype)


@pytest.fixture(scope="module")
def kinds(dtype):
    """One inertia of each kind, and its matrix in NumPy."""
    full = np.asarray([[3.0, 0.2, -0.3], [0.2, 2.5, 0.1], [-0.3, 0.1, 2.0]], dtype)
    moments = np.asarray([1.0, 2.0, 2.5], dtype)
    return [
        (SphericalInertia(np.asarray(2.0, dtype)), 2.0 * np.eye(3)),
        (PrincipalInertia(moments), np.diag(moments)),
        (FullInertia.from_matrix(full), full),
    ]


def particle_tensor(masses, positions) -> np.ndarray:
    """Σ m (d² 1 − d dᵀ) about the origin, in float64."""
    m, r = np.asarray(masses, np.float64), np.asarray(positions, np.float64)
    return np.einsum(
        "k,kij->ij", m, np.sum(r * r, -1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
    )


def test_kind_follows_from_the_shape_of_the_numbers():
    assert isinstance(Inertia.of(0.4), SphericalInertia)
    assert isinstance(Inertia.of([1, 1, 1]), PrincipalInertia)
    assert isinstance(Inertia.of(np.eye(3)), FullInertia)
    with pytest.raises(WrongStructure, match=r"\(2,\)"):
        Inertia.of([1.0, 2.0])


def test_every_kind_is_its_matrix(kinds, dtype, tolerance):
    small = tolerance(float64=2e-15, float32=1e-6)
    omega = unit_vectors(6).astype(dtype)
    for inertia, matrix in kinds:
        assert largest(inertia.as_matrix() - matrix) == 0
        assert largest(inertia.trace() - np.trace(matrix)) < small
        for w in omega:
            assert largest(inertia.apply(w) - matrix @ w) < small


def test_generalising_keeps_the_inertia_and_never_specialises(kinds):
    for inertia, matrix in kinds:
        for rank in range(3):
            general = inertia.generalised(rank)
            assert general.rank == max(rank, inertia.rank)
            assert largest(general.as_matrix() - matrix) == 0


def test_moment_about_an_axis_is_n_dot_in(kinds, dtype, tolerance):
    """I_n = n·In for n of any length, also of one whose square is no float32."""
    for inertia, matrix in kinds:
        for n in unit_vectors(5):
            for length in (1.0, 3.0, 1e-25):
                found = inertia.moment_about((length * n).astype(dtype))
                assert float(found) == pytest.approx(
                    n @ matrix @ n, rel=tolerance(float64=1e-14, float32=1e-6)
                )


def test_moment_about_an_axis_is_the_sum_of_squared_distances(particles, dtype, tolerance):
    """I_n = Σ m d², d from the axis through the centre of mass."""
    masses, positions = particles
    properties = of_particles(masses, positions)
    centred = positions - np.asarray(properties.center_of_mass)
    for n in unit_vectors(5):
        distances = np.linalg.norm(np.cross(centred, n), axis=-1)
        found = float(properties.inertia.moment_about(n.astype(dtype)))
        assert found == pytest.approx(
            np.sum(masses * distances**2), rel=tolerance(float64=1e-13, float32=1e-5)
        )


def test_steiner_gives_the_tensor_of_particles_about_any_point(particles, dtype, tolerance):
    masses, positions = particles
    properties = of_particles(masses, positions)
    for point in (np.zeros(3), np.asarray([1.0, -2.0, 0.5])):
        offset = (point - np.asarray(properties.center_of_mass)).astype(dtype)
        found = properties.inertia.about(offset, properties.mass)
        expected = particle_tensor(masses, positions - point)
        assert largest(found.as_matrix() - expected) < tolerance(float64=1e-13, float32=2e-4)


def test_inertia_far_from_the_origin_keeps_its_digits(particles, dtype, tolerance):
    """About the centre, not about the origin and back: 1 km away the difference would lose six digits."""
    masses, positions = particles
    exact = np.round(np.asarray(positions) * 1024) / 1024  # so that the shift itself is free of rounding
    near, far = of_particles(masses, exact.astype(dtype)), of_particles(masses, (exact + 1024).astype(dtype))
    error = largest(far.inertia.as_matrix() - near.inertia.as_matrix())
    assert error < tolerance(float64=1e-11, float32=5e-3) * float(near.inertia.trace())


def test_rotated_inertia_is_that_of_the_rotated_particles(particles, dtype, tolerance):
    masses, positions = particles
    r = Quaternion.exp(np.asarray([0.4, -0.7, 1.3], dtype))
    turned = of_particles(masses, np.asarray(r.rotate(positions)))
    found = of_particles(masses, positions).inertia.rotated(r)
    assert largest(found.as_matrix() - turned.inertia.as_matrix()) < tolerance(float64=1e-13, float32=5e-5)
    moved = of_particles(masses, positions).moved(np.asarray([1, 2, 3], dtype), r)
    assert largest(moved.center_of_mass - turned.center_of_mass - np.asarray([1, 2, 3])) < tolerance(
        float64=1e-14, float32=5e-6
    )


def test_principal_axes_diagonalise_and_form_a_rotation(particles, dtype, tolerance):
    small = tolerance(float64=1e-13, float32=1e-4)
    inertia = of_particles(*particles).inertia
    moments, axes = (np.asarray(x, np.float64) for x in principal_axes(inertia))
    assert (np.diff(moments) > 0).all()
    assert largest(axes.T @ np.asarray(inertia.as_matrix()) @ axes - np.diag(moments)) < small
    assert largest(axes.T @ axes - np.eye(3)) < small
    assert np.linalg.det(axes) == pytest.approx(1.0, abs=small)


def test_principal_moments_have_derivatives_where_they_differ(dtype, tolerance):
    """∂I₁/∂M = n nᵀ for the axis n of that moment."""
    matrix = np.asarray([[3.0, 0.2, -0.3], [0.2, 2.5, 0.1], [-0.3, 0.1, 2.0]], dtype)
    gradient = jax.grad(lambda m: principal_axes(FullInertia.from_matrix(m))[0][0])(jax.numpy.asarray(matrix))
    axis = np.linalg.eigh(matrix.astype(np.float64))[1][:, 0]
    assert largest(gradient - np.outer(axis, axis)) < tolerance(float64=1e-13, float32=1e-5)


def test_euler_equation_holds_for_every_kind(kinds, dtype, tolerance):
    """I ω̇ = τ − ω × Iω."""
    omega, torque = unit_vectors(2, seed=5).astype(dtype)
    for inertia, matrix in kinds:
        free, driven = (solver(inertia).acceleration(omega, t) for t in (None, torque))
        gyroscopic = np.cross(omega, matrix @ omega)
        small = tolerance(float64=1e-15, float32=1e-6)
        assert largest(matrix @ np.asarray(driven) - (torque - gyroscopic)) < 4 * small
        assert free is None or largest(matrix @ np.asarray(free) + gyroscopic) < 4 * small


def test_sphere_has_no_gyroscopic_term_by_type(dtype):
    assert solver(SphericalInertia(np.asarray(2.0, dtype))).acceleration(np.ones(3, dtype), None) is None


def test_implicit_velocity_solves_its_equation(kinds, dtype, tolerance):
    """ω = start + h ω̇(ω, τ) after a few Newton steps, for every kind."""
    start, torque = (2.0 * unit_vectors(2, seed=6)).astype(dtype)
    span = np.asarray(0.05, dtype)
    for inertia, _ in kinds:
        for given in (None, torque):
            made = solver(inertia)
            omega = made.implicit_velocity(start, start, given, span, 4)
            rate = made.acceleration(omega, given)
            residual = omega - start - span * (0.0 if rate is None else rate)
            assert largest(residual) < tolerance(float64=2e-15, float32=1e-6)


def test_body_of_particles_takes_its_centre_and_tensor(particles, tolerance):
    masses, positions = particles
    body = Body.from_particles(masses, positions)
    centre = np.average(positions, axis=0, weights=masses)
    assert float(body.mass) == pytest.approx(masses.sum(), rel=1e-6)
    assert largest(body.center_of_mass - centre) < tolerance(float64=1e-15, float32=1e-6)
    expected = particle_tensor(masses, positions - centre)
    assert largest(body.inertia.as_matrix() - expected) < tolerance(float64=1e-13, float32=5e-5)


@pytest.mark.parametrize("applied", [False, True])
def test_a_midpoint_step_does_not_depend_on_the_unit_of_mass(applied, dtype):
    """Moments times a power of two, and the torque too: the same bits, also where a product of three moments is zero in
    this precision."""
    moments = jnp.asarray((1.0, 1.5, 1.8, 0.2, 0.1, -0.1), dtype)
    torque = jnp.asarray((0.1, -0.3, 0.2), dtype) if applied else None
    omega, span = jnp.asarray((0.3, 1.0, 0.2), dtype), jnp.asarray(0.05, dtype)

    def later(power):
        unit = jnp.ldexp(jnp.ones((), dtype), power)
        # The linearised equations alone: inverses have an underflow of their own, beyond 1e-36 kg m².
        ready = FullSolver(FullInertia(unit * moments), jnp.zeros(6, dtype))
        return ready.implicit_velocity(omega, omega, None if torque is None else unit * torque, span, 5)

    found = np.asarray(jax.jit(jax.vmap(later))(jnp.asarray((0, -20, -43, -60, -100, 50))))
    assert (found == found[0]).all()
    assert np.abs(found[0] - omega).max() > 1e-3
