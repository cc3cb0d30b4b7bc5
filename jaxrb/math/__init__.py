"""Floor 0: rotations and safe functions. Arrays only; no bodies."""

from jaxrb.math.euler_angles import EulerAngles as EulerAngles
from jaxrb.math.interpolation import slerp as slerp
from jaxrb.math.matrix import RotationMatrix as RotationMatrix
from jaxrb.math.quaternion import Quaternion as Quaternion
from jaxrb.math.quaternion import attitude_error as attitude_error
from jaxrb.math.rotation import Drift as Drift
from jaxrb.math.rotation import Rotation as Rotation
from jaxrb.math.vector import hat as hat
from jaxrb.math.vector import vee as vee
