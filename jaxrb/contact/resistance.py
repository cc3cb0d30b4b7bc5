"""Resistance to rolling and spinning: a couple at each pair that touches, bounded by a length times its load.

The couple is one slot more in the pair's block, its last: a "point" whose velocity is the pair's relative rate of
turning and whose impulse is an angular one, both by an `arm`, which makes of them what they are at any other point.
Across the normal the couple is at most b_r Σ λₙ long, about it at most b_s Σ λₙ; it opposes the turning, or holds it.
(Johnson 1985, "Contact Mechanics", chapter 9, for the lengths; the law is that of friction, so is the solve.)
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Array, Scalar
from jaxrb.math.safe import safe_sqrt

# Names the couple within its pair; no point has so great a number.
_FEATURE = 2**30


class Resistance(eqx.Module):
    """Of blocks (k,): `rolling`, `spinning` [m], and the `arm` [m], a length of the pair's own, that makes couples
    impulses and rates velocities."""

    rolling: Scalar
    spinning: Scalar
    arm: Scalar

    def bounds(self, load: Scalar) -> tuple[Scalar, Scalar]:
        """The greatest impulses (k,) [N s] across the normal and about it, under a load (k,) [N s]."""
        return self.rolling / self.arm * load, self.spinning / self.arm * load


def with_couples(contacts: Any, rolling: Scalar | None, spinning: Scalar | None) -> Any:
    """Contacts with a last slot for the couple of each block."""
    if rolling is None and spinning is None:
        return contacts
    none = jnp.zeros_like(contacts.distance[:, 0])
    far = jnp.sum(contacts.lever * contacts.lever, axis=-1)
    arm = safe_sqrt(jnp.max(jnp.where(contacts.active, far, 0.0), axis=1))
    resistance = Resistance(
        none if rolling is None else rolling.astype(none.dtype),
        none if spinning is None else spinning.astype(none.dtype),
        lax.stop_gradient(jnp.where(arm > 0, arm, 1.0)),
    )
    back = contacts.lever_back
    return eqx.tree_at(
        lambda c: (c.lever, c.lever_back, c.distance, c.active, c.feature, c.resistance),
        contacts,
        (
            _longer(contacts.lever, 0),
            None if back is None else _longer(back, 0),
            _longer(contacts.distance, 0),
            with_last(_longer(contacts.active, False), jnp.any(contacts.active, axis=1)),
            _longer(contacts.feature, _FEATURE),
            resistance,
        ),
        is_leaf=lambda leaf: leaf is None,
    )


def with_last(values: Array, last: Any) -> Array:
    """Slots (k, s, …) with the last one's put."""
    return values.at[:, -1].set(last)


def _longer(values: Array, last: Any) -> Array:
    after = [(0, 0), (0, 1)] + [(0, 0)] * (values.ndim - 2)
    return jnp.pad(values, after, constant_values=last)
