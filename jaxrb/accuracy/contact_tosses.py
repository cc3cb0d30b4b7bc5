"""Whether certificates tell the error of runs with contact: random tosses of a cube, judged by far finer runs.

    python -m jaxrb.accuracy.contact_tosses [--count 100] [--json]

Each toss runs by `solve_contact` and by `rollout` (dt 1 ms, 1.5 s), both certified. Its truth is a run at a thousandth
of the tolerance, known to its difference from one at a hundredth: where that is above a fifth of the error, as after
impacts so nearly at once that their order is open, a toss is counted among "all" alone.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np

from jaxrb.body.state import State
from jaxrb.draws import drawn
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import HalfSpace
from jaxrb.scene import contact_library as library
from jaxrb.scene.adaptive import solve_contact
from jaxrb.scene.rollout import rollout
from jaxrb.scene.scene import Scene

DURATION, DT = 1.504, 1e-3  # [s]: sixteen saves of 94 steps
_KNOWN = 0.2


@dataclasses.dataclass(frozen=True)
class Toss:
    """One toss: the larger of position [m] and attitude [rad] error at the end, of each run as it is and as its
    certificate says; `known`: how well the truth is. `summed`: the sum of the errors estimated for each step."""

    friction: float
    restitution: float
    error: float
    estimate: float
    summed: float
    known: float
    fixed_error: float
    fixed_estimate: float


def tosses(count: int = 100, tolerance: float = 1e-5, seed: int = 3) -> Iterator[Toss]:
    """Random tosses of the library's cube: friction 0.2 to 0.8, restitution 0 to 0.6."""
    random = drawn(seed)
    for _ in range(count):
        friction, restitution = random.uniform(0.2, 0.8), random.uniform(0.0, 0.6)
        scene, start = _thrown(friction, restitution, random)

        def run(tolerance: float, scene: Scene = scene, start: State = start, **options: Any) -> Any:
            return solve_contact(scene, start, t1=DURATION, tolerance=tolerance, on_error="flag", **options)

        path, truth, check = run(tolerance, certify=True), run(1e-3 * tolerance), run(1e-2 * tolerance)
        steps = round(DURATION / DT)
        fixed = rollout(
            scene, start, dt=DT, steps=steps, save_every=steps // 16, certify=True, on_error="flag"
        )
        found, own = path.certificate, fixed.certificate
        assert found is not None
        assert own is not None
        yield Toss(
            friction,
            restitution,
            _apart(path.final, truth.final),
            _estimate(found),
            float(np.max(path.steps.error)),
            _apart(check.final, truth.final),
            _apart(fixed.final, truth.final),
            _estimate(own),
        )


def _thrown(friction: float, restitution: float, random: np.random.Generator) -> tuple[Scene, State]:
    example = library.cube_toss()
    contact = RigidContact(HalfSpace(), friction=friction, restitution=restitution)
    scene = Scene(example.scene.bodies, (library.GRAVITY, contact))
    turn = random.normal(size=4)
    return scene, scene.state(
        position=[0.0, 0.0, random.uniform(0.15, 0.4)],
        orientation=(turn / np.linalg.norm(turn)).tolist(),
        velocity=(random.normal(size=3) * [1.0, 1.0, 0.5]).tolist(),
        angular_velocity=(6.0 * random.normal(size=3)).tolist(),
    )


def _apart(a: State, b: State) -> float:
    turned = float(jax.numpy.max(a.orientation.angle_to(b.orientation)))
    return max(float(np.linalg.norm(np.asarray(a.position - b.position), axis=-1).max()), turned)


def _estimate(certificate: Any) -> float:
    return max(float(np.max(certificate.attitude_error)), float(np.max(certificate.position_error)))


def shares(found: Sequence[Toss]) -> dict[str, float]:
    """The share of estimates within a factor of 10 of the error: of tosses whose truth is known, and of all."""

    def within(estimates: list[float], errors: list[float]) -> float:
        ratio = np.asarray(estimates) / np.asarray(errors)
        return float(np.mean((ratio > 0.1) & (ratio < 10.0)))

    sure = [t for t in found if t.known < _KNOWN * t.error]
    return {
        "tosses": len(found),
        "truth known": len(sure),
        "second run": within([t.estimate for t in sure], [t.error for t in sure]),
        "second run, all": within([t.estimate for t in found], [t.error for t in found]),
        "sum of steps": within([t.summed for t in sure], [t.error for t in sure]),
        "fixed steps, all": within([t.fixed_estimate for t in found], [t.fixed_error for t in found]),
        "median error": float(np.median([t.error for t in found])),
        "median error of fixed steps": float(np.median([t.fixed_error for t in found])),
    }


def main(count: int = 100, json: bool = False) -> None:
    """Print how often the certificates of random tosses are within a factor of 10 of the error.

    Args:
        count: number of tosses; each takes some seconds.
        json: print one JSON object, with all tosses.
    """
    import json as json_text
    import sys

    from tqdm import tqdm

    with jax.enable_x64(True):
        found = list(tqdm(tosses(count), total=count, disable=not sys.stderr.isatty(), leave=False))
    result = shares(found)
    if json:
        print(json_text.dumps(result | {"each": [dataclasses.asdict(toss) for toss in found]}))
        return
    for name, value in result.items():
        print(f"{name:28} {value:.3g}")


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
