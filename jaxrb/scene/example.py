"""A scene with a start: what the commands run by name."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from jaxrb.body.state import State
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.scene import Scene


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
