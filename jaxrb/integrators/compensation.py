"""Sums that keep what rounding takes from them.

A step adds a small change to a state, and rounding loses the change's last digits: after many steps that is the largest
error there is. Its exact value can be had (Knuth, "The Art of Computer Programming", vol. 2, §4.2.2, theorem B), and is
given back with the next change. (Kahan 1965, Commun. ACM 8, 40; Hairer, Lubich, Wanner 2006, section VIII.5.)
"""

import jax
import jax.numpy as jnp

from jaxrb.body.state import State
from jaxrb.integrators.method import Rates
from jaxrb.math.arrays import Array, Scalar, by_components


def no_remainder(state: State) -> Rates:
    """The remainder at the start of a run: zero."""
    parts = (state.position, state.orientation, state.velocity, state.angular_velocity)
    return Rates(*jax.tree.map(jnp.zeros_like, parts))


def compensated_sum(state: State, remainder: Rates, change: Rates, dt: Scalar) -> tuple[State, Rates]:
    """The state after a change and the remainder of the last one, and what rounding took this time."""
    position, lost_position = _sum(state.position, remainder.position, change.position)
    velocity, lost_velocity = _sum(state.velocity, remainder.velocity, change.velocity)
    omega, lost_omega = _sum(state.angular_velocity, remainder.angular_velocity, change.angular_velocity)
    leaves, structure = jax.tree.flatten(state.orientation)
    before, kept = jax.tree.flatten(remainder.orientation)
    changes = jax.tree.leaves(change.orientation, is_leaf=lambda part: part is None)  # None: it cannot turn
    sums = [_sum(*three) for three in zip(leaves, before, changes, strict=True)]
    orientation = structure.unflatten([new for new, _ in sums])
    lost_orientation = kept.unflatten([lost for _, lost in sums])
    done = State(position, orientation, velocity, omega, state.time + dt)
    return done, Rates(lost_position, lost_orientation, lost_velocity, lost_omega)


def _sum(value: Array, remainder: Array, change: Array | None) -> tuple[Array, Array]:
    if change is None:
        return value, remainder

    def total(x: Array, r: Array, c: Array) -> Array:
        return x + (c + r)

    def lost(x: Array, r: Array, c: Array, new: Array) -> Array:
        # Not the shorter form that needs |x| > |c|: components pass through zero.
        wanted = c + r
        taken = new - x
        return (x - (new - taken)) + (wanted - taken)

    new = by_components(total, value, remainder, change)
    return new, by_components(lost, value, remainder, change, new)
