"""Any numbers of a scene from a recording: an effect's coefficient, and a box's size and density through contact."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxrb as rb


def spun(coefficient: float) -> rb.Scene:
    body = rb.Body(1.0, (0.02, 0.03, 0.04))
    return rb.Scene(body, (rb.UniformGravity(), rb.LinearDrag(coefficient, angular_coefficient=0.01)))


def flown(scene, state, noise: float, steps=60, dt=0.01) -> rb.Recording:
    path = rb.rollout(scene, state, dt=dt, steps=steps)
    random = np.random.default_rng(0)
    clean = {"position": path.states.position[:, 0], "angular_velocity": path.states.angular_velocity[:, 0]}
    noisy = {
        name: np.asarray(value) + noise * random.normal(size=value.shape) for name, value in clean.items()
    }
    return rb.Recording(np.asarray(path.times, float), **noisy)


def test_leaves_of_a_scene_are_found_within_their_error_bars():
    if not jax.config.jax_enable_x64:
        pytest.skip("float32 resolves these noises only in part; the fit follows the type it is given")
    scene = spun(0.4)
    state = scene.state(position=[(0, 0, 1)], velocity=[(3, 0, 2)], angular_velocity=[(5.0, 1.0, 2.0)])
    recording = flown(scene, state, 1e-3)
    found = rb.fit(spun(0.1), recording, lambda s: s.effects[1].coefficient, state=state,
                   scales={"position": 1e-3, "angular_velocity": 1e-3})  # fmt: skip
    assert abs(float(found.unknowns) - 0.4) < 4 * float(found.standard_errors) < 0.01
    assert found.noise["position"] == pytest.approx(1e-3, rel=0.2)
    assert float(found.scene.effects[1].coefficient) == float(found.unknowns)


def test_what_the_motion_leaves_open_is_refused_with_its_direction():
    if not jax.config.jax_enable_x64:
        pytest.skip("float32 round-off hides an exact null direction")
    scene = spun(0.4)
    state = scene.state(velocity=[(3, 0, 2)], angular_velocity=[(0.0, 0.0, 0.0)])
    # Drag slows by coefficient over mass: both together leave no trace.
    with pytest.raises(rb.NotIdentifiable, match="nothing that was recorded changes") as refusal:
        rb.fit(scene, flown(scene, state, 1e-3), lambda s: (s.bodies[0].mass, s.effects[1].coefficient), state=state,
               scales={"position": 1e-3})  # fmt: skip
    null = np.abs(refusal.value.null_vectors)
    np.testing.assert_allclose(null, [[np.sqrt(0.5), np.sqrt(0.5)]], atol=1e-3)


def test_recordings_that_cannot_be_fitted_to_a_scene_are_refused():
    scene, time = spun(0.4), np.array([0.0, 0.01, 0.03])
    uneven = rb.Recording(time, position=np.zeros((3, 3)))
    with pytest.raises(rb.InvalidInput, match="resample"):
        rb.fit(scene, uneven, lambda s: s.bodies[0].mass, state=scene.state())
    even = rb.Recording(np.arange(3) / 100.0, position=np.zeros((3, 3)))
    with pytest.raises(rb.InvalidInput, match="'velocity'"):
        rb.fit(scene, even, lambda s: s.bodies[0].mass, state=scene.state(), scales={"velocity": 1.0})


def test_half_extents_and_density_are_found_through_a_contact():
    """One derivative through support function, mass properties, dynamics and contact, beside differences."""
    if not jax.config.jax_enable_x64:
        pytest.skip("differences through an impact need float64")
    floor = rb.CompliantContact(rb.HalfSpace(), stiffness=1e4, friction=0.3, slip_speed=0.1)

    def box(unknowns):
        body = rb.Body.from_shape(rb.Box(unknowns["half_extents"]), density=unknowns["density"])
        return rb.Scene(body, (rb.UniformGravity(), rb.LinearDrag(2.0), floor))

    truth = {"density": jnp.array(600.0), "half_extents": jnp.array([0.10, 0.06, 0.04])}
    scene = box(truth)
    # An edge strikes after some milliseconds and the box turns over it; drag and the spring show the mass.
    state = scene.state(
        position=[(0, 0, 0.085)], velocity=[(0.8, 0.1, -0.5)], angular_velocity=[(2.0, 3.0, 1.0)]
    )
    steps, dt = 160, 5e-4
    path = rb.rollout(scene, state, dt=dt, steps=steps)
    assert float(jnp.max(jnp.diff(path.states.velocity[:, 0, 2]))) > 9.81 * dt  # the floor pushes it up
    place, spin = path.states.position[:, 0], path.states.angular_velocity[:, 0]
    recording = rb.Recording(
        np.asarray(path.times), position=np.asarray(place), angular_velocity=np.asarray(spin)
    )
    near = {"density": jnp.array(560.0), "half_extents": jnp.array([0.102, 0.059, 0.0405])}
    found = rb.fit(box, recording, near, state=state, scales={"position": 1e-3, "angular_velocity": 1e-2},
                   max_iterations=20)  # fmt: skip
    np.testing.assert_allclose(found.unknowns["half_extents"], truth["half_extents"], rtol=1e-6)
    np.testing.assert_allclose(found.unknowns["density"], 600.0, rtol=1e-6)

    def end(four):
        last = rb.rollout(
            box({"density": four[0], "half_extents": four[1:]}), state, dt=dt, steps=steps
        ).final
        return jnp.concatenate([last.position[0], last.angular_velocity[0]])

    at = jnp.concatenate([truth["density"][None], truth["half_extents"]])
    both = jax.jit(lambda four: (end(four), jax.jacfwd(end)(four)), compiler_options=rb.compiler_options())
    moves = 1e-6 * jnp.diag(at)
    ends = jnp.stack([both(at + move)[0] - both(at - move)[0] for move in moves]) / (2e-6 * at[:, None])
    np.testing.assert_allclose(both(at)[1].T, ends, rtol=1e-4, atol=1e-6 * float(jnp.abs(ends).max()))


def test_an_optimiser_of_optax_minimises_a_loss_that_is_not_of_squares():
    """Absolute values: a few wild readings pull least squares off, and this not."""
    scene = spun(0.4)
    state = scene.state(position=[(0, 0, 1)], velocity=[(3, 0, 2)], angular_velocity=[(5.0, 1.0, 2.0)])
    recording = flown(scene, state, 1e-3)
    recording.position[10:16, 0] += 0.5
    options: dict = {"state": state, "scales": {"position": 1e-2}}
    lines = []
    found = rb.fit(
        spun(0.3),
        recording,
        lambda s: s.effects[1].coefficient,
        optimiser=optax.adam(0.03),
        loss=lambda r: jnp.mean(jnp.abs(r)),
        max_iterations=60,
        progress=lines.append,
        **options,
    )
    pulled = rb.fit(spun(0.3), recording, lambda s: s.effects[1].coefficient, **options)
    assert abs(float(found.unknowns) - 0.4) < 0.01 < abs(float(pulled.unknowns) - 0.4)
    assert np.isnan(found.standard_errors)
    assert len(lines) == 6
    assert "60 of 60 steps" in lines[-1]
    with pytest.raises(rb.InvalidInput, match="needs an optimiser"):
        rb.fit(scene, recording, lambda s: s.effects[1].coefficient, loss=jnp.sum, **options)
