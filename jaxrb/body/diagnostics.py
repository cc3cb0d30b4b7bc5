"""Conserved quantities of bodies. Inputs with a bodies axis give one value a body."""

from jaxrb.body.mass_properties import MassProperties
from jaxrb.body.state import State
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.vector import cross, dot


def kinetic_energy(body: MassProperties, state: State) -> Scalar:
    """½ m v² + ½ ω·Iω [J]."""
    spin = dot(state.angular_velocity, body.inertia.apply(state.angular_velocity))
    return 0.5 * (body.mass * dot(state.velocity, state.velocity) + spin)


def momentum(body: MassProperties, state: State) -> Vector:
    """m v [kg m/s] in the world frame."""
    return stack(*(body.mass * v for v in components(state.velocity)))


def spin_angular_momentum(body: MassProperties, state: State) -> Vector:
    """R I ω [kg m²/s] about the centre of mass, in the world frame."""
    return state.orientation.rotate(body.inertia.apply(state.angular_velocity))


def angular_momentum(body: MassProperties, state: State) -> Vector:
    """p × m v + R I ω [kg m²/s] about the origin of the world, in the world frame."""
    return cross(state.position, momentum(body, state)) + spin_angular_momentum(body, state)
