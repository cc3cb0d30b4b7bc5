"""A model that was read: a scene, a start, and what of the file is in neither."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from jaxrb.body.state import State
from jaxrb.io.models.survey import Finding
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.rotation import Rotation
from jaxrb.scene.scene import Scene


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """What `load_mjcf` and `load_urdf` return.

    * `scene`, and `start`: the arguments of `Scene.state` as plain numbers; `state` is that start.
    * `timestep` [s]: the file's.
    * `bodies`: names of the scene's bodies in their order. `joints`: of each joint's name the number of its value among
      `scene.effects`, and its row where the value holds several.
    * `unsupported`: what would change the motion and is not in the scene; empty unless it was asked to be reported.
      `ignored`: what changes no motion here: looks, settings of MuJoCo's solver.
    """

    name: str
    scene: Scene
    start: Mapping[str, Any]
    timestep: float
    bodies: tuple[str, ...]
    joints: Mapping[str, tuple[int, int]]
    unsupported: tuple[Finding, ...]
    ignored: tuple[Finding, ...]

    @property
    def state(self) -> State:
        """The start, in quaternions and JAX's default floating type."""
        return self.state_in()

    def state_in(self, rotation: type[Rotation] = Quaternion, dtype: Any = None) -> State:
        """The start in another representation of rotations or floating type."""
        return self.scene.state(**self.start, rotation=rotation, dtype=dtype)

    def summary(self) -> str:
        """What there is, and line by line what was left out."""
        count = len(self.bodies)
        lines = [
            f"{self.name}: {count} {'body' if count == 1 else 'bodies'}, {len(self.joints)} joints, "
            f"timestep {self.timestep:g} s"
        ]
        for title, found in (("not supported", self.unsupported), ("without effect here", self.ignored)):
            lines += [f"{title}: {len(found)}"] if found else []
            lines += [f"  {finding}" for finding in found]
        return "\n".join(lines)
