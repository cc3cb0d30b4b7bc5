"""Bad inputs of contact: 13, 18, 19 (states), 32 and 33 (masses). One program serves them all."""

import jax
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.errors import JaxrbWarning


def balls(*densities):
    """Two balls of 0.1 m over a floor and each other."""
    parts = [rb.Body.from_shape(rb.Sphere(0.1), density=density) for density in densities]
    both = jax.tree.map(lambda *x: np.stack(x), *parts)
    return rb.Scene(both, (rb.UniformGravity(), rb.RigidContact(rb.HalfSpace()), rb.RigidContact()))


def run(scene, places, **options):
    state = scene.state(position=[(x, 0.0, z) for x, z in places])
    return rb.rollout(scene, state, dt=2e-3, steps=200, save_every=1, **options)


def test_place_too_far_away_for_contact_is_warned_of():
    """[13]"""
    scene = balls(500.0, 500.0)
    far = np.asarray([(1e7, 0, 0.1), (1e7, 1, 0.1)], np.float32)
    with pytest.warns(JaxrbWarning, match=r"body 0 is at \[10000000.0, .* float32 has steps of 1.0e\+00 m"):
        scene.state(position=far)
    scene.state(position=far - far[0])
    rb.Scene(scene.bodies).state(position=far)  # without contact its digits are its owner's affair


def test_overlapping_start_is_warned_of_with_its_depth():
    """[18, 19] Half in each other, and one in the other; beside each other there is nothing to say."""
    for away, depth in ((0.1, "0.1"), (0.01, "0.19"), (0.21, None)):
        places = ((0.0, 0.1), (away, 0.1))
        if depth is None:
            run(balls(500.0, 500.0), places)
            continue
        with pytest.warns(
            JaxrbWarning, match=rf"overlapped by up to {depth} m.*saved state 1; set them apart"
        ):
            run(balls(500.0, 500.0), places)


def test_stack_of_mass_ratio_1e6_stands_or_says_that_it_does_not(dtype):
    """[32, 33] The light ball below carries a million times its weight."""
    with pytest.warns(
        JaxrbWarning, match=r"body 1 has 1e\+06 times the mass of body 0.*path\.contact\.penetration"
    ):
        path = run(balls(50.0, 5e7), ((0.0, 0.1), (0.0, 0.3)), on_error="flag")
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(path.states))
    deep, poor = float(path.contact.penetration[-1]), int(path.contact.poor[-1])
    print(f"{dtype}: overlap {deep:.1e} m, {poor} poor steps")
    if deep < 1e-3:
        return
    assert poor > 0
    with pytest.warns(JaxrbWarning, match="bodies overlapped by up to"):
        path.raise_if_bad()
