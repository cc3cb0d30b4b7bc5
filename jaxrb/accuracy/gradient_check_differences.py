"""Differences of a loss along a line, over many steps: their noise, plateaus, powers of the step, and trends."""

import dataclasses

import numpy as np

RESOLVED = 20.0  # times the noise: what is told from it
PLATEAU = 0.1  # differences that agree to this are a slope
_ROUGH = 0.25  # and to this where jumps are known to be between


@dataclasses.dataclass(frozen=True)
class Differences:
    """A loss along a line: `steps` h > 0 ascending (k,), `value` at the point, `ahead` and `behind` it (k,).

    `eps` is the round-off of one value relative to it; `scatter` (k,) the standard error of the central differences
    where the loss is a mean over samples.
    """

    steps: np.ndarray
    value: float
    ahead: np.ndarray
    behind: np.ndarray
    eps: float
    scatter: np.ndarray | None = None

    @property
    def central(self) -> np.ndarray:
        """(f(x + h) − f(x − h))/2h."""
        return (self.ahead - self.behind) / (2.0 * self.steps)

    @property
    def right(self) -> np.ndarray:
        """(f(x + h) − f(x))/h."""
        return (self.ahead - self.value) / self.steps

    @property
    def left(self) -> np.ndarray:
        """(f(x) − f(x − h))/h."""
        return (self.value - self.behind) / self.steps

    @property
    def round_off(self) -> float:
        """Of one value, at least."""
        return 2.0 * self.eps * max(abs(self.value), np.abs(self.ahead).max(), np.abs(self.behind).max())

    @property
    def noise(self) -> float:
        """Error of one value: round-off, or what the four smallest steps leave of a parabola through three of them."""
        rests = []
        for i in range(min(2, len(self.steps) - 3)):
            h = self.steps[i : i + 4]
            others = np.array([0, 1, 3])
            weights = [np.prod([(h[2] - h[q]) / (h[p] - h[q]) for q in others if q != p]) for p in others]
            for side in (self.ahead, self.behind):
                rests.append(abs(side[i + 2] - np.dot(weights, side[i : i + 4][others])))
        # Not the largest: a jump on one side spoils the fits there and is no noise.
        return max(self.round_off, 3.0 * sorted(rests)[1] if rests else 0.0)

    def up_to(self, count: int) -> "Differences":
        """The smallest `count` steps alone."""
        scatter = None if self.scatter is None else self.scatter[:count]
        return dataclasses.replace(
            self,
            steps=self.steps[:count],
            ahead=self.ahead[:count],
            behind=self.behind[:count],
            scatter=scatter,
        )


def plateau(
    steps: np.ndarray, slopes: np.ndarray, sigma: np.ndarray, power: int
) -> tuple[float, float, float]:
    """Where extrapolated slopes of neighbouring steps agree best: the slope, its uncertainty, the step."""
    share = 1.0 / ((steps[1:] / steps[:-1]) ** power - 1.0)
    better = slopes[:-1] + share * (slopes[:-1] - slopes[1:])
    error = sigma[:-1] * (1.0 + share) + share * sigma[1:]
    apart = np.abs(np.diff(better))
    spread = np.maximum(apart[1:], apart[:-1]) + 2.0 * error[1:-1]
    best = int(np.argmin(spread)) + 1
    return float(better[best]), float(spread[best - 1]), float(steps[best])


def power_of(steps: np.ndarray, change: np.ndarray, noise: float) -> float | None:
    """The power of h with which a change grows, from the smallest four steps that show it; None where it is none."""
    seen = np.abs(change) > RESOLVED * noise
    first = int(np.argmax(seen))
    window = slice(first, first + 4)
    if not seen[window].all() or len(steps[window]) < 4 or len(set(np.sign(change[window]))) > 1:
        return None
    powers = np.diff(np.log(np.abs(change[window]))) / np.diff(np.log(steps[window]))
    if np.ptp(powers) > 0.35:
        return None
    power = float(powers.mean())
    # What begins beyond the point is not at the point: it would have shown at the step before.
    if first and np.abs(change[first]) * (steps[first - 1] / steps[first]) ** power > 4.0 * RESOLVED * noise:
        return None
    return power


def trend_of(d: Differences, slope: float) -> tuple[float | None, float | None]:
    """The slope of the straight line through the coarsest steps on both sides, where there is one, and the finest of
    these: what a loss does beyond its own small jumps. `slope` is that of the finest steps."""
    bound = _ROUGH if _left_at_once(d, slope) else PLATEAU
    best: tuple[float, float | None, float | None] = (bound, None, None)
    for count in range(3, len(d.steps) // 2 + 1):
        h = d.steps[-count:]
        s = np.concatenate([-h, [0.0], h])
        values = np.concatenate([d.behind[-count:], [d.value], d.ahead[-count:]])
        line = float(np.dot(s, values) / np.dot(s, s))
        rest = values - values.mean() - line * s
        size = abs(line) * np.sqrt(np.mean(s * s))
        if size > 0 and np.sqrt(np.mean(rest * rest)) < best[0] * size:
            best = (float(np.sqrt(np.mean(rest * rest)) / size), line, float(h[0]))
    return best[1:]


def _left_at_once(d: Differences, slope: float) -> bool:
    """Whether from one step to the next the differences leave the slope of the finest: a smooth loss bends away."""
    off = np.abs(d.central - slope)
    return bool(np.any((off[:-1] < 0.01 * abs(slope)) & (off[1:] > _ROUGH * abs(slope))))


def flat_until(d: Differences, noise: float) -> float | None:
    """The step at which a flat loss begins to change, at once and not by a power of h; None where it does not."""
    change = np.maximum(np.abs(d.ahead - d.value), np.abs(d.behind - d.value))
    flat = change <= noise
    first = int(np.argmin(flat))
    if not flat[0] or flat.all() or first == len(flat) - 1:
        return None
    sudden = change[first] > 300.0 * noise and change[first] > 0.01 * change.max()
    return float(d.steps[first]) if sudden else None
