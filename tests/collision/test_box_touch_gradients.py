"""Derivatives of the points of two boxes, against differences of the points themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pairs import turns
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb.collision.touch import contact_points
from jaxrb.collision.touch_boxes import _FACE_NAMES
from jaxrb.collision.touch_clip import PLACES

X64 = pytest.mark.skipif(not jax.config.read("jax_enable_x64"), reason="differences need float64")


def points(x):
    """Of two boxes by 20 numbers: place, quaternion and half edges of each."""
    a, b = x[:10], x[10:]
    pose_a, pose_b = (rb.Pose(y[:3], rb.Quaternion(y[3:7]).normalise()) for y in (a, b))
    return contact_points(rb.Box(a[7:]), pose_a, rb.Box(b[7:]), pose_b)


def numbers(found):
    return jnp.concatenate([found.position.ravel(), found.distance, found.normal])


@X64
def test_points_of_boxes_follow_places_turns_and_edges():
    """Faces, edges and corners of every place, overlapping and apart: as differences of fourth order say."""
    generator, count = np.random.default_rng(5), 4096
    rows = [
        np.hstack([0.3 * generator.normal(size=(count, 3)), turns(generator, count), half])
        for half in 0.1 + 0.4 * generator.random(size=(2, count, 3))
    ]
    # Half of them lie on each other by faces that are nearly parallel, as at rest.
    rows[1][::2, 3:7] = rows[0][::2, 3:7] + 1e-2 * generator.normal(size=(count // 2, 4))
    x, along = jnp.asarray(np.hstack(rows)), jnp.asarray(generator.normal(size=(count, 20)))
    h = 1e-4

    def both(x, along):
        found = points(x)
        return jax.jvp(lambda y: numbers(points(y)), (x,), (along,))[1], found.feature, found.distance

    rate, names, gap = jax.jit(jax.vmap(both), compiler_options=QUICK)(x, along)
    near = jax.jit(jax.vmap(lambda y: (lambda p: (numbers(p), p.feature))(points(y))), compiler_options=QUICK)
    sides = {k: near(x + k * h * along) for k in (-2, -1, 1, 2)}
    same = np.all([np.asarray(s[1] == names).all(axis=1) for s in sides.values()], axis=0)
    value = {k: np.asarray(s[0]) for k, s in sides.items()}
    difference = (8 * (value[1] - value[-1]) - (value[2] - value[-2])) / (12 * h)
    scale = 1.0 + np.abs(difference).max(axis=1)
    # Another corner of the same name: what crosses in it has changed on the way, a kink.
    error = np.abs(rate - difference).max(axis=1) / scale
    kinks = same & (error > 1e-6)
    assert kinks.sum() <= 0.01 * same.sum()
    assert np.median(error[same]) < 1e-10
    # Nothing was left out: edges that cross, corners of either face, crossings of their sides, apart and overlapping.
    seen = np.asarray(names)[same & ~kinks]
    place = seen[(seen >= 0) & (seen < _FACE_NAMES)] % PLACES
    assert (seen >= _FACE_NAMES).sum() > 100
    assert np.bincount(place, minlength=PLACES).min() > 50
    assert (np.asarray(gap)[same & ~kinks, 0] > 0).sum() > 100
