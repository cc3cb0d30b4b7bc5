"""Models of other programs: MJCF and URDF."""

from jaxrb.io.models.load import load_mjcf as load_mjcf
from jaxrb.io.models.load import load_urdf as load_urdf
from jaxrb.io.models.model import Model as Model
from jaxrb.io.models.survey import Finding as Finding
