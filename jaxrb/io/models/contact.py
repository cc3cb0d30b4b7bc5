"""Contact from a compiled model: who may touch whom, and with what friction."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.geometry.primitives import HalfSpace, Pose
from jaxrb.io.models.bodies import Placed, colliding, name_of
from jaxrb.io.models.survey import Finding, Survey
from jaxrb.math.quaternion import Quaternion

# From which dimension of contact on each of MuJoCo's three numbers of friction counts, and its name here.
_COEFFICIENTS = ((1, "friction"), (4, "spinning_resistance"), (6, "rolling_resistance"))
_MOST_SORTS = 62  # bits of a whole number that masks can use


class _Side(NamedTuple):
    """What decides on a contact, of a geom or of all geoms of a body. `bodies`: of the model."""

    contype: int
    conaffinity: int
    condim: int
    friction: tuple[float, float, float]
    bodies: frozenset[int]


def contacts_of(
    answer: Mapping[str, Any], movers: Sequence[int], shapes: Sequence[Placed], survey: Survey
) -> tuple[list[RigidContact], list[Finding]]:
    """The effects that let bodies touch as the model says, and what they leave out.

    MuJoCo lets two geoms touch where one's contype shares a bit with the other's conaffinity, and takes the larger
    friction and the larger `condim` of the two.
    """
    if not answer["contact"]:
        return [], []
    findings: list[Finding] = []
    geoms = [g for g, geom in enumerate(answer["geoms"]) if colliding(geom)]
    sides: dict[int, _Side] = {}
    for number, mover in enumerate(movers):
        own = [g for g in geoms if answer["bodies"][answer["geoms"][g]["body"]]["carrier"] == mover]
        if own:
            sides[number] = _side(answer, mover, own, survey, findings)
    still = [g for g in geoms if answer["bodies"][answer["geoms"][g]["body"]]["carrier"] == 0]
    banned = _banned(answer, geoms, survey, findings)
    standing = {g: _of_geoms(answer, [g]) for g in still}
    effects = _against_still(sides, standing, shapes, banned, len(movers))
    effects += _between(answer, sides, banned, len(movers), survey, findings)
    dimensions = {side.condim for side in (*sides.values(), *standing.values())}
    if effects and 1 in dimensions and len(dimensions) > 1:
        findings.append(
            Finding(
                survey.file.name,
                0,
                "geom@condim",
                "contact is with friction for all geoms or for none; 3 was taken",
            )
        )
    if dimensions == {1}:
        effects = [_frictionless(effect) for effect in effects]
    return effects, findings


def _banned(
    answer: Mapping[str, Any], geoms: Sequence[int], survey: Survey, findings: list[Finding]
) -> set[frozenset[int]]:
    """Pairs of bodies of the model that an exclude keeps apart."""
    solid = {answer["geoms"][g]["body"] for g in geoms}
    carrier = [body["carrier"] for body in answer["bodies"]]
    for pair in answer["excludes"]:
        for body in pair:
            if carrier[body] and len({i for i in solid if carrier[i] == carrier[body]} | {body}) > 1:
                why = f"of {name_of(answer, carrier[body])} all parts are excluded, since they are one body"
                findings.append(Finding(survey.file.name, 0, f"exclude[{name_of(answer, body)}]", why))
    return {frozenset(pair) for pair in answer["excludes"]}


def _of_geoms(answer: Mapping[str, Any], geoms: Sequence[int]) -> _Side:
    first = answer["geoms"][geoms[0]]
    bodies = frozenset(answer["geoms"][g]["body"] for g in geoms)
    return _Side(first["contype"], first["conaffinity"], first["condim"], tuple(first["friction"]), bodies)


def _side(
    answer: Mapping[str, Any], mover: int, own: Sequence[int], survey: Survey, findings: list[Finding]
) -> _Side:
    name = name_of(answer, mover)
    different = {_of_geoms(answer, [g])[:4] for g in own}
    if len(different) > 1:
        why = "its geoms differ in contype, conaffinity, condim or friction; contact knows one set a body"
        findings.append(Finding(*survey.place("body", name), f"body[{name}]", why))
    return _of_geoms(answer, own)


def _may_touch(a: _Side, b: _Side, banned: set[frozenset[int]]) -> bool:
    meets = (a.contype & b.conaffinity) | (b.contype & a.conaffinity)
    return bool(meets) and not any(frozenset((i, j)) in banned for i in a.bodies for j in b.bodies)


def _against_still(
    sides: Mapping[int, _Side],
    standing: Mapping[int, _Side],
    shapes: Sequence[Placed],
    banned: set[frozenset[int]],
    count: int,
) -> list[RigidContact]:
    """What stands still, together where the same bodies touch it with the same friction."""
    together: dict[Any, list[int]] = {}
    for g, side in standing.items():
        touching = tuple(i for i, mover in sides.items() if _may_touch(mover, side, banned))
        if touching:
            together.setdefault((touching, side.condim, side.friction), []).append(g)
    effects = []
    for (touching, *_), members in together.items():
        effects.append(
            RigidContact(
                tuple(_obstacle(shapes[g]) for g in members),
                bodies=_some(touching, count),
                **_coefficients(sides, touching, count, standing[members[0]]),
            )
        )
    return effects


def _obstacle(placed: Placed) -> Any:
    shape, position, turn = placed
    return shape if isinstance(shape, HalfSpace) else (shape, Pose(position, Quaternion(turn)))


def _between(
    answer: Mapping[str, Any],
    sides: Mapping[int, _Side],
    banned: set[frozenset[int]],
    count: int,
    survey: Survey,
    findings: list[Finding],
) -> list[RigidContact]:
    """The movers with each other. Those that treat all others alike share a bit."""
    numbers = tuple(sides)
    allowed = np.array(
        [[_may_touch(sides[i], sides[j], banned) for j in numbers] for i in numbers], bool
    ).reshape(len(numbers), len(numbers))
    pairs = allowed & ~np.eye(len(numbers), dtype=bool)
    if not pairs.any():
        return []
    # A side is allowed to touch its own kind or not; two bodies of one kind have equal rows with that on the diagonal.
    _, sort = np.unique(allowed, axis=0, return_inverse=True)
    sort = sort.ravel()
    if sort.max() >= _MOST_SORTS:
        why = f"more than {_MOST_SORTS} sorts of who may touch whom; all were let touch"
        findings.append(Finding(survey.file.name, 0, "geom@contype", why))
        allowed, sort = np.ones_like(allowed), np.zeros_like(sort)
    options: dict[str, Any] = {}
    if not allowed.all():
        groups, masks = np.zeros(count, int), np.zeros(count, int)
        for row, i in enumerate(numbers):
            groups[i] = 1 << int(sort[row])
            masks[i] = sum(1 << k for k in {int(s) for s in sort[allowed[row]]})
        options = {"groups": tuple(groups.tolist()), "masks": tuple(masks.tolist())}
    if len({max(side.condim, 3) for side in sides.values()}) > 1:
        why = (
            "bodies of different condim meet; each was given what its own asks for, not the larger of the two"
        )
        findings.append(Finding(survey.file.name, 0, "geom@condim", why))
    options |= _coefficients(sides, numbers, count, None)
    return [RigidContact(None, bodies=_some(numbers, count), combine="larger", **options)]


def _coefficients(
    sides: Mapping[int, _Side], touching: Sequence[int], count: int, other: _Side | None
) -> dict[str, Any]:
    """Friction and resistances of the movers that touch, against an `other` that stands still or each its own."""
    found = {}
    for k, (least, name) in enumerate(_COEFFICIENTS):
        values = np.zeros(count)
        for i in touching:
            pair = [sides[i]] if other is None else [sides[i], other]
            if max(side.condim for side in pair) >= least:
                values[i] = max(side.friction[k] for side in pair)
        chosen = values[list(touching)]
        if least == 1 or chosen.any():
            found[name] = float(chosen[0]) if np.ptp(chosen) == 0 else values
    return found


def _some(touching: Sequence[int], count: int) -> tuple[int, ...] | None:
    return None if len(touching) == count else tuple(touching)


def _frictionless(effect: RigidContact) -> RigidContact:
    return RigidContact(
        effect.against, bodies=effect.bodies, groups=effect.groups, masks=effect.masks, combine=effect.combine
    )
