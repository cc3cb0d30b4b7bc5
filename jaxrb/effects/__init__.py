"""Floor 4: what acts on bodies."""

from jaxrb.effects.custom import CustomForce as CustomForce
from jaxrb.effects.drag import LinearDrag as LinearDrag
from jaxrb.effects.drag import QuadraticDrag as QuadraticDrag
from jaxrb.effects.effect import Effect as Effect
from jaxrb.effects.effect import Force as Force
from jaxrb.effects.effect import Wrench as Wrench
from jaxrb.effects.fixed_point import FixedPoint as FixedPoint
from jaxrb.effects.gravity import UniformGravity as UniformGravity
from jaxrb.effects.spring import SpringDamper as SpringDamper
from jaxrb.effects.thruster import BodyThruster as BodyThruster
from jaxrb.effects.thruster import PrescribedTorque as PrescribedTorque
