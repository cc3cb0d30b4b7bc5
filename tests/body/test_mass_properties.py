"""Closed forms of solids against sums over many small cubes, against each other, and cut in parts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import largest

import jaxrb as rb
from jaxrb.errors import InvalidInput, WrongStructure

RHO = 700.0


def tensor(properties) -> np.ndarray:
    return np.asarray(properties.inertia.as_matrix(), np.float64)


def same(one, other, small):
    """Equal mass, centre and inertia, relative to their size."""
    size = np.cbrt(float(one.mass))
    assert float(one.mass) == pytest.approx(float(other.mass), rel=small)
    assert largest(one.center_of_mass - np.asarray(other.center_of_mass)) < small * size
    assert largest(tensor(one) - tensor(other)) < small * np.trace(tensor(one))


@pytest.fixture(scope="module")
def small(tolerance):
    return tolerance(float64=1e-13, float32=3e-6)


SOLIDS = {
    "sphere": (rb.Sphere(0.8), lambda x, y, z: x**2 + y**2 + z**2 <= 0.64),
    "ellipsoid": (
        rb.Ellipsoid((0.9, 0.5, 0.7)),
        lambda x, y, z: (x / 0.9) ** 2 + (y / 0.5) ** 2 + (z / 0.7) ** 2 <= 1,
    ),
    "box": (rb.Box((0.9, 0.5, 0.3)), lambda x, y, z: (abs(x) <= 0.9) & (abs(y) <= 0.5) & (abs(z) <= 0.3)),
    "cylinder": (rb.Cylinder(0.6, 0.8), lambda x, y, z: (x**2 + y**2 <= 0.36) & (abs(z) <= 0.8)),
    "capsule": (rb.Capsule(0.4, 0.5), lambda x, y, z: x**2 + y**2 + np.maximum(abs(z) - 0.5, 0) ** 2 <= 0.16),
    "cone": (
        rb.Cone(0.8, 0.9),
        lambda x, y, z: (z >= 0) & (x**2 + y**2 <= (0.8 * (1 - z / 0.9)) ** 2) & (z <= 0.9),
    ),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_closed_form_equals_the_sum_over_small_cubes(name):
    """The integral over the volume, by brute force: 120³ cubes in NumPy."""
    shape, inside = SOLIDS[name]
    n = 120
    line = (np.arange(n) + 0.5) / n * 2 - 1
    x, y, z = np.meshgrid(line, line, line, indexing="ij", sparse=False)
    chosen = inside(x, y, z)
    points = np.stack([x[chosen], y[chosen], z[chosen]], -1)
    cube = RHO * (2 / n) ** 3
    mass, centre = cube * len(points), points.mean(0)
    r = points - centre
    moments = np.sum(r * r) * np.eye(3) - r.T @ r
    found = shape.mass_properties(RHO)
    assert float(found.mass) == pytest.approx(mass, rel=3e-3)
    assert largest(found.center_of_mass - centre) < 1e-3
    assert largest(tensor(found) - cube * moments) < 3e-3 * np.trace(tensor(found))


def test_box_has_a_twelfth_of_the_squared_edges(small):
    """The lecture: M/12 · diag(b² + c², a² + c², a² + b²) with whole edges."""
    a, b, c = 0.2, 0.1, 0.04
    body = rb.Body.from_shape(rb.Box((a / 2, b / 2, c / 2)), density=RHO)
    mass = RHO * a * b * c
    assert float(body.mass) == pytest.approx(mass, rel=small)
    expected = mass / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert largest(tensor(body) - expected) < small * np.trace(expected)


def test_ellipsoid_with_equal_radii_is_the_sphere(small):
    same(rb.Ellipsoid((0.3, 0.3, 0.3)).mass_properties(RHO), rb.Sphere(0.3).mass_properties(RHO), small)


def test_capsule_without_a_tube_is_the_sphere_and_without_caps_the_cylinder(small):
    same(rb.Capsule(0.3, 0.0).mass_properties(RHO), rb.Sphere(0.3).mass_properties(RHO), small)
    thin = 1e-4
    long, bare = rb.Capsule(thin, 1.0).mass_properties(RHO), rb.Cylinder(thin, 1.0).mass_properties(RHO)
    assert float(long.mass) / float(bare.mass) == pytest.approx(1 + 2 / 3 * thin, rel=1e-6)


def test_thin_cylinder_is_the_rod_and_flat_one_the_disc(small):
    rod, disc = rb.Cylinder(1e-6, 0.5).mass_properties(RHO), rb.Cylinder(0.5, 1e-6).mass_properties(RHO)
    assert tensor(rod)[0, 0] == pytest.approx(float(rod.mass) * 1.0**2 / 12, rel=1e-6)
    assert tensor(disc)[2, 2] == pytest.approx(float(disc.mass) * 0.5**2 / 2, rel=1e-6)
    assert tensor(disc)[0, 0] == pytest.approx(0.5 * tensor(disc)[2, 2], rel=1e-6)


def placed(x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0)):
    return rb.Pose(jnp.asarray([x, y, z]), rb.Quaternion.exp(jnp.asarray(turn)))


def test_box_cut_in_two_parts_is_the_box(small):
    """Also with the parts of unequal size, and one of them turned to where it belongs."""
    whole = rb.Box((0.6, 0.2, 0.1)).mass_properties(RHO)
    left = (rb.Box((0.2, 0.2, 0.1)), placed(x=-0.4))
    right = (rb.Box((0.4, 0.2, 0.1)), placed(x=0.2))
    turned = (rb.Box((0.2, 0.4, 0.1)), placed(x=0.2, turn=(0, 0, np.pi / 2)))
    same(rb.Composite([left, right]).mass_properties(RHO), whole, 3 * small)
    same(rb.Composite([left, turned]).mass_properties(RHO), whole, 3 * small)


def test_capsule_is_its_tube_and_two_half_spheres(small):
    """A sphere about each end of the tube, less one whole sphere in two halves: checked by the sphere's own halves."""
    r, h = 0.3, 0.5
    capsule = rb.Capsule(r, h).mass_properties(RHO)
    tube = rb.Cylinder(r, h).mass_properties(RHO)
    half, offset = 0.5 * float(rb.Sphere(r).mass_properties(RHO).mass), h + 3 / 8 * r
    across = float(tube.mass) * (r * r / 4 + h * h / 3)
    across += 2 * half * (0.4 * r * r - (3 / 8 * r) ** 2 + offset**2)
    along = 0.5 * float(tube.mass) * r * r + 2 * half * 0.4 * r * r
    assert largest(tensor(capsule) - np.diag([across, across, along])) < small * across


def test_cone_is_the_difference_of_two_cones_plus_a_frustum(small):
    """A cone cut at half its height leaves the same cone at half scale: mass 1/8, inertia 1/32."""
    whole, tip = rb.Cone(0.4, 0.6).mass_properties(RHO), rb.Cone(0.2, 0.3).mass_properties(RHO)
    assert float(whole.mass) == pytest.approx(8 * float(tip.mass), rel=small)
    assert largest(tensor(whole) - 32 * tensor(tip)) < small * np.trace(tensor(whole))
    assert largest(whole.center_of_mass - np.asarray([0, 0, 0.15])) < small


def test_relative_densities_weigh_the_parts(small):
    """A heavy and a light cube: the centre moves to the heavy one."""
    cube = rb.Box((0.1, 0.1, 0.1))
    pair = rb.Composite([(cube, placed(x=-1.0)), (cube, placed(x=1.0))], relative_densities=[3.0, 1.0])
    found = pair.mass_properties(RHO)
    one = cube.mass_properties(RHO)
    assert float(found.mass) == pytest.approx(4 * float(one.mass), rel=small)
    assert largest(found.center_of_mass - np.asarray([-0.5, 0, 0])) < small
    reduced = 0.75 * float(one.mass)
    assert tensor(found)[1, 1] == pytest.approx(4 * tensor(one)[1, 1] + reduced * 4.0, rel=10 * small)


def test_composite_body_runs_about_its_centre_of_mass(small):
    hammer = rb.Composite([(rb.Cylinder(0.02, 0.3), placed()), (rb.Box((0.1, 0.05, 0.05)), placed(z=0.3))])
    body = rb.Body.from_shape(hammer, density=RHO, name="hammer")
    assert 0.0 < float(body.center_of_mass[2]) < 0.3
    assert isinstance(body.inertia, rb.FullInertia)
    assert body.name == "hammer"


def test_empty_composites_and_degenerate_particles_are_refused():
    with pytest.raises(WrongStructure, match="at least one"):
        rb.Composite([])
    with pytest.raises(WrongStructure, match=r"\(2,\) and positions \(3, 3\)"):
        rb.Body.from_particles([1.0, 1.0], np.eye(3))
    with pytest.raises(InvalidInput, match="inertia"):
        rb.Body.from_particles([1.0, 1.0], [[0, 0, 0], [1, 0, 0]])  # on a line: no moment about it


@pytest.mark.parametrize(
    "shape", [rb.Box((0.1, 0.05, 0.02)), rb.Capsule(0.1, 0.2), rb.Cone(0.1, 0.3), rb.Sphere(0.2)]
)
def test_mass_and_inertia_scale_with_density_and_size(shape, dtype, tolerance):
    """∂m/∂ρ = m/ρ and ∂I/∂ρ = I/ρ; with all lengths scaled by s, m ~ s³ and I ~ s⁵ (Euler's theorem)."""
    leaves, tree = jax.tree.flatten(shape)

    def numbers(density, scale):
        scaled = jax.tree.unflatten(tree, [scale * jnp.asarray(leaf, dtype) for leaf in leaves])
        body = rb.Body.from_shape(scaled, density=density)
        return jnp.append(body.inertia.trace(), body.mass)

    at = jnp.asarray(RHO, dtype), jnp.ones((), dtype)
    trace, mass = numbers(*at)
    by_density, by_scale = jax.jacrev(numbers, argnums=(0, 1))(*at)
    rel = tolerance(float64=1e-13, float32=3e-6)
    assert np.asarray(by_density) == pytest.approx(np.asarray([trace, mass]) / RHO, rel=rel)
    assert np.asarray(by_scale) == pytest.approx(np.asarray([5 * trace, 3 * mass]), rel=rel)
