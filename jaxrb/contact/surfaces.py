"""What of a scene may touch, known when a program is traced: shapes by kind, and which pairs of kinds there are."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.body.body import Body, count_of, freedoms_of
from jaxrb.body.freedom import FIXED
from jaxrb.effects.effect import Effect
from jaxrb.effects.fixed_point import FixedPoint
from jaxrb.effects.prescribed_motion import PrescribedMotion
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.effects.surfaces import Kind, kinds_of
from jaxrb.errors import WrongStructure
from jaxrb.geometry.bounds import bounding_box
from jaxrb.geometry.primitives import Pose
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Scalar
from jaxrb.math.safe import norm

# Pairs a body, half of its neighbours: of spheres none has more than 12, boxes in a pile have 4 to 6.
_NEAR, _TOUCHING = 6, 3
# More bodies than these that meet each other are a crowd. The sparse solve is the faster for any number (100 in a box:
# 0.7 ms a step, Newton 157), but ends at some per cent where Newton ends at 1e-4: piles of some hundreds keep that.
_CROWD = 400


class Obstacle(eqx.Module):
    """Bodies of one kind against one shape that stands still."""

    rule: int = eqx.field(static=True)
    kind: int = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)
    shape: Shape
    pose: Pose | None


@dataclasses.dataclass(frozen=True, eq=False)
class Meeting:
    """Bodies of one kind against bodies of another, or of the same: all pairs (first, second) that may ever touch.

    `capacity`: how many of them may be near each other at a time, and `touching` of these touch; all of them where that
    is fewer.
    """

    rule: int
    kinds: tuple[int, int]
    first: np.ndarray
    second: np.ndarray
    capacity: int
    touching: int

    @property
    def crowded(self) -> bool:
        """Whether the pairs are chosen at run time."""
        return len(self.first) > self.capacity


def contact_of(bodies: tuple[Body, ...], effects: tuple[Effect, ...]) -> Any:
    """What resolves a scene's contacts, or None where no effect asks for any."""
    rules = tuple(effect for effect in effects if isinstance(effect, RigidContact))
    if not rules:
        return None
    from jaxrb.contact.step import ContactStep  # only scenes with contact load the collision floor

    if any(isinstance(effect, FixedPoint) for effect in effects):
        raise WrongStructure(
            "Scene.effects: FixedPoint with RigidContact is not supported; hold the point by "
            "BallJoint(bodies=(body, None)) instead"
        )
    count = sum(count_of(body) or 1 for body in bodies)
    kinds = kinds_of("RigidContact", bodies, {i for rule in rules for i in rule.chosen(count)})
    sparse, apart = _sparse(rules, count), _together(effects)
    still = _still(bodies, effects)
    obstacles, meetings, crowds = [], [], []
    for number, rule in enumerate(rules):
        chosen = set(rule.chosen(count))
        own = [(k, tuple(m for m in kind.members if m in chosen)) for k, kind in enumerate(kinds)]
        own = [(k, members) for k, members in own if members]
        if rule.against is None and sparse:
            from jaxrb.contact.crowd import crowd_of

            _check_unjoined(effects)
            _check_resists_nothing(rule)
            crowds += [crowd_of(number, rule, own)] if own else []
        elif rule.against is None:
            meetings += _meetings(number, rule, own, count, still, frozenset() if rule.joined else apart)
        for shape, pose in rule.against or ():
            moving = [(k, tuple(m for m in members if m not in still)) for k, members in own]
            obstacles += [Obstacle(number, k, members, shape, pose) for k, members in moving if members]
    if not obstacles and not meetings and not crowds:
        return None
    return ContactStep(
        rules, tuple(kinds), tuple(obstacles), _radii(kinds, count), tuple(meetings), tuple(crowds), count
    )


def _still(bodies: tuple[Body, ...], effects: tuple[Effect, ...]) -> frozenset[int]:
    """The bodies that no impulse moves."""
    fixed = {i for i, freedom in enumerate(freedoms_of(bodies)) if freedom == FIXED}
    return frozenset(fixed | {effect.body for effect in effects if isinstance(effect, PrescribedMotion)})


def _together(effects: tuple[Effect, ...]) -> frozenset[tuple[int, int]]:
    """Pairs (lower, higher) of bodies that a joint holds together."""
    joints: list[Any] = [effect for effect in effects if effect.joins]
    pairs = [pair for joint in joints if joint.bodies[1] is not None for pair in joint.pairs(-1).tolist()]
    return frozenset((min(a, b), max(a, b)) for a, b in pairs)


def _check_unjoined(effects: tuple[Effect, ...]) -> None:
    joints = [effect for effect in effects if effect.joins]
    if joints:
        raise WrongStructure(
            f"RigidContact beside {type(joints[0]).__name__}: the sparse solve of a crowd does not know joints; ask "
            "for solver='newton', or let fewer bodies meet each other (bodies=…)"
        )


def _check_resists_nothing(rule: RigidContact) -> None:
    if rule.resists:
        raise WrongStructure(
            "RigidContact.rolling_resistance, spinning_resistance: the sparse solve of a crowd does not know them; ask "
            "for solver='newton', or use rb.CompliantContact"
        )


def _sparse(rules: tuple[RigidContact, ...], count: int) -> bool:
    """Whether the bodies that meet each other are a crowd."""
    mutual = [rule for rule in rules if rule.against is None]
    asked = {rule.solver for rule in mutual if rule.solver is not None}
    if len(asked) > 1:
        raise WrongStructure(
            "RigidContact.solver: rules of one scene ask for both newton and sparse; they are solved together: give one"
        )
    if asked:
        return asked == {"sparse"}
    return max((len(rule.chosen(count)) for rule in mutual), default=0) > _CROWD


def _radii(kinds: list[Kind], count: int) -> Scalar:
    """Of balls (count,) [m] about the centres of mass that hold the shapes."""
    radii = jnp.zeros(count)
    for kind in kinds:
        box = jax.vmap(bounding_box)(kind.shape)
        far = jnp.maximum(jnp.abs(box.low - kind.center), jnp.abs(box.high - kind.center))
        radii = radii.at[np.asarray(kind.members)].set(norm(far))
    return radii


def _meetings(
    number: int,
    rule: RigidContact,
    own: list[tuple[int, tuple[int, ...]]],
    count: int,
    still: frozenset[int],
    apart: frozenset[tuple[int, int]],
) -> list[Meeting]:
    """The pairs of kinds that a rule lets touch, but for those of two that stand `still`, and those (lower, higher)
    that are kept `apart`."""
    together = []
    for at, (k, members) in enumerate(own):
        for other, others in own[at:]:
            first, second = (side.ravel() for side in np.meshgrid(members, others, indexing="ij"))
            chosen = rule.may_touch(first, second) & ((first < second) | (k != other))
            if still:
                chosen &= [i not in still or j not in still for i, j in zip(first.tolist(), second.tolist())]
            if apart:
                chosen &= [
                    (min(i, j), max(i, j)) not in apart for i, j in zip(first.tolist(), second.tolist())
                ]
            if chosen.any():
                together.append((k, other, np.stack([first[chosen], second[chosen]], 1).astype(np.int32)))
    total = sum(len(pairs) for *_, pairs in together)
    near = min(total, rule.capacity or _NEAR * count)
    touching = min(total, rule.capacity or _TOUCHING * count)
    return [
        Meeting(
            number, (k, other), pairs[:, 0], pairs[:, 1], min(len(pairs), near), min(len(pairs), touching)
        )
        for k, other, pairs in together
    ]
