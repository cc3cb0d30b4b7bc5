"""Which gradient to trust: automatic differentiation in both modes beside differences over many steps."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.gradient_check_point import Point
from jaxrb.accuracy.gradient_check_report import DirectionCheck, GradientCheck
from jaxrb.accuracy.gradient_check_verdict import judged
from jaxrb.errors import InvalidInput

STEPS = tuple(float(h) for h in 10.0 ** np.arange(-6.0, -0.9, 0.5))


def gradient_check(
    loss: Callable[..., Any],
    at: Any,
    *,
    directions: int | None = None,
    steps: Any = STEPS,
    scale: Any = None,
    tolerance: float | None = None,
    key: Any = None,
    samples: int = 64,
    over_time: Callable[[Any], Any] | None = None,
    jit: bool = True,
    progress: Callable[[], Any] | None = None,
) -> GradientCheck:
    """Whether the derivative of a loss is right, biased, zero, jumping, not finite, or undetermined; and why.

    Derivatives in forward and in reverse mode stand beside central and one-sided differences over steps of 1e-6 … 1e-1
    of the size of each leaf. `print(check.summary())`, `check.to_json()`, and `jaxrb.view.gradient_figure`;
    docs/gradients.md says how to read the verdicts.

    Args:
        loss: `loss(at)`, one real number; with `key`, `loss(at, key)`, whose mean over `samples` keys is looked at,
            and the variance of its derivative.
        at: any tree with floating arrays, such as a state, a scene, a dictionary; other leaves are left alone.
        directions: that many drawn at random; by default each number by itself, or 6 drawn where there are over 12.
        steps: ascending, relative to the scales.
        scale: of each leaf, as a tree like `at` or one number; by default its largest number, or 1 where all are zero.
        tolerance: relative error of a derivative that counts as right: 1e-5 in float64, 1e-2 in float32.
        over_time: `over_time(at)` gives (times (k,), losses (k,)): the same loss at growing horizons, whose derivatives
            show chaos.
        jit: compile the loss; False for one that cannot be.
        progress: called after every evaluation.

    A mode of differentiation that raises is reported, not raised. `len(steps) · 2 · directions` evaluations.

    Raises:
        WrongStructure: no floating leaf in `at`, a loss that is not one real number. InvalidInput: steps, scale.
    """
    point = Point(loss, at, scale, key, samples, jit)
    steps = _checked_steps(steps)
    names, lines, sizes = point.lines(directions)
    eps = float(jnp.finfo(point.dtype).eps)
    tolerance = (1e-5 if eps < 1e-10 else 1e-2) if tolerance is None else tolerance
    modes, failed = point.derivatives(lines)
    # A loss that is not finite is a finding, no mishap.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        found = []
        for line, size in zip(lines, sizes, strict=True):
            found.append(point.differences(line, size, steps, eps, progress))
        # Over the coarser half of the steps: in the finest it may be round-off that speaks.
        sizes_seen = [
            float(np.median(np.abs(d.central[len(d.steps) // 2 :])) * s) for d, s in zip(found, sizes)
        ]
        largest = max((seen for seen in sizes_seen if np.isfinite(seen)), default=0.0)
        checks = []
        for i, (d, size) in enumerate(zip(found, sizes, strict=True)):
            own = {mode: slopes[i] for mode, slopes in modes.items()}
            slopes = {
                mode: float(own[mode].mean()) if mode in own else None for mode in ("forward", "reverse")
            }
            finding = judged(d, slopes["forward"], slopes["reverse"], tolerance, 1e-3 * largest / size)
            spread = next(iter(own.values())) if own and key is not None else None
            checks.append(
                DirectionCheck(
                    names[i], size, tuple(d.steps), tuple(d.central), tuple(d.right), tuple(d.left), **slopes,
                    noise=d.noise if np.isfinite([*d.ahead, *d.behind, d.value]).all() else np.nan,
                    variance=None if spread is None else float(spread.var(ddof=1)), finding=finding,
                )
            )  # fmt: skip
    growth = None if over_time is None else point.growth(over_time, lines, sizes)
    return GradientCheck(
        tuple(checks), point.value, np.dtype(point.dtype).name, tolerance, failed,
        samples if key is not None else None, growth,
    )  # fmt: skip


def _checked_steps(steps: Any) -> np.ndarray:
    steps = np.asarray(steps, float)
    if steps.ndim != 1 or len(steps) < 6 or not (steps > 0).all() or not (np.diff(steps) > 0).all():
        raise InvalidInput(
            f"gradient_check: steps {steps.tolist()}; give at least 6 positive numbers that ascend, a decade or more"
        )
    return steps
