"""Torque-free rotation of one body in closed form, over any time."""

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.integrators.free_flight_attitude import angle, angle_lanes, attitude, orbit_of
from jaxrb.integrators.free_flight_motion import axes_of, clock_of, couplings, momentum_then
from jaxrb.math.arrays import components, stack


def principal_value(omega, moments, time):
    w, i = tuple(components(omega)), tuple(components(moments))
    momentum = tuple(a * b for a, b in zip(w, i))
    g = couplings(i)
    axes = axes_of(i, momentum, g)
    clock = clock_of(axes, momentum, g, time)
    base, den = momentum_then(axes, clock, momentum, g)
    then = tuple(a * b for a, b in zip(base, clock.flip))
    w1 = tuple(a / b for a, b in zip(then, i))
    orbit = orbit_of(axes, clock, i, w, w1)
    first, third = angle_lanes(orbit, clock).evaluated()
    size = jnp.sqrt(sum(x * x for x in momentum))
    psi = angle(axes, clock, orbit, i, size, time, first, third)
    return attitude(axes, momentum, then, psi), stack(*w1)
