"""B. Bad bodies: refused or warned of where they are made, with field, value and what to do.

The numbers in brackets are those of the project's list of bad inputs. What `valid_inertia` does is in
body/test_validity.py, one case a test; here each kind arrives by the door that users take.
"""

import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput, JaxrbWarning, WrongStructure

SKEW = np.diag([1.0, 1.0, 1.0]) + np.asarray([[0, 1e-2, 0], [0, 0, 0], [0, 0, 0]])
REFUSED = {
    "mass zero [21]": (lambda: rb.Body(0.0, 1.0), InvalidInput, r"Body\.mass is 0\.0 kg, but must be positive.*fixed"),
    "mass negative [22]": (lambda: rb.Body(-1.0, 1.0), InvalidInput, r"Body\.mass is -1\.0 kg, but must be positive"),
    "mass NaN [23]": (lambda: rb.Body(np.nan, 1.0), InvalidInput, r"Body\.mass is nan kg, but must be finite"),
    "mass infinite [23]": (lambda: rb.Body(np.inf, 1.0), InvalidInput, r"Body\.mass is inf kg, but must be finite"),
    "mass None [23]": (lambda: rb.Body(None, 1.0), InvalidInput, r"Body\.mass is None, but must be a number"),
    "mass a word [23]": (lambda: rb.Body("1", 1.0), InvalidInput, r"Body\.mass: '1' is not a real number"),
    "mass 1e-300 [24]": (lambda: rb.Body(1e-300, 1.0), InvalidInput, "1e-300 kg: products.*choose larger units"),
    "mass 1e300 [24]": (lambda: rb.Body(1e300, 1.0), InvalidInput, r"1e\+300 kg: products of such numbers"),
    "masses of fewer bodies": (
        lambda: rb.Body([1.0, 2.0], 1.0), WrongStructure, r"mass \(2,\), inertia \(\).*rb\.replicate"
    ),
    "inertia zero [25]": (lambda: rb.Body(1.0, 0.0), InvalidInput, r"Body\.inertia .*\[0\.0, 0\.0, 0\.0\].*positive"),
    "inertia NaN [25]": (
        lambda: rb.Body(1.0, np.full((3, 3), np.nan)), InvalidInput, r"Body\.inertia is .*nan.*must be finite"
    ),
    "moment negative [26]": (
        lambda: rb.Body(1.0, (1.0, 1.0, -1.0)), InvalidInput, r"principal moments.*-1\.0.*a moment is not positive"
    ),
    "inertia askew [27]": (
        lambda: rb.Body(1.0, SKEW), InvalidInput, "is not symmetric: the entries differ by 3.3e-03.*give"
    ),
    "triangle broken [28]": (
        lambda: rb.Body(1.0, (1.0, 1.0, 2.1)), InvalidInput, "exceeds the sum of the two others.*on_invalid='project'"
    ),
    "inertia of two numbers": (lambda: rb.Body(1.0, (1.0, 2.0)), WrongStructure, r"shape \(2,\); give a number"),
    "density zero [34]": (
        lambda: rb.Body.from_shape(rb.Sphere(0.1), 0.0), InvalidInput, r"density is 0\.0 kg/m³, but must be positive"
    ),
    "density negative [34]": (lambda: rb.Body.from_shape(rb.Sphere(0.1), -7.0), InvalidInput, r"density is -7\.0"),
    "density NaN [34]": (lambda: rb.Body.from_shape(rb.Sphere(0.1), np.nan), InvalidInput, "density is nan"),
    "density infinite [34]": (lambda: rb.Body.from_shape(rb.Sphere(0.1), np.inf), InvalidInput, "density is inf"),
    "density a word [34]": (
        lambda: rb.Body.from_shape(rb.Sphere(0.1), "iron"), WrongStructure, r"density: 'iron' is not a number"
    ),
    "shape a word": (lambda: rb.Body(1.0, 1.0, "ball"), WrongStructure, r"Body\.shape: 'ball' is no shape"),
    "shape a class": (
        lambda: rb.Body.from_shape(rb.Sphere, 1.0), WrongStructure, r"Sphere is a class; write Sphere\("
    ),
    "centre of mass NaN [30]": (
        lambda: rb.Body(1.0, 1.0, center_of_mass=(0, np.nan, 0)), InvalidInput, r"center_of_mass is nan m"
    ),
    "radius negative": (lambda: rb.Sphere(-1.0), InvalidInput, r"Sphere\.radius is -1\.0 m, but must be positive"),
    "half extents NaN": (lambda: rb.Box((1, np.nan, 1)), InvalidInput, r"Box\.half_extents is nan m"),
    "copies by the half": (lambda: rb.replicate(rb.Body(1.0, 1.0), 1.5), InvalidInput, "count is 1.5"),
    "copies None": (lambda: rb.replicate(rb.Body(1.0, 1.0), 0), InvalidInput, "count is 0, but must be .* at least 1"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_bad_body_is_refused(case):
    make, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        make()


DOUBTED = {
    "mass of 1e20 [24]": (lambda: rb.Body(1e20, 1.0), r"Body\.mass is 1e\+20 kg, outside 1e±15: is the unit right"),
    "nearly symmetric [27]": (
        lambda: rb.Body(1.0, np.eye(3) + 1e-8 * np.triu(np.ones((3, 3)), 1)), "its symmetric part is used"
    ),
    "triangle broken by 1e-6 [28]": (
        lambda: rb.Body(1.0, (1.0, 1.0, 2.0 + 2e-6)), "exceeds the sum.*the nearest possible is used"
    ),
    "centre of mass outside [30]": (
        lambda: rb.Body(1.0, 1.0, rb.Sphere(0.1), center_of_mass=(50.0, 0, 0)),
        r"center_of_mass lies 50 m from the origin of the Sphere, which reaches 0\.1 m.*in metres",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", DOUBTED)
def test_doubtful_body_is_warned_of(case):
    make, message = DOUBTED[case]
    with pytest.warns(JaxrbWarning, match=message):
        make()


def test_thin_plate_is_accepted():
    """[29] A + B = C exactly, also when rounded to single precision."""
    rb.Body(1.0, (1.0, 2.0, 3.0))
    rb.Body(1.0, np.asarray((0.1, 0.2, 0.3), np.float32))


def test_inertia_about_another_point_is_brought_to_the_centre_of_mass(tolerance):
    """[31] A hull far from its own origin, and the same moved there; a file's inertia about another frame."""
    corners = np.asarray([(x, y, z) for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.02, 0.02)])
    here = rb.Body.from_shape(rb.ConvexHull(corners), density=700.0)
    there = rb.Body.from_shape(rb.ConvexHull(corners + np.asarray((3.0, -2.0, 1.0))), density=700.0)
    near = tolerance(float64=1e-10, float32=2e-2)  # 3 m beside 0.1 m: 1e3 of the digits of d² are lost
    assert np.asarray(there.inertia.six()) == pytest.approx(np.asarray(here.inertia.six()), abs=near)
    assert np.asarray(there.center_of_mass) == pytest.approx((3.0, -2.0, 1.0), rel=1e-6)
    offset = np.asarray((3.0, -2.0, 1.0))
    about = np.asarray(here.inertia.about(offset, here.mass).as_matrix(), float)
    exact = np.asarray(here.inertia.as_matrix(), float) + float(here.mass) * (
        offset @ offset * np.eye(3) - np.outer(offset, offset)
    )
    assert about == pytest.approx(exact, rel=tolerance(float64=1e-14, float32=1e-6))


def test_numbers_that_the_type_of_the_state_cannot_hold_are_refused():
    """[14, 24] A scene of doubles with a state of singles: neither an infinite nor a vanished mass runs."""
    for body, message in (
        (
            lambda: rb.Body(1e39, 1.0),
            r"Scene\.bodies\[0\]\.mass is 1e\+39, too large for a state of float32",
        ),
        (lambda: rb.Body(1e-39, 1.0), r"Scene\.bodies\[0\]\.mass is 1e-39, too small"),
        (lambda: rb.Body(1.0, 1e-39), r"Scene\.bodies\[0\]\.inertia\.moment is 1e-39, too small"),
    ):
        with pytest.warns(JaxrbWarning, match="is the unit right"):
            scene = rb.Scene(body())
        with pytest.raises(InvalidInput, match=message):
            scene.state(dtype=np.float32)
    scene = rb.Scene(rb.Body(1.0, 1.0), rb.UniformGravity((0, 0, -1e39)))
    with pytest.raises(InvalidInput, match=r"effects\[0\]\.acceleration is -1e\+39, too large"):
        scene.state(dtype=np.float32)
