"""Floor 7: inertia from a recording, and any numbers of a scene: `rb.fit(scene, recording, unknowns, …)`.

The package can be called: `rb.fit` is `fit_scene`, in whichever order things were imported.
"""

import sys
from types import ModuleType
from typing import Any

from jaxrb.fit.command import fit as fit
from jaxrb.fit.free_fall import FreeFall as FreeFall
from jaxrb.fit.free_fall import fit_free_fall as fit_free_fall
from jaxrb.fit.inertia import fit_inertia as fit_inertia
from jaxrb.fit.inertial import Inertial as Inertial
from jaxrb.fit.inertial import entropic_divergence as entropic_divergence
from jaxrb.fit.refusal import ParametersNotIdentifiable as ParametersNotIdentifiable
from jaxrb.fit.refusal import RatiosNotIdentifiable as RatiosNotIdentifiable
from jaxrb.fit.report import InertiaFit as InertiaFit
from jaxrb.fit.residuals import UNKNOWNS as UNKNOWNS
from jaxrb.fit.scene_fit import SceneFit as SceneFit
from jaxrb.fit.scene_fit import fit_scene as fit_scene
from jaxrb.fit.segments import find_flights as find_flights
from jaxrb.fit.tosses import TOSS_UNKNOWNS as TOSS_UNKNOWNS
from jaxrb.fit.tosses import Search as Search
from jaxrb.fit.tosses import TossFit as TossFit
from jaxrb.fit.tosses import fit_tosses as fit_tosses
from jaxrb.fit.tosses import solid_on_table as solid_on_table


class _Callable(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> SceneFit:
        return fit_scene(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
