"""Every method against exact answers (40 digits), in both representations, at its design order."""

import json
import operator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrb as rb
from jaxrb import integrators
from jaxrb.integrators.splitting import Splitting

GRAVITY = 9.81
REPRESENTATIONS = [rb.Quaternion, rb.RotationMatrix]
CASES = [
    "const_body_torque",
    "dzhanibekov",
    "generic_asym",
    "heavy_asym",
    "lagrange_top",
    "near_symmetric",
    "rest_start",
    "slender",
    "sphere",
    "symmetric_disc",
]


class Case:
    """One exact answer as a scene, a start and an end."""

    def __init__(self, folder, name):
        data = json.loads((folder / "rotation" / f"{name}.json").read_text())
        numbers = {k: np.array([float(x) for x in v]) for k, v in data.items() if isinstance(v, list)}
        inertia, effects = numbers["inertia"], ()
        if "mgr_body" in numbers:
            # The moments are about the held point: a unit mass at r = mgr/g, and Steiner backwards.
            r = numbers["mgr_body"] / GRAVITY
            body = rb.Body(1.0, np.diag(inertia) - (r @ r * np.eye(3) - np.outer(r, r)))
            effects = (rb.UniformGravity((0.0, 0.0, -GRAVITY)), rb.FixedPoint(point=-r))
        else:
            body = rb.Body(1.0, inertia if np.ptp(inertia) else inertia[0])
        if "torque_body_const" in numbers:
            effects = (rb.PrescribedTorque(numbers["torque_body_const"]),)
        self.scene = rb.Scene(body, effects)
        self.start = numbers["q0"] / np.linalg.norm(numbers["q0"]), numbers["omega0"]
        self.end = numbers["q_end"], numbers["omega_end"]
        self.duration = float(data["t_end"])

    def state(self, rotation):
        q, w = (part.tolist() for part in self.start)  # lists follow the precision of the run
        return self.scene.state(orientation=q, angular_velocity=w, rotation=rotation)

    def error(self, state) -> float:
        """Attitude error [rad] at the end."""
        q = state.orientation.normalise().as_quaternion_array()[0]
        return float(rb.attitude_error(q, jnp.asarray(self.end[0], q.dtype)))


@pytest.fixture(scope="module")
def cases(oracle):
    return {name: Case(oracle, name) for name in CASES}


@jax.jit
def ends(scene, state, method, duration, counts):
    """Final states after `counts` (k,) steps each, of one compiled program: the number of steps is a loop bound."""
    dynamics = scene.prepared(state.dtype)

    def run(count):
        dt = duration / count
        return jax.lax.fori_loop(0, count, lambda _, s: method.step(dynamics, s, dt), state)

    return jax.lax.map(run, counts)


def errors(case, rotation, method, counts):
    final = ends(case.scene, case.state(rotation), method, case.duration, jnp.asarray(counts))
    return np.array([case.error(jax.tree.map(operator.itemgetter(i), final)) for i in range(len(counts))])


# Fastest rate of each case [rad/s], and dt · rate per order: coarse enough for the truncation error to stand far above
# round-off, fine enough to be in the asymptotic range.
RATES = {"slender": 12.0, "lagrange_top": 8.0, "const_body_torque": 3.0, "rest_start": 3.0, "heavy_asym": 2.5}
COARSE = {1: 1e-3, 2: 0.025, 4: 0.025, 6: 0.2}
# With (nearly) constant |ω| a term of fifth order of Runge and Kutta outweighs that of fourth until steps are finer.
FINER = ("generic_asym", "near_symmetric", "symmetric_disc")
METHODS = [
    rb.ExplicitEuler,
    rb.SemiImplicitEuler,
    rb.VelocityVerlet,
    rb.ImplicitMidpoint,
    rb.RungeKutta4,
    integrators.ThreeAxisSplitting,
    integrators.ThreeAxisSplitting4,
    integrators.MoserVeselov,
    integrators.MoserVeselov4,
    integrators.MoserVeselov6,
]
SPLITTINGS = (integrators.ThreeAxisSplitting, integrators.ThreeAxisSplitting4)


def exact(method, name):
    """Whether a method has no error but round-off: the flight of a sphere, a symmetric body that is split in two."""
    if name == "sphere":
        return method is rb.VelocityVerlet or issubclass(method, Splitting)
    return method in SPLITTINGS and name in ("symmetric_disc", "near_symmetric")


@pytest.mark.parametrize("rotation", REPRESENTATIONS, ids=lambda r: r.__name__)
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)
@pytest.mark.parametrize("name", CASES)
def test_method_converges_at_its_design_order(cases, dtype, name, method, rotation):
    if dtype == jnp.float32:
        pytest.skip("round-off of float32 hides the order at the steps where it shows")
    case, order = cases[name], method.order
    count = round(case.duration * RATES.get(name, 1.6) / COARSE[order])
    if method is rb.RungeKutta4:
        count = count * 4 if name in FINER else count // 2 if name == "dzhanibekov" else count
    elif method is integrators.ThreeAxisSplitting4:
        count = count // 25 if name == "dzhanibekov" else count // 7
    coarse, fine = errors(case, rotation, method(), [count, 2 * count])
    if exact(method, name):
        assert max(coarse, fine) < 2e-12
        return
    if name == "sphere" and order == 1:
        order = 2  # the spin is constant, and the projected tangent errs by the angle cubed
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("name", CASES)
def test_runge_kutta_reaches_every_exact_answer(cases, tolerance, dtype, name):
    case = cases[name]
    steps = {"slender": 80_000, "sphere": 160_000}.get(name, 20_000)
    (error,) = errors(case, rb.Quaternion, rb.RungeKutta4(), [steps])
    # float32: round-off of some 1e4 steps, amplified by the unstable axis of dzhanibekov and by the chaotic top.
    assert error < tolerance(float64=5e-8, float32=0.3 if name == "dzhanibekov" else 2e-2)


def test_runge_kutta_quaternion_reaches_3e_9_on_dzhanibekov(cases, dtype):
    if dtype == jnp.float32:
        pytest.skip("the figure is for float64")
    (error,) = errors(cases["dzhanibekov"], rb.Quaternion, rb.RungeKutta4(), [10_000])
    print(f"RK4, quaternion, 1e4 steps, dzhanibekov: {error:.2e} rad")
    assert error < 3e-9


def test_diffrax_dopri8_reaches_1e_9_on_dzhanibekov(cases, tolerance, dtype):
    case = cases["dzhanibekov"]
    rtol = tolerance(float64=1e-11, float32=1e-5)
    path = rb.solve(case.scene, case.state(rb.Quaternion), t1=case.duration, rtol=rtol, atol=rtol)
    error = case.error(path.final)
    print(f"Dopri8, rtol {rtol:g}, dzhanibekov: {error:.2e} rad")
    assert error < tolerance(float64=1e-9, float32=0.2)


@pytest.mark.parametrize("rotation", REPRESENTATIONS, ids=lambda r: r.__name__)
def test_midpoint_keeps_energy_momentum_and_group(cases, tolerance, rotation):
    case = cases["generic_asym"]
    method = rb.ImplicitMidpoint(renormalise=False)
    path = rb.rollout(
        case.scene, case.state(rotation), dt=0.02, steps=5000, save_every=500, method=method, on_error="flag"
    )
    found = path.diagnostics
    limit = tolerance(float64=2e-12, float32=2e-3)
    energy = np.asarray(found.energy)
    assert np.abs(energy / energy[0] - 1).max() < limit
    body = np.linalg.norm(np.asarray(path.states.angular_velocity) * np.asarray([0.7, 1.3, 1.9]), axis=-1)
    assert np.abs(body / body[0] - 1).max() < limit
    assert np.abs(found.drift.scale).max() < limit
    assert np.abs(found.drift.skew).max() < limit
