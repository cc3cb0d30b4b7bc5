"""Floor 3: pairs of shapes, no forces."""

from jaxrb.collision.contact import Contact as Contact
from jaxrb.collision.narrowphase import separation as separation
