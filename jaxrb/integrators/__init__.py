"""Floor 5: one method a file."""

from jaxrb.integrators.euler import ExplicitEuler as ExplicitEuler
from jaxrb.integrators.method import Method as Method
from jaxrb.integrators.midpoint import ImplicitMidpoint as ImplicitMidpoint
from jaxrb.integrators.moser_veselov import MoserVeselov as MoserVeselov
from jaxrb.integrators.moser_veselov import MoserVeselov4 as MoserVeselov4
from jaxrb.integrators.moser_veselov import MoserVeselov6 as MoserVeselov6
from jaxrb.integrators.names import METHODS as METHODS
from jaxrb.integrators.names import method_of as method_of
from jaxrb.integrators.runge_kutta import RungeKutta4 as RungeKutta4
from jaxrb.integrators.semi_implicit import SemiImplicitEuler as SemiImplicitEuler
from jaxrb.integrators.three_axis_splitting import ThreeAxisSplitting as ThreeAxisSplitting
from jaxrb.integrators.three_axis_splitting import ThreeAxisSplitting4 as ThreeAxisSplitting4
from jaxrb.integrators.verlet import VelocityVerlet as VelocityVerlet
