"""Floor 1: what a rigid body is."""

from jaxrb.body.body import Body as Body
from jaxrb.body.body import replicate as replicate
from jaxrb.body.freedom import Freedom as Freedom
from jaxrb.body.inertia import FullInertia as FullInertia
from jaxrb.body.inertia import Inertia as Inertia
from jaxrb.body.inertia import PrincipalInertia as PrincipalInertia
from jaxrb.body.inertia import SphericalInertia as SphericalInertia
from jaxrb.body.inertia import principal_axes as principal_axes
from jaxrb.body.mass_properties import MassProperties as MassProperties
from jaxrb.body.state import State as State
from jaxrb.body.validity import valid_inertia as valid_inertia
