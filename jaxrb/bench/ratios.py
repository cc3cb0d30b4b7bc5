"""Every ratio that jaxrb has set itself as a goal, in one run: its own time over that of a peer, or of its forward run.

Each is measured in rounds in which both take turns, in CPU time; the median, the least and the most of the rounds stand
beside the goal, also where it is missed. The goals of hulls differ between float64 and float32; run both.

    jaxrb bench --what ratios
    jaxrb bench --what ratios --float32
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from jaxrb.accuracy.timing import in_turns
from jaxrb.bench import collision, contact, engines, identification
from jaxrb.bench.peers import mujoco_version

ROUNDS = 5
# Time over MuJoCo's, by boxes a world: five times, one and a half times and once its speed.
_CONTACT = {1: 1 / 5, 16: 1 / 1.5, 64: 1.0}
# Time over coal's, by state and precision: up to 32 corners, and of 64.
_HULLS = {
    ("apart", 64): (1.5, 1.5),
    ("apart", 32): (1.0, 1.0),
    ("overlapping", 64): (0.7, 1.3),
    ("overlapping", 32): (0.5, None),
}
_PAIR_GRADIENT, _RUN_GRADIENT, _FIT = 2.5, 5.0, 0.1


def rows() -> Iterator[dict[str, Any]]:
    """One row for each ratio."""
    yield from _free()
    yield from _contact()
    yield from _hulls()
    yield _fit()


def _free() -> Iterator[dict[str, Any]]:
    """A free body in 256 worlds; engines that are not installed are said to be missing."""
    for row in engines.rows(ROUNDS, kinds=("free",)):
        if row["engine"] == "jaxrb":
            yield _kept(
                "gradient of 200 steps, 256 free bodies", "its run", row["gradient/run"], _RUN_GRADIENT
            )
        elif row["jaxrb/peer"] == "":
            yield _missing("200 steps of a free body × 256", row["engine"], row["note"])
        else:
            spread = (row["jaxrb/peer"], row["least"], row["most"])
            yield _kept(
                f"200 steps of a free body × 256, at {row['error']:.0e} rad", row["engine"], spread, 1.0
            )


def _contact() -> Iterator[dict[str, Any]]:
    for boxes, worlds, steps in contact.WORKLOADS:
        what = f"{boxes} box{'es' if boxes > 1 else ''} on a plane × {worlds}, {steps} steps"
        scene, states, run, peer = contact.jobs_of(boxes, worlds, steps)
        if peer is None:
            yield _missing(what, "MuJoCo", "not installed (extra [bench])")
        else:
            yield _kept(what, "MuJoCo", _raced(run, peer), _CONTACT[boxes])
        if boxes == 1:
            plain, slope = contact.gradient_jobs(scene, states, steps)
            yield _kept(f"gradient of {what}", "its run", _raced(slope, plain), _RUN_GRADIENT)


def _hulls() -> Iterator[dict[str, Any]]:
    wide = jax.config.read("jax_enable_x64")
    for pair, state, shapes, poses, peer in collision.pairs():
        run, slope = collision.jobs_of(shapes, poses)
        yield _kept(f"gradient of {pair}, {state}", "its run", _raced(slope, run), _PAIR_GRADIENT)
        if pair == collision.BOXES:
            continue
        small, large = _HULLS[state, 64 if wide else 32]
        goal = large if pair.endswith("64") else small
        if peer is None:
            yield _missing(f"{pair}, {state}", "coal", "not installed (extra [bench])")
            continue
        share = collision.PEER_PAIRS / collision.PAIRS
        yield _kept(f"{pair}, {state}", "coal", share * _raced(run, peer), goal)


def _fit() -> dict[str, Any]:
    what = "inertia from a gyroscope, a fit"
    if not mujoco_version():
        return _missing(what, "MuJoCo", "not installed (extra [bench])")
    from jaxrb.bench.identification_peer import mujoco_fit

    own, peer = identification.fits_beside(identification.fit_program(), mujoco_fit)
    return _kept(what, "MuJoCo", _raced(own, peer), _FIT)


def _raced(run: Callable[[], Any], peer: Callable[[], Any]) -> np.ndarray:
    samples = in_turns([run, peer], ROUNDS)
    return samples[:, 0] / samples[:, 1]


def _kept(what: str, beside: str, ratios: Any, goal: float | None) -> dict[str, Any]:
    """`ratios`: of every round; or median, least and most."""
    median = float(np.median(ratios))
    verdict = "" if goal is None else "kept" if median <= goal else "missed"
    return {
        "what": what,
        "beside": beside,
        "time over its": median,
        "least": float(np.min(ratios)),
        "most": float(np.max(ratios)),
        "goal": goal,
        "verdict": verdict,
    }


def _missing(what: str, beside: str, note: str) -> dict[str, Any]:
    return {
        "what": what,
        "beside": beside,
        "time over its": None,
        "least": None,
        "most": None,
        "goal": None,
    } | {"verdict": note}
