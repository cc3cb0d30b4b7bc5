"""All ten inertial parameters as one unknown: found where forces show them, held by a prior or a shape elsewhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.body.mass_properties import MassProperties
from jaxrb.fit import Inertial, entropic_divergence
from jaxrb.fit.inertial import _signed_root, factor

INERTIA = 1e-3 * np.array([[6.0, 0.3, -0.2], [0.3, 5.0, 0.4], [-0.2, 0.4, 3.0]])  # [kg m²]
CENTER = np.array([0.01, -0.02, 0.015])  # [m]
ANCHORS = np.array([[0.1, 0.0, 0.0], [-0.05, 0.08, 0.0], [-0.05, -0.08, 0.02]])  # [m] in the body's axes
HOOKS = np.array([[0.5, 0.0, 0.9], [-0.4, 0.6, 1.0], [-0.3, -0.6, 0.8]])  # [m] in the world
ONLY_DOUBLE = "differences of a long run by ten parameters need float64"


@pytest.fixture(autouse=True, scope="module")
def _double():
    if jnp.zeros(()).dtype != jnp.float64:
        pytest.skip(ONLY_DOUBLE)


def body(scale=1.0, mass=1.2, center=CENTER) -> rb.Body:
    return rb.Body(mass, scale * INERTIA, center_of_mass=center)


def hung(found: MassProperties) -> rb.Scene:
    """On three springs of known stiffness, hooked to the body at known places."""
    springs = rb.SpringDamper(
        40.0, 0.1, 0.2, ANCHORS - found.center_of_mass, HOOKS, body_a=(0, 0, 0), body_b=None
    )
    return rb.Scene(rb.Body.from_mass_properties(found), (rb.UniformGravity(), springs))


def first_state(found: MassProperties) -> rb.State:
    """The frame's origin starts at rest at a known place; what moves with it depends on the centre of mass."""
    spin = jnp.array([3.0, 2.0, -4.0])
    velocity = jnp.cross(spin, found.center_of_mass)
    return free(found).state(
        position=found.center_of_mass[None], velocity=velocity[None], angular_velocity=spin[None]
    )


def free(found: MassProperties) -> rb.Scene:
    return rb.Scene(rb.Body.from_mass_properties(found))


def tracked(found: MassProperties, states: rb.State) -> dict:
    """The frame's origin, which the tracker follows."""
    return {
        "position": states.position[:, 0] - states.orientation.rotate(found.center_of_mass[None, None])[:, 0]
    }


def recorded(scene, noise: float, steps: int) -> rb.Recording:
    truth = Inertial(body()).value(jnp.zeros(10))
    path = rb.rollout(scene(truth), first_state(truth), dt=0.01, steps=steps)
    random = np.random.default_rng(0)
    clean = {**tracked(truth, path.states), "angular_velocity": path.states.angular_velocity[:, 0]}
    noisy = {
        name: np.asarray(value) + noise * random.normal(size=value.shape) for name, value in clean.items()
    }
    return rb.Recording(np.asarray(path.times), **noisy)


def numbers(properties) -> np.ndarray:
    matrix = np.asarray(properties.inertia.as_matrix())
    return np.concatenate([[properties.mass], properties.center_of_mass, matrix[np.triu_indices(3)]])


def test_known_springs_show_all_ten():
    recording = recorded(hung, 1e-4, 60)
    start = rb.Body(1.0, np.diag([4e-3, 4e-3, 3.2e-3]))
    found = rb.fit(hung, recording, Inertial(start), state=first_state, observe=tracked,
                   scales={"position": 1e-4, "angular_velocity": 1e-4})  # fmt: skip
    errors = numbers(found.standard_errors)
    assert np.abs((numbers(found.unknowns) - numbers(body())) / errors).max() < 4
    # Bars as wide as this would prove nothing.
    assert errors[0] < 1e-3
    assert errors[1:4].max() < 1e-4
    assert errors[4:].max() < 1e-5
    assert found.names[:2] == ("mass", "center_of_mass[0]")
    assert found.covariance.shape == (10, 10)


@pytest.fixture(scope="module")
def spinning():
    """A gyroscope on a body in free flight: five ratios are seen, mass, centre and scale are not."""
    return recorded(free, 1e-3, 40)


def gyroscope_fit(recording, unknown: Inertial) -> rb.SceneFit:
    return rb.fit(free, recording, unknown, state=first_state, scales={"angular_velocity": 1e-3})


def test_what_free_flight_leaves_open_is_refused_with_five_null_vectors(spinning):
    with pytest.raises(rb.NotIdentifiable, match="give a prior") as refusal:
        gyroscope_fit(spinning, Inertial(body(1.3)))
    null = getattr(refusal.value, "null_vectors")  # noqa: B009 - the base class has none
    assert null.shape == (5, 10)
    # One of them is all of the inertia, by the same factor.
    scale = np.concatenate([np.zeros(4), INERTIA[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]])
    held = scale / np.linalg.norm(scale)
    np.testing.assert_allclose(np.linalg.norm(held @ np.linalg.qr(null.T)[0]), 1.0, atol=1e-3)


def test_a_prior_decides_exactly_what_the_data_leave_open(spinning):
    """With the ratios seen, D is least at the prior's mass and centre, and at a scale in closed form."""
    prior = rb.Body(2.0, np.diag([3e-3, 4e-3, 5e-3]), center_of_mass=(0.0, 0.01, 0.0))
    found = gyroscope_fit(spinning, Inertial(body(0.7), prior)).unknowns
    assert float(found.mass) == pytest.approx(2.0, rel=1e-5)
    np.testing.assert_allclose(found.center_of_mass, [0.0, 0.01, 0.0], atol=1e-6)
    shown = np.asarray(found.inertia.as_matrix())
    np.testing.assert_allclose(shown / np.trace(shown), INERTIA / np.trace(INERTIA), atol=2e-3)
    second, towards = (0.5 * np.trace(i) * np.eye(3) - i for i in (shown, np.diag([3e-3, 4e-3, 5e-3])))
    assert np.trace(np.linalg.solve(towards, second)) == pytest.approx(3.0, rel=1e-4)


def test_a_bounding_shape_holds_back_what_the_prior_would_make_larger(spinning):
    prior = rb.Body(1.0, np.diag([5e-3, 4e-3, 4e-3]))
    loose = gyroscope_fit(spinning, Inertial(body(0.2), prior))
    wide = gyroscope_fit(spinning, Inertial(body(0.2), prior, within=rb.Sphere(1.0)))
    assert wide.held == loose.held == ()
    np.testing.assert_allclose(numbers(wide.unknowns), numbers(loose.unknowns), rtol=2e-5, atol=1e-9)
    # tr Σ/m = ½ tr I/m must stay below r²: the prior has 0.081² and is turned down to 0.06².
    tight = gyroscope_fit(spinning, Inertial(body(0.2), prior, within=rb.Sphere(0.06)))
    assert tight.held == ("unknown",)
    size = 0.5 * np.trace(np.asarray(tight.unknowns.inertia.as_matrix())) / float(tight.unknowns.mass)
    assert size == pytest.approx(0.06**2, rel=1e-4)
    assert size < 0.06**2
    tight, loose = (np.asarray(found.unknowns.inertia.as_matrix()) for found in (tight, loose))
    np.testing.assert_allclose(tight / np.trace(tight), loose / np.trace(loose), atol=1e-4)  # as the data say


def test_no_step_leaves_what_a_mass_distribution_can_have():
    """Each iterate of a fit is a step from the start, and each step is a body."""
    unknown = Inertial(body(), within=rb.Box((1.0, 1.0, 1.0)))
    steps = 2.0 * jax.random.normal(jax.random.key(0), (500, 10))
    upper = np.asarray(jax.vmap(unknown.moved)(steps))
    assert np.all(np.diagonal(upper, axis1=1, axis2=2) > 0)
    assert np.all(np.triu(upper) == upper)
    moments = np.linalg.eigvalsh(np.asarray(jax.vmap(lambda s: unknown.value(s).inertia.as_matrix())(steps)))
    assert np.all(moments[:, 2] < moments[:, 0] + moments[:, 1])
    np.testing.assert_allclose(numbers(unknown.value(jnp.zeros(10))), numbers(body()), rtol=1e-13)


def test_what_a_box_spares_is_the_second_moment_of_its_filling():
    """A box filled evenly uses a third of each condition; an ellipsoid three fifths of its one."""
    box, ball = rb.Box((0.1, 0.2, 0.3)), rb.Ellipsoid((0.1, 0.2, 0.3))
    zero = jnp.zeros(10)
    np.testing.assert_allclose(Inertial(rb.Body.from_shape(box, 500.0), within=box).spare(zero), 2 / 3)
    np.testing.assert_allclose(Inertial(rb.Body.from_shape(ball, 500.0), within=ball).spare(zero), 2 / 5)


def test_the_divergence_is_that_of_determinants_and_does_not_know_axes():
    one, other = body(), rb.Body(0.7, np.diag([3e-3, 4e-3, 5e-3]), center_of_mass=(0.02, 0.0, 0.0))
    a, b = (np.asarray(factor(x) @ factor(x).T) for x in (one, other))
    ratio = np.linalg.solve(b, a)
    expected = np.trace(ratio) - np.linalg.slogdet(ratio)[1] - 4.0
    assert float(entropic_divergence(one, other)) == pytest.approx(expected, rel=1e-12)
    assert float(entropic_divergence(one, one)) == pytest.approx(0.0, abs=1e-25)
    turn, shift = rb.Quaternion.exp(jnp.array([0.3, -1.0, 0.5])), jnp.array([0.1, 0.2, -0.3])
    moved = [MassProperties(x.mass, x.center_of_mass, x.inertia).moved(shift, turn) for x in (one, other)]
    assert float(entropic_divergence(*moved)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("x", [-1.0, -0.0500001, -0.0499999, -1e-9, 0.0, 1e-9, 0.0499999, 0.0500001, 1.0])
def test_the_root_of_the_divergence_is_smooth(x):
    """r² = e²ˣ − 1 − 2x: value, slope r r' = e²ˣ − 1, and curvature r'² + r r'' = 2 e²ˣ."""
    r, slope = _signed_root(jnp.array(x)), jax.grad(_signed_root)(x)
    curve = jax.grad(jax.grad(_signed_root))(x)
    assert float(slope**2 + r * curve) == pytest.approx(2.0 * np.exp(2.0 * x), rel=1e-9)
    assert float(r * slope) == pytest.approx(np.expm1(2.0 * x), rel=1e-12, abs=1e-30)
    assert slope > 0


def test_impossible_starts_and_bounds_are_refused():
    with pytest.raises(rb.InvalidInput, match="no place inside"):
        Inertial(body(), within=rb.Sphere(0.01))
    with pytest.raises(rb.InvalidInput, match="prior_weight is -1"):
        Inertial(body(), body(), -1.0)
    with pytest.raises(rb.InvalidInput, match=r"give rb\.Box"):
        Inertial(body(), within=rb.Capsule(0.1, 0.2))
    recording = rb.Recording(np.arange(3) / 100.0, angular_velocity=np.ones((3, 3)))
    with pytest.raises(rb.InvalidInput, match="huber"):
        rb.fit(free, recording, Inertial(body(), body()), state=first_state, huber=2.0)
