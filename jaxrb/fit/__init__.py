"""Floor 7: inertia from a recording."""

from jaxrb.fit.command import fit as fit
from jaxrb.fit.free_fall import FreeFall as FreeFall
from jaxrb.fit.free_fall import fit_free_fall as fit_free_fall
from jaxrb.fit.inertia import RatiosNotIdentifiable as RatiosNotIdentifiable
from jaxrb.fit.inertia import fit_inertia as fit_inertia
from jaxrb.fit.report import InertiaFit as InertiaFit
from jaxrb.fit.segments import find_flights as find_flights
