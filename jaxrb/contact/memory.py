"""What the contacts of one step leave to the next, so that its solve starts from what it knows."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxrb.contact.block import Contacts
from jaxrb.contact.surfaces import Meeting, Obstacle
from jaxrb.math.arrays import Array


class Memory(eqx.Module):
    """What the contacts of a step leave to the next, a tuple entry for each group of blocks.

    `pair` (k,): which pair of the group a block was, −1 none; ascending. `feature` (k, s) and `impulse` (k, s, 3).
    """

    pair: tuple[Array, ...]
    feature: tuple[Array, ...]
    impulse: tuple[Array, ...]


def first_memory(
    obstacles: tuple[Obstacle, ...], meetings: tuple[Meeting, ...], slots: int, dtype: Any
) -> Memory:
    """The memory of no contact."""
    sizes = [len(obstacle.members) for obstacle in obstacles] + [meeting.touching for meeting in meetings]
    return Memory(
        tuple(jnp.full(size, -1, jnp.int32) for size in sizes),
        tuple(jnp.full((size, slots), -1, jnp.int32) for size in sizes),
        tuple(jnp.zeros((size, slots, 3), dtype) for size in sizes),
    )


def recalled(contacts: Contacts, chosen: Sequence[Array], memory: Memory) -> Array:
    """The impulse that each point had in the last step: that of the same feature of the same pair, else zero."""
    parts, at = [], 0
    for now, then, feature, impulse in zip(chosen, memory.pair, memory.feature, memory.impulse, strict=True):
        own = contacts.feature[at : at + len(now)]
        at += len(now)
        row = jnp.clip(
            jnp.searchsorted(jnp.where(then < 0, jnp.iinfo(jnp.int32).max, then), now), 0, len(then) - 1
        )
        same_pair = (then[row] == now) & (now >= 0)
        same = (
            (own[:, :, None] == feature[row][:, None, :]) & same_pair[:, None, None] & (own >= 0)[:, :, None]
        )
        parts.append(jnp.sum(jnp.where(same[..., None], impulse[row][:, None], 0.0), axis=2))
    return jnp.concatenate(parts)


def remembered(contacts: Contacts, chosen: tuple[Array, ...], impulse: Array) -> Memory:
    """What to leave to the next step."""
    feature, impulses, at = [], [], 0
    for pair in chosen:
        rows = slice(at, at + len(pair))
        feature.append(contacts.feature[rows])
        impulses.append(impulse[rows])
        at += len(pair)
    return Memory(chosen, tuple(feature), tuple(impulses))
