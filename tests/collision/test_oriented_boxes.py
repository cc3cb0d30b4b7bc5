"""Fifteen directions part two boxes or nothing does: against linear programs, corner by corner."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.collision.obb import oriented_boxes_gap
from jaxrb.geometry.bounds import OrientedBox

COUNT = 300


@pytest.fixture(scope="module")
def pairs(dtype):
    """Boxes of which about half overlap; some turned by nothing or a right angle, so that edges are parallel."""
    random = np.random.default_rng(0)
    turns = random.normal(size=(2, COUNT, 3))
    turns[:, :60] = (np.pi / 2) * random.integers(0, 2, (2, 60, 3)) * [0, 0, 1]
    half = random.uniform(0.2, 1.0, (2, COUNT, 3))
    place = random.uniform(-1.3, 1.3, (2, COUNT, 3))

    def side(k):
        turn = jax.vmap(rb.Quaternion.exp)(jnp.asarray(turns[k], dtype))
        return OrientedBox(rb.Pose(jnp.asarray(place[k], dtype), turn), jnp.asarray(half[k], dtype))

    return side(0), side(1)


@pytest.fixture(scope="module")
def gaps(pairs):
    return np.asarray(jax.jit(jax.vmap(oriented_boxes_gap), compiler_options=QUICK)(*pairs))


def placed(box, i):
    """Centre, axes as rows and half extents on the host."""
    matrix = np.asarray(box.pose.orientation.as_matrix(), float)[i]
    return np.asarray(box.pose.position, float)[i], matrix.T, np.asarray(box.half_extents, float)[i]


def test_gap_is_positive_where_no_point_lies_in_both(pairs, gaps, tolerance):
    """A point within both boxes is a linear program; its best margin decides."""
    optimize = pytest.importorskip("scipy.optimize", reason="scipy (extra [mesh]) is not installed")
    meeting = 0
    for i in range(COUNT):
        sides = [placed(box, i) for box in pairs]
        rows = np.concatenate([sign * axes for _, axes, _ in sides for sign in (1, -1)])
        bounds = np.concatenate([sign * (axes @ c) + h for c, axes, h in sides for sign in (1, -1)])
        program = optimize.linprog(
            [0, 0, 0, -1], np.concatenate([rows, np.ones((12, 1))], 1), bounds, bounds=[(None, None)] * 4
        )
        margin = program.x[3]
        if abs(margin) > tolerance(float64=1e-9, float32=1e-4):
            assert (margin > 0) == (gaps[i] < 0)
        meeting += margin > 0
    assert 60 < meeting < 240


def test_negative_gap_is_the_shortest_way_out(pairs, gaps, tolerance):
    """Against the depth along many directions: none is shorter, and one comes near."""
    directions = np.random.default_rng(1).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    small, near = tolerance(float64=1e-12, float32=1e-5), []
    for i in np.flatnonzero(gaps < -0.05):
        (ca, ra, ha), (cb, rb_, hb) = (placed(box, i) for box in pairs)
        # The faces' own normals are in: there the support is a kink, which a sample would miss.
        tried = np.concatenate([directions, ra, rb_, -ra, -rb_])
        reach = np.abs(tried @ ra.T) @ ha + np.abs(tried @ rb_.T) @ hb
        depth = (reach - tried @ (cb - ca)).min()
        assert depth > -gaps[i] - small
        near.append(depth + gaps[i])
    assert np.median(near) < 1e-3


def test_gap_has_the_slope_of_the_parting_direction(pairs, gaps, dtype):
    i = int(np.argmax(gaps))
    one, other = (jax.tree.map(lambda x, i=i: x[i], box) for box in pairs)

    def of(position):
        return oriented_boxes_gap(
            one, OrientedBox(rb.Pose(position, other.pose.orientation), other.half_extents)
        )

    slope = np.asarray(jax.jit(jax.grad(of), compiler_options=QUICK)(other.pose.position))
    assert np.linalg.norm(slope) == pytest.approx(1.0, abs=1e-5)
