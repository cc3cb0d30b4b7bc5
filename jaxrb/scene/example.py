"""A scene with a start: what the commands run by name."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from jaxrb.body.state import State
from jaxrb.integrators.method import Method
from jaxrb.integrators.names import method_of
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.scene import Scene
from jaxrb.scene.settings import check_positive, check_representation, warn_of_coarse_steps

_DEFAULT_STEPS = 1000  # of a scene that names no step


@dataclasses.dataclass(frozen=True)
class Example:
    """A scene with a start and a `duration` [s]. `start` holds the arguments of `Scene.state` as plain numbers.

    `dt` [s] is a step that suits it; None where any will do.
    """

    name: str
    about: str
    scene: Scene
    start: Mapping[str, Any]
    duration: float
    dt: float | None = None

    def state(self, rotation: type[Rotation] = Quaternion, dtype: Any = None) -> State:
        """The start in a representation and a floating type, by default JAX's own."""
        return self.scene.state(**self.start, rotation=rotation, dtype=dtype)

    def steps(
        self, state: State, method: Method | str, dt: float | None = None, duration: float | None = None
    ) -> tuple[Method, float, int]:
        """How a command runs it from a state: the method, the step [s] and the number of steps, checked.

        `dt` [s] and `duration` [s] are by default the example's own.

        Raises:
            InvalidInput: a step or duration that is not positive. UnknownName: a method that there is not.
            WrongStructure: a method that the state's representation cannot serve.
        """
        span = self.duration if duration is None else duration
        check_positive("duration", span)
        step = next(d for d in (dt, self.dt, span / _DEFAULT_STEPS) if d is not None)
        check_positive("dt", step)
        how = method_of(method)
        check_representation(how, state)
        warn_of_coarse_steps(self.scene, state, step, how)
        return how, step, max(1, round(span / step))
