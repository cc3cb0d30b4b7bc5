"""Joints between bodies and to the world: what they are, what drives them, and how they are solved together."""

from jaxrb.joints.drives import Drive as Drive
from jaxrb.joints.drives import JointLimit as JointLimit
from jaxrb.joints.drives import JointMotor as JointMotor
from jaxrb.joints.drives import JointServo as JointServo
from jaxrb.joints.drives import JointSpring as JointSpring
from jaxrb.joints.joint import Joint as Joint
from jaxrb.joints.kinds import BallJoint as BallJoint
from jaxrb.joints.kinds import Distance as Distance
from jaxrb.joints.kinds import Hinge as Hinge
from jaxrb.joints.kinds import Slider as Slider
from jaxrb.joints.kinds import Weld as Weld
