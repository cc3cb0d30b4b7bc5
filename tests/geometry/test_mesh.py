"""Triangle meshes: their mass against closed forms, and each doubtful surface mended aloud or refused by name."""

import jax
import jax.numpy as jnp
import mesh_samples as samples
import numpy as np
import pytest
from rotation_samples import largest, unit_vectors

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbWarning, WrongStructure
from jaxrb.geometry.mesh import TriangleMesh

RHO = 700.0


def host_rotation(seed):
    """A rotation matrix in float64, whatever the precision of the run."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def tensor(six):
    xx, yy, zz, xy, xz, yz = np.asarray(six, np.float64)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def relative_errors(properties, mass, center, inertia):
    """Of mass, centre (by the size of the solid) and inertia (by its trace)."""
    size = np.cbrt(mass / RHO)
    return (
        abs(float(properties.mass) / mass - 1),
        largest(np.asarray(properties.center_of_mass) - center) / size,
        largest(tensor(properties.inertia.components) - inertia) / np.trace(inertia),
    )


def box_inertia(mass, half):
    a, b, c = np.square(half)
    return mass / 3 * np.diag([b + c, a + c, a + b])


@pytest.mark.parametrize("seed", range(20))
def test_turned_box_of_any_density_has_the_closed_form(seed):
    """Also in float32 runs: numbers that are there are summed on the host in float64."""
    random = np.random.default_rng(seed)
    half, density, turn = random.uniform(0.1, 1.0, 3), random.uniform(1.0, 1e4), host_rotation(seed)
    center = random.normal(size=3)
    vertices, triangles = samples.box(half)
    found = TriangleMesh(vertices @ turn.T + center, triangles).mass_properties(density)
    mass = density * 8 * half.prod()
    errors = relative_errors(found, mass, center, turn @ box_inertia(mass, half) @ turn.T)
    assert max(errors) < 1e-12 * max(1, np.abs(center).max() / half.min()), errors


def test_tetrahedron_has_the_closed_form():
    """The corner of the unit cube: V = 1/6, centre 1/4, I_xx about the centre = ρ/80, I_xy = ρ/480 (by hand)."""
    found = TriangleMesh(*samples.tetrahedron()).mass_properties(RHO)
    inertia = RHO * (np.eye(3) / 80 + (1 - np.eye(3)) / 480)
    assert max(relative_errors(found, RHO / 6, 0.25, inertia)) < 1e-12


def test_pyramid_whose_corners_are_not_about_its_centre_has_the_closed_form():
    """Edge a, height h: V = a²h/3, centre h/4 above the base, I_zz = m a²/10, I_xx = m (a²/20 + 3h²/80)."""
    half, height, place = 0.4, 1.5, np.array([0.3, -0.2, 2.0])
    corners = np.array(
        [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0), (0, 0, height)]
    )
    triangles = [(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    found = TriangleMesh(corners + place, triangles).mass_properties(RHO)
    mass = RHO * (2 * half) ** 2 * height / 3
    across = (2 * half) ** 2 / 20 + 3 * height**2 / 80
    inertia = mass * np.diag([across, across, (2 * half) ** 2 / 10])
    assert max(relative_errors(found, mass, place + np.array([0, 0, height / 4]), inertia)) < 1e-12


def test_box_a_million_metres_away_keeps_nine_digits():
    half, offset = (0.5, 0.3, 0.2), np.array([1e6, -1e6, 1e6])
    found = TriangleMesh(samples.box(half)[0] + offset, samples.BOX_TRIANGLES).mass_properties(RHO)
    mass = RHO * 8 * np.prod(half)
    errors = relative_errors(found, mass, offset, box_inertia(mass, half))
    assert max(errors) < 1e-9, errors


def test_fine_sphere_and_torus_approach_the_closed_forms_quadratically():
    for make, volume in (
        (lambda k: samples.sphere(k + 1, 0.7), 4 / 3 * np.pi * 0.7**3),
        (lambda k: samples.torus(1.0, 0.4, 12 * 2**k, 12 * 2**k), 2 * np.pi**2 * 0.4**2),
    ):
        coarse, fine = (1 - float(TriangleMesh(*make(k)).mass_properties(1.0).mass) / volume for k in (1, 2))
        assert 0 < fine < coarse
        assert coarse / fine == pytest.approx(4, rel=0.05)


def test_hollow_box_is_the_outer_less_the_inner():
    outer, (inner, triangles) = samples.box((0.5, 0.5, 0.5)), samples.box((0.3, 0.2, 0.1))
    mesh = TriangleMesh(*samples.joined(outer, (inner, triangles[:, ::-1])))
    masses = RHO * np.array([1.0, 8 * 0.3 * 0.2 * 0.1])
    inertia = box_inertia(masses[0], (0.5, 0.5, 0.5)) - box_inertia(masses[1], (0.3, 0.2, 0.1))
    assert max(relative_errors(mesh.mass_properties(RHO), masses[0] - masses[1], 0.0, inertia)) < 1e-12


def test_mass_and_inertia_have_derivatives_in_the_vertices(dtype, tolerance):
    """Euler's theorem: Σ x·∂m/∂x = 3m and Σ x·∂I/∂x = 5I; moving everything changes neither."""
    mesh = TriangleMesh(*samples.torus(around=8, across=6))
    vertices = jnp.asarray(mesh.vertices, dtype)

    def numbers(mesh):
        found = mesh.mass_properties(RHO)
        return jnp.append(found.inertia.components[:3], found.mass)

    jacobian = jax.jit(jax.jacrev(numbers))(TriangleMesh(vertices, mesh.triangles)).vertices
    value = np.asarray(numbers(mesh), np.float64)
    rel = tolerance(float64=1e-12, float32=2e-5)
    assert np.einsum("kni,ni->k", jacobian, vertices) == pytest.approx(value * [5, 5, 5, 3], rel=rel)
    assert largest(np.asarray(jacobian).sum(1)) < rel * value.max()


def test_body_of_a_mesh_is_the_body_of_the_box(tolerance):
    half = (0.1, 0.05, 0.02)
    mesh = TriangleMesh(*samples.box(half), name="brick")
    body, box = rb.Body.from_mesh(mesh, density=RHO), rb.Body.from_shape(rb.Box(half), density=RHO)
    rel = tolerance(float64=1e-13, float32=1e-6)
    assert body.name == "brick"
    assert float(body.mass) == pytest.approx(float(box.mass), rel=rel)
    assert largest(body.inertia.as_matrix() - np.asarray(box.inertia.as_matrix())) < rel * float(
        box.inertia.trace()
    )


def test_convex_hull_of_a_mesh_fills_its_hollows():
    torus = TriangleMesh(*samples.torus(around=32, across=16))
    hull = rb.Body.from_mesh(torus, density=RHO, convex_hull=True)
    corners = np.asarray(torus.vertices)
    heights = corners @ unit_vectors(20).T
    found = np.asarray(hull.shape.vertices) @ unit_vectors(20).T
    assert np.allclose(heights.max(0), found.max(0), rtol=0, atol=1e-12)
    # Pappus: a disc with half a ring about it against the ring.
    ratio = (0.8 * np.pi + 0.16 * np.pi**2 * (1 + 1.6 / (3 * np.pi))) / (2 * np.pi**2 * 0.16)
    mass = float(rb.Body.from_mesh(torus, density=RHO).mass)
    assert float(hull.mass) / mass == pytest.approx(ratio, rel=0.02)


def test_open_surface_has_a_hull_but_no_mass():
    vertices, triangles = samples.box()
    mesh = TriangleMesh(vertices, triangles[1:], name="lidless")
    assert not mesh.is_closed
    with pytest.raises(
        InvalidInput, match=r"'lidless'.*3 edges.*open.*between vertices \[0, 1\].*convex_hull=True"
    ):
        mesh.mass_properties(RHO)
    assert float(rb.Body.from_mesh(mesh, RHO, convex_hull=True).mass) == pytest.approx(RHO, rel=1e-6)


def test_edge_of_four_triangles_has_no_mass():
    """Two cubes that share an edge, as one surface."""
    one, other = samples.box((0.5, 0.5, 0.5)), samples.box((0.5, 0.5, 0.5), (1.0, 1.0, 0.0))
    vertices, triangles = samples.joined(one, other)
    _, first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    mesh = TriangleMesh(vertices[np.sort(first)], np.argsort(np.argsort(first))[same][triangles])
    with pytest.raises(InvalidInput, match="1 edges belong to three or more"):
        mesh.mass_properties(RHO)


def test_one_sided_surface_has_no_mass():
    """The projective plane of six vertices (half an icosahedron): closed, no rims, but no inside."""
    triangles = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 1], [1, 2, 4], [2, 3, 5], [3, 4, 1], [4, 5, 2],
                 [5, 1, 3]]  # fmt: skip
    mesh = TriangleMesh(np.random.default_rng(0).normal(size=(6, 3)), triangles)
    with pytest.raises(InvalidInput, match="one-sided"):
        mesh.mass_properties(RHO)


def test_surface_turned_inside_out_is_turned_back_aloud():
    vertices, triangles = samples.box()
    with pytest.warns(JaxrbWarning, match="inside out.*12 triangles"):
        mesh = TriangleMesh(vertices, triangles[:, ::-1])
    assert float(mesh.mass_properties(RHO).mass) == pytest.approx(RHO)


def test_one_of_two_pieces_inside_out_is_turned_back():
    small, (vertices, triangles) = samples.box((0.1, 0.1, 0.1)), samples.box((0.5, 0.5, 0.5), (3.0, 0.0, 0.0))
    with pytest.warns(JaxrbWarning, match="volume of 1 closed"):
        mesh = TriangleMesh(*samples.joined(small, (vertices, triangles[:, ::-1])))
    assert float(mesh.mass_properties(RHO).mass) == pytest.approx(RHO * 1.008)


def test_mixed_winding_is_made_one_aloud():
    vertices, triangles = samples.torus()
    turned = np.random.default_rng(0).permutation(len(triangles))[:100]
    mixed = triangles.copy()
    mixed[turned] = mixed[turned][:, ::-1]
    with pytest.warns(JaxrbWarning, match="100 triangles are turned over"):
        mesh = TriangleMesh(vertices, mixed)
    expected = float(TriangleMesh(vertices, triangles).mass_properties(RHO).mass)
    assert float(mesh.mass_properties(RHO).mass) == pytest.approx(expected, rel=1e-13)


def test_doubled_surface_is_counted_once_aloud():
    vertices, triangles = samples.box()
    with pytest.warns(JaxrbWarning, match="12 triangles are there twice"):
        mesh = TriangleMesh(vertices, np.concatenate([triangles, np.roll(triangles, 1, axis=1)]))
    assert float(mesh.mass_properties(RHO).mass) == pytest.approx(RHO)


def test_shell_inside_a_shell_is_doubted():
    with pytest.warns(JaxrbWarning, match="1 closed pieces lie inside another.*twice"):
        TriangleMesh(*samples.joined(samples.box(), samples.box((0.4, 0.4, 0.4))))


def test_triangles_without_area_are_dropped_aloud():
    vertices, triangles = samples.box()
    with pytest.warns(JaxrbWarning, match="1 triangles without area, first triangle 12"):
        mesh = TriangleMesh(vertices, np.concatenate([triangles, [[0, 0, 1]]]))
    assert len(mesh.triangles) == 12
    # Corners on a line, one of them in the middle of an edge: without this triangle the surface would be open.
    split = np.concatenate([vertices, [vertices[[0, 1]].mean(0)]])
    with pytest.warns(JaxrbWarning, match="are kept"):
        mesh = TriangleMesh(split, [*triangles[:4], [0, 8, 5], [8, 1, 5], *triangles[5:], [0, 1, 8]])
    assert float(mesh.mass_properties(RHO).mass) == pytest.approx(RHO)


def test_vertices_of_no_triangle_are_dropped_aloud():
    vertices, triangles = samples.box()
    with pytest.warns(JaxrbWarning, match="2 vertices belong to no triangle, first vertex 0"):
        mesh = TriangleMesh(np.concatenate([[[9, 9, 9]], vertices, [[7, 7, 7]]]), triangles + 1)
    assert np.array_equal(mesh.vertices, vertices)


@pytest.mark.parametrize(
    ("vertices", "place"),
    [
        (np.zeros((4, 3)), "in one point"),
        (np.arange(4)[:, None] * np.array([1.0, 2.0, 3.0]), "on one line"),
        (np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1.0]]), "in one plane.*thickness"),
    ],
)
def test_a_point_a_line_and_a_plane_enclose_nothing(vertices, place):
    with pytest.raises(InvalidInput, match=f"all 4 vertices lie {place}"):
        TriangleMesh(vertices, samples.tetrahedron()[1])


def test_folded_plate_encloses_nothing():
    """Front and back of an L-shaped sheet."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 1], [1, 1, 1.0]])
    front = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    sheet = TriangleMesh(np.concatenate([vertices, vertices]), np.concatenate([front, front[:, ::-1] + 6]))
    with pytest.raises(InvalidInput, match="open"):
        sheet.mass_properties(RHO)
    rim = [[0, 6, 1], [1, 6, 7], [1, 7, 4], [4, 7, 10], [4, 10, 5], [5, 10, 11], [5, 11, 2], [2, 11, 8], [2, 8, 3],
           [3, 8, 9], [3, 9, 0], [0, 9, 6]]  # fmt: skip
    with pytest.warns(JaxrbWarning, match="are kept"):
        closed = TriangleMesh(np.concatenate([vertices, vertices]), [*front, *(front[:, ::-1] + 6), *rim])
    with pytest.raises(InvalidInput, match=r"enclose .* m³"):
        closed.mass_properties(RHO)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_vertices_that_are_no_numbers_are_refused(value):
    vertices, triangles = samples.box()
    vertices[5, 1] = value
    with pytest.raises(InvalidInput, match=f"vertex 5 has y = {value}"):
        TriangleMesh(vertices, triangles)


def test_numbers_of_vertices_that_are_not_there_are_refused():
    vertices, triangles = samples.box()
    for number in (8, -1):
        wrong = triangles.copy()
        wrong[3, 2] = number
        with pytest.raises(InvalidInput, match=f"triangle 3 names vertex {number}, but there are 8"):
            TriangleMesh(vertices, wrong)


def test_wrong_shapes_and_types_are_refused():
    vertices, triangles = samples.box()
    with pytest.raises(WrongStructure, match=r"\(8, 2\); give \(n, 3\)"):
        TriangleMesh(vertices[:, :2], triangles)
    with pytest.raises(WrongStructure, match=r"float64; give whole numbers \(m, 3\)"):
        TriangleMesh(vertices, triangles * 1.0)
    with pytest.raises(InvalidInput, match="no triangles"):
        TriangleMesh(vertices, np.empty((0, 3), int))
    with pytest.raises(WrongStructure, match="convex_hull"):
        TriangleMesh(vertices, triangles).support(np.ones(3))


@pytest.mark.parametrize("scale", [1e20, 1e-12])
def test_unlikely_sizes_ask_for_the_unit(scale):
    vertices, triangles = samples.box()
    with pytest.warns(JaxrbWarning, match=r"another unit \(unit='mm'\)"):
        TriangleMesh(scale * vertices, triangles)


def test_sizes_beyond_the_floating_range_are_refused():
    vertices, triangles = samples.box()
    for scale, message in ((1e40, "larger units"), (1e-40, "smaller units")):
        with pytest.raises(InvalidInput, match=message):
            TriangleMesh(scale * vertices, triangles)


def test_corners_equal_to_the_last_digit_are_one_vertex():
    vertices, triangles = samples.torus()
    mesh = TriangleMesh.from_corners(vertices[triangles])
    assert mesh.is_closed
    assert len(mesh.vertices) == len(vertices)
    assert np.array_equal(mesh.corners(), vertices[triangles])
