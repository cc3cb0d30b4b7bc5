"""The abstract shape."""

from jaxrb.body.mass_properties import MassProperties
from jaxrb.checks import Checked
from jaxrb.math.arrays import Scalar


class Shape(Checked):
    """A solid in a frame of its own."""

    def mass_properties(self, density: Scalar) -> MassProperties:
        """Mass, centre of mass and inertia when filled with `density` [kg/m³]."""
        raise NotImplementedError
