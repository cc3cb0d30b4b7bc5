"""`rollout` for those who state a tolerance instead of a step."""

from typing import Any

from jaxrb.body.state import State
from jaxrb.errors import WrongStructure
from jaxrb.integrators.method import Method
from jaxrb.integrators.runge_kutta import RungeKutta4
from jaxrb.math.arrays import Scalar
from jaxrb.scene.path import Path
from jaxrb.scene.rollout import rollout as stepped
from jaxrb.scene.scene import Scene
from jaxrb.scene.settings import DEFAULT_MAX_BYTES, check_count


def rollout(
    scene: Scene,
    state: State,
    *,
    dt: Scalar | float | None = None,
    steps: int | None = None,
    t1: float | None = None,
    tolerance: float | None = None,
    method: Method | str | None = None,
    torque: Any = None,
    save_every: int = 1,
    saves: int | None = None,
    adjoint: str = "checkpoint",
    certify: bool = False,
    on_error: str = "raise",
    max_bytes: int = DEFAULT_MAX_BYTES,
) -> Path:
    """Advance a scene in one program; keep the initial and every `save_every`-th state.

    Either by `steps` steps of `dt` [s], or up to `t1` [s] within a `tolerance`: then method and step are those of
    `rb.plan` (which takes some seconds the first time, is remembered, and tells its evidence when called likewise).

    Args:
        scene, state: as for `step`.
        dt, steps: give both, or neither.
        t1: the time [s] at which a planned run ends.
        tolerance: largest error at the end: attitude [rad], position and energy relative to their scales. In a run of
            given steps [rad and m], the error that the certificate is to compare with. Implies `certify`.
        method: how to advance, by default Runge–Kutta 4; in a planned run the only candidate, by default all promising.
        torque: applied body torque [N m]: (n, 3) throughout, or (steps, n, 3), one a step; not in a planned run.
        save_every: `states` holds steps 0, k, 2k, …; `final` is always the very last state.
        saves: instead of `save_every`, in a planned run: so many states after the first, equally spaced.
        adjoint: how the reverse pass finds the states again: "checkpoint" recomputes them, "reversible" runs a
            symmetric method backwards from the saved states, in memory that does not grow with `save_every`.
        certify: estimate the run's own error, for three quarters of its cost more: `path.certificate`.
        on_error: "raise" `RunFailed` when a state leaves the finite numbers, or "flag" it in `path.status`. Inside
            `jit`, `vmap` or `grad` nothing can be raised: call `path.raise_if_bad()` outside.
        max_bytes: refuse to start if the saved states would need more.

    The reverse pass recomputes each saved stretch from its start: its memory is that of the saved states, and about
    √save_every states more. A planned run cannot be traced; plan outside, and give `dt`, `steps` and `method`.
    """
    if dt is not None and steps is not None and t1 is None and saves is None:
        method = RungeKutta4() if method is None else method
    else:
        _check_planned(
            {"dt": dt, "steps": steps}, {"t1": t1, "tolerance": tolerance}, saves, torque, save_every
        )
        assert t1 is not None
        assert tolerance is not None
        dt, steps, save_every, method = _planned(scene, state, t1, tolerance, method, saves)
    return stepped(
        scene, state, dt=dt, steps=steps, method=method, torque=torque, save_every=save_every, adjoint=adjoint,
        certify=certify, tolerance=tolerance, on_error=on_error, max_bytes=max_bytes,
    )  # fmt: skip


def _check_planned(stepped: dict, planned: dict, saves: Any, torque: Any, save_every: int) -> None:
    if any(v is not None for v in stepped.values()) or any(v is None for v in planned.values()):
        given = [k for k, v in (stepped | planned | {"saves": saves}).items() if v is not None]
        raise WrongStructure(
            f"rollout: given {', '.join(given) or 'neither'}; give dt and steps (save_every counts steps), or t1 and "
            "tolerance to have them chosen (saves counts states)"
        )
    if torque is not None:
        raise WrongStructure(
            "rollout: a planned run takes no torque; put the effect PrescribedTorque into the scene"
        )
    if save_every != 1:
        raise WrongStructure(
            "rollout: save_every counts steps, which a planned run chooses itself; say how many states by saves=…"
        )


def _planned(
    scene: Scene, state: State, t1: float, tolerance: float, method: Any, saves: int | None
) -> tuple[float, int, int, Method]:
    from jaxrb.accuracy.planner import plan  # with its clock and cache: not every program plans

    found = plan(scene, state, t1, tolerance, methods=None if method is None else [method])
    saves = None if saves is None else check_count("saves", saves, 1)
    # The certificate compares with steps four times as long, at places that both reach.
    group = 4 if saves is None else saves if saves >= 4 else 4 * saves
    steps = -(-found.steps // group) * group
    return (
        (float(t1) - float(state.time)) / steps,
        steps,
        1 if saves is None else steps // saves,
        found.method,
    )
