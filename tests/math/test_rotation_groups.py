"""Each axiom of the rotation group, for every representation, also at zero, near zero, near and at half a turn."""

import jax
import numpy as np
import pytest
from rotation_samples import REPRESENTATIONS, identity, largest, numbers, of_vectors, rotation_vectors
from scipy.spatial.transform import Rotation as Scipy

from jaxrb import EulerAngles, Quaternion, RotationMatrix


@pytest.fixture(scope="module", params=REPRESENTATIONS)
def group(request, dtype):
    """Everything the axioms speak of, computed in one compiled program for each representation."""
    kind, sequence = REPRESENTATIONS[request.param]
    vectors = rotation_vectors(dtype)
    points = np.random.default_rng(5).normal(size=vectors.shape).astype(vectors.dtype)

    product, inverse = jax.jit(lambda a, b: a @ b), jax.jit(lambda a: a.inverse())
    matrix, log, exp = jax.jit(lambda a: a.as_matrix()), jax.jit(lambda a: a.log()), jax.jit(kind.exp)
    rotate, unrotate = jax.jit(lambda a, v: a.rotate(v)), jax.jit(lambda a, v: a.unrotate(v))
    a = jax.jit(lambda v: of_vectors(kind, sequence, v))(vectors)
    b, c = (jax.tree.map(lambda x, by=by: np.roll(x, by, axis=0), a) for by in (7, 23))
    one = jax.tree.map(
        lambda x: np.broadcast_to(x, (len(vectors), *x.shape)), identity(kind, sequence, dtype)
    )
    ab, opposite = product(a, b), inverse(a)
    found = {
        "a": a, "b": b, "ab": ab, "ab.c": product(ab, c), "a.bc": product(a, product(b, c)), "one": one,
        "a1": product(a, one), "1a": product(one, a), "a a⁻¹": product(a, opposite), "a⁻¹ a": product(opposite, a),
        "exp log a": exp(log(a)),
    }  # fmt: skip
    matrices = {name: np.asarray(matrix(rotation), np.float64) for name, rotation in found.items()}
    other = {
        "rotated": rotate(a, points),
        "back": unrotate(a, rotate(a, points)),
        "unrotated": unrotate(a, points),
        "log": log(a),
        "ab on points": rotate(ab, points),
        "a on b on points": rotate(a, rotate(b, points)),
        "wxyz": a.as_quaternion_array(),
        "types": [ab, found["a a⁻¹"]],
    }
    return {"kind": kind, "sequence": sequence, "vectors": vectors, "points": points, **other}, matrices


@pytest.fixture(scope="module")
def small(tolerance):
    """Round-off of a few products of rotations."""
    return tolerance(float64=4e-15, float32=2e-6)


def test_product_is_closed(group, small):
    facts, matrices = group
    ab = np.asarray(matrices["ab"], np.float64)
    assert largest(np.swapaxes(ab, -1, -2) @ ab - np.eye(3)) < small
    assert largest(np.linalg.det(ab) - 1.0) < small
    assert all(isinstance(rotation, facts["kind"]) for rotation in facts["types"])
    assert all(getattr(r, "sequence", "") == facts["sequence"] for r in facts["types"])


def test_product_is_associative(group, small):
    _, matrices = group
    assert largest(matrices["ab.c"] - matrices["a.bc"]) < small


def test_identity_is_neutral_on_both_sides(group, small):
    _, matrices = group
    assert largest(matrices["one"] - np.eye(3)) == 0
    assert largest(matrices["a1"] - matrices["a"]) < small
    assert largest(matrices["1a"] - matrices["a"]) < small


def test_inverse_undoes_on_both_sides(group, small):
    _, matrices = group
    assert largest(matrices["a a⁻¹"] - np.eye(3)) < small
    assert largest(matrices["a⁻¹ a"] - np.eye(3)) < small


def test_product_acts_as_one_rotation_after_the_other(group, small):
    facts, _ = group
    assert largest(facts["ab on points"] - facts["a on b on points"]) < 4 * small


def test_unrotate_undoes_rotate(group, small):
    facts, _ = group
    assert largest(facts["back"] - facts["points"]) < 4 * small


def test_matrix_is_a_homomorphism(group, small):
    """The matrix of a product is the product of the matrices, and acts on vectors as the representation does."""
    facts, matrices = group
    a, b = (np.asarray(matrices[name], np.float64) for name in "ab")
    assert largest(matrices["ab"] - a @ b) < small
    assert largest(facts["rotated"] - np.einsum("kij,kj->ki", a, facts["points"])) < 4 * small
    assert largest(facts["unrotated"] - np.einsum("kji,kj->ki", a, facts["points"])) < 4 * small


def test_rotations_equal_those_of_scipy(group, small):
    facts, matrices = group
    reference = Scipy.from_rotvec(np.asarray(facts["vectors"], np.float64))
    assert largest(matrices["a"] - reference.as_matrix()) < small
    wxyz = np.asarray(facts["wxyz"], np.float64)
    expected = reference.as_quat(scalar_first=True)
    assert np.minimum(np.abs(wxyz - expected).max(-1), np.abs(wxyz + expected).max(-1)).max() < small


def test_exp_undoes_log(group, small):
    _, matrices = group
    assert largest(matrices["exp log a"] - matrices["a"]) < small


def test_log_undoes_exp(group, small):
    """Up to half a turn, where ±π about the same axis are one rotation; tiny angles keep their relative precision."""
    facts, _ = group
    log, vectors = np.asarray(facts["log"], np.float64), np.asarray(facts["vectors"], np.float64)
    angle = np.linalg.norm(vectors, axis=-1)
    assert np.linalg.norm(log, axis=-1).max() < np.pi + small
    inside = angle < np.pi - 1e-3
    assert largest(log[inside] - vectors[inside]) < 2 * small
    ends = np.stack([log - vectors, log + vectors])[:, ~inside]
    assert np.abs(ends).max(-1).min(0).max() < 3 * small
    if facts["kind"] is not EulerAngles:  # the sum and difference of whole angles have no relative precision
        relative = np.linalg.norm(log - vectors, axis=-1)[inside] / np.maximum(angle[inside], 1e-30)
        assert relative.max() < 2 * small


def test_logarithm_of_the_identity_is_exactly_zero(group):
    facts, _ = group
    assert largest(facts["vectors"][0]) == 0
    assert largest(facts["log"][0]) == 0


@pytest.mark.parametrize("source", ["Quaternion", "RotationMatrix", "EulerAngles-zyx", "EulerAngles-xzx"])
@pytest.mark.parametrize("target", ["Quaternion", "RotationMatrix", "EulerAngles-yzx", "EulerAngles-zxz"])
def test_conversion_keeps_the_rotation(dtype, small, source, target):
    vectors = rotation_vectors(dtype, seed=3)
    kind, sequence = REPRESENTATIONS[target]

    @jax.jit
    def both(v):
        a = of_vectors(*REPRESENTATIONS[source], v)
        b = EulerAngles.from_rotation(a, sequence) if kind is EulerAngles else kind.from_rotation(a)
        return a, b, a.angle_to(b)

    a, b, angle = both(vectors)
    assert isinstance(b, kind)
    assert largest(a.as_matrix() - b.as_matrix()) < small
    assert largest(angle) < 2 * small


def test_quaternion_and_its_negative_are_the_same_rotation(dtype, small):
    q = Quaternion.exp(rotation_vectors(dtype))
    negative = Quaternion(-q.wxyz)
    assert largest(q.as_matrix() - negative.as_matrix()) == 0
    half_turn = np.abs(np.asarray(q.wxyz[:, 0])) < 1e-6
    assert largest((q.log() - negative.log())[~half_turn]) < small
    assert (
        largest(RotationMatrix.from_rotation(q).matrix - numbers(RotationMatrix.from_rotation(negative))) == 0
    )
