"""Inertia from a gyroscope: how near to the Cramér–Rao bound, how often from poor starts, and how fast.

One flight of 1 s at 200 Hz, |ω| 10.8 rad/s, I/tr(I) = (0.2, 0.35, 0.45), made by SciPy's DOP853 and not by the engine.
`efficiency` is the Cramér–Rao bound over the mean squared error, both summed over the six ratios, `from truth` that of
the maximum of likelihood sought from the true inertia (no search does better), `least` that of the worst of the six;
`coverage` is the share of 95 % intervals that hold the truth, `reached` the share of random starts (log-Cholesky
coordinates normal with 0.8 on the diagonal and 0.5 off it) that end at the optimum.

    jaxrb bench --what identification
"""

import functools
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.bench.timing import both_clocks
from jaxrb.compilation import compiler_options
from jaxrb.draws import drawn
from jaxrb.fit.least_squares import levenberg_marquardt
from jaxrb.fit.packing import pack
from jaxrb.fit.parametrise import coordinates_from_ratios
from jaxrb.fit.residuals import FlightData, TrajectoryResidual
from jaxrb.fit.segments import Flight
from jaxrb.fit.shooting import multiple_shooting, schedule
from jaxrb.fit.uncertainty import ratio_jacobian
from jaxrb.io.recording import Recording

RATIOS, SPEED, RATE, DURATION = (0.2, 0.35, 0.45), 10.8, 200.0, 1.0  # [1], [rad/s], [1/s], [s]
NOISES = (1e-3, 1e-2, 0.1, 0.5)  # [rad/s]
DRAWS, STARTS, WINDOW = 1000, 200, 10  # count, count, intervals
DIRECTIONS = {"generic": (1.0, 1.0, 1.0), "flipping": (0.05, 1.0, 0.05)}
COLUMNS = (
    "what",
    "efficiency",
    "from truth",
    "least",
    "coverage",
    "reached",
    "iterations",
    "CPU [s a fit]",
    "error",
    "ratio",
)
RESIDUAL = TrajectoryResidual(substeps=1, use_spin=True, use_attitude=False)


def flight(direction: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Times (K,) and exact angular velocities (K, 3) that begin along `direction`."""
    from scipy.integrate import solve_ivp

    inertia = np.array(RATIOS)
    times = np.arange(round(RATE * DURATION) + 1) / RATE
    first = SPEED * np.array(direction) / np.linalg.norm(direction)
    path = solve_ivp(
        lambda _, w: -np.cross(w, inertia * w) / inertia, (0.0, times[-1]), first, method="DOP853", t_eval=times,
        rtol=1e-12, atol=1e-13,
    )  # fmt: skip
    return times, path.y.T


def packed(times: np.ndarray, spin: np.ndarray, noise: float) -> tuple[FlightData, np.ndarray, FlightData]:
    """The flight as a chain of windows, which of them go on, and in one piece."""
    recording, flights = Recording(times, spin), (Flight(0, 0, len(times)),)
    scales = np.array([noise, 1.0, 1.0])
    chain, joined = pack(recording, flights, spin, scales, WINDOW)
    return jax.tree.map(jnp.asarray, (chain, joined, pack(recording, flights, spin, scales)[0]))


def fit_batch(
    starts: Any, chains: Any, wholes: Any, chain: FlightData, joined: Any, whole: FlightData
) -> Any:
    """Fits of many starts (B, 5) and measured angular velocities (B, …), in one program."""

    def one(start, measured_chain, measured_whole):
        windows, flights = (
            chain._replace(angular_velocity=measured_chain),
            whole._replace(angular_velocity=measured_whole),
        )
        plan = schedule(measured_chain, chain.scales[..., 0], chain.present)
        return multiple_shooting(
            RESIDUAL, start, measured_chain[:, :, 0], (windows, joined), flights, stages=plan, centred=jnp.ones(5),
            weight=jnp.ones(1), free=jnp.ones(5),
        )  # fmt: skip

    return jax.vmap(one)(starts, chains, wholes)


def random_starts(count: int, seed: int = 0) -> np.ndarray:
    """Coordinates (count, 5) of bodies drawn in six log-Cholesky coordinates."""
    random = drawn(seed)
    log, below = 0.8 * random.normal(size=(count, 3)), 0.5 * random.normal(size=(count, 3))
    return np.concatenate([log[:, :2] - log[:, 2:], below * np.exp(-log[:, 2:])], axis=1)


def noisy_batch(
    spin: np.ndarray, noise: float, count: int, chain: FlightData, same: bool, seed: int = 1
) -> Any:
    """Measured angular velocities of `count` draws (or of one draw, `count` times) as chains and whole."""
    random = drawn(seed)
    noisy = spin + noise * random.normal(size=(1 if same else count, *spin.shape))
    noisy = np.broadcast_to(noisy, (count, *spin.shape))
    index = np.minimum(
        np.arange(chain.present.shape[1])[:, None] * WINDOW + np.arange(WINDOW + 1), len(spin) - 1
    )
    return jnp.asarray(noisy[:, None, index]), jnp.asarray(noisy[:, None, None])


def fit_program() -> Any:
    return jax.jit(fit_batch, compiler_options=compiler_options())


def rows() -> Iterator[dict[str, Any]]:
    """One row a noise level and motion, then the comparison with MuJoCo's least squares."""
    with jax.enable_x64(True):
        program = fit_program()
        for motion, direction in DIRECTIONS.items():
            times, spin = flight(direction)
            for noise in NOISES:
                yield (
                    dict.fromkeys(COLUMNS, "")
                    | {"what": f"{motion}, noise {noise:g} rad/s"}
                    | _row(program, times, spin, noise)
                )
        for row in beside_mujoco(program):
            yield dict.fromkeys(COLUMNS, "") | row


def _row(program: Any, times: np.ndarray, spin: np.ndarray, noise: float) -> dict[str, Any]:
    data = packed(times, spin, noise)
    truth = jnp.asarray(coordinates_from_ratios(np.diag(RATIOS)))
    found, _ = program(
        jnp.broadcast_to(truth, (DRAWS, 5)), *noisy_batch(spin, noise, DRAWS, data[0], False), *data
    )
    efficiency, least, coverage = statistics(np.asarray(found.shared), truth, spin, data[2])
    drawn = noisy_batch(spin, noise, DRAWS, data[0], False)[1]
    likeliest = jax.jit(jax.vmap(lambda one: _from_truth(truth, one, data[2])))(drawn)
    from_truth = statistics(np.asarray(likeliest.shared), truth, spin, data[2])[0]
    measured = noisy_batch(spin, noise, STARTS, data[0], True)
    starts = jnp.asarray(random_starts(STARTS))
    ended, iterations = program(starts, *measured, *data)
    best = _from_truth(truth, measured[1][0], data[2])
    cost, lowest = np.asarray(ended.cost), float(best.cost)
    cpu, _ = both_clocks(lambda: program(starts, *measured, *data)[0].cost, repeats=1)
    return {
        "efficiency": round(efficiency, 3),
        "from truth": round(from_truth, 3),
        "least": round(least, 3),
        "coverage": round(coverage, 4),
        "reached": float(np.mean(cost <= lowest * (1 + 1e-6))),
        "iterations": float(np.median(np.asarray(iterations))),
        "CPU [s a fit]": cpu / STARTS,
    }


def _from_truth(truth: Any, measured: Any, whole: FlightData) -> Any:
    return levenberg_marquardt(
        RESIDUAL,
        truth,
        measured[:, :, 0],
        whole._replace(angular_velocity=measured),
        weight=jnp.ones(1),
        free=jnp.ones(5),
    )


def statistics(
    found: np.ndarray, truth: Any, spin: np.ndarray, whole: FlightData
) -> tuple[float, float, float]:
    """Efficiency, that of the worst of the six ratios, and coverage of the fits' own 95 % intervals."""
    errors, deviations = [], []
    exact = whole._replace(angular_velocity=jnp.asarray(spin)[None, None])
    bound = np.sqrt(np.diag(_covariance(np.asarray(truth), exact)))
    six = np.array([*RATIOS, 0.0, 0.0, 0.0])
    covariances = _covariances(jnp.asarray(found), exact)
    for shared, covariance in zip(found, covariances):
        errors.append(_six(shared) - six)
        deviations.append(np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    errors, deviations = np.array(errors), np.array(deviations)
    squares = np.mean(errors**2, axis=0)
    efficiency, least = float(np.sum(bound**2) / np.sum(squares)), float(np.min(bound**2 / squares))
    return efficiency, least, float(np.mean(np.abs(errors) < 1.959964 * deviations))


def _six(shared: np.ndarray) -> np.ndarray:
    from jaxrb.fit.parametrise import ratios_from_coordinates

    matrix = np.asarray(ratios_from_coordinates(jnp.asarray(shared)))
    return matrix[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]


def _covariance(shared: np.ndarray, exact: FlightData) -> np.ndarray:
    return _covariances(jnp.asarray(shared)[None], exact)[0]


def _covariances(shared: Any, exact: FlightData) -> np.ndarray:
    """Inverse Fisher information of the six ratios (B, 6, 6) at `shared` (B, 5), the first spin eliminated."""

    @jax.jit
    def inner(shared):
        def residual(z):
            data = jax.tree.map(lambda leaf: leaf[0, 0], exact)
            return RESIDUAL.shoot(RESIDUAL.move(shared, z[:5]), data.angular_velocity[0] + z[5:], data)[0]

        jacobian = jax.jacfwd(residual)(jnp.zeros(8))
        return jnp.linalg.inv(jacobian.T @ jacobian)[:5, :5]

    inside = np.asarray(jax.lax.map(inner, shared))
    outside = [ratio_jacobian(np.asarray(one)) for one in shared]
    return np.array([j @ c @ j.T for j, c in zip(outside, inside)])


def fits_beside(program: Any, peer: Callable) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """One fit of a noisy flight from a sphere, and the same by a peer."""
    times, spin = flight(DIRECTIONS["generic"])
    noise = 1e-2
    data = packed(times, spin, noise)
    measured = noisy_batch(spin, noise, 1, data[0], True)
    own = functools.partial(program, jnp.zeros((1, 5)), *measured, *data)
    return own, functools.partial(peer, times, np.asarray(measured[1])[0, 0, 0])


def beside_mujoco(program: Any) -> Iterator[dict[str, Any]]:
    """The same flight by MuJoCo: `mujoco.minimize.least_squares` with differences, which `mujoco.sysid` runs."""
    try:
        from jaxrb.bench.identification_peer import mujoco_fit
    except ImportError:
        yield {"what": "MuJoCo is not installed (extra [bench])"}
        return
    mine, theirs = fits_beside(program, mujoco_fit)
    truth = np.array([*RATIOS, 0.0, 0.0, 0.0])
    found, iterations = mine()
    cpu, _ = both_clocks(lambda: mine()[0].cost)
    yield {
        "what": "jaxrb, one fit from a sphere",
        "iterations": float(iterations[0]),
        "CPU [s a fit]": cpu,
        "error": float(np.linalg.norm(_six(np.asarray(found.shared)[0]) - truth)),
    }
    began = time.process_time()
    six, count = theirs()
    peer = time.process_time() - began
    yield {
        "what": "MuJoCo least squares by differences, from a sphere",
        "iterations": count,
        "CPU [s a fit]": peer,
        "error": float(np.linalg.norm(six - truth)),
        "ratio": round(peer / cpu, 1),
    }
