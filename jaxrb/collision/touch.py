"""Points of contact of a pair of shapes at once, by closed forms where there are any: what a contact solver asks for.

`separation` finds the distance of any two shapes and proves it, by loops that take seconds to compile; `manifold` then
lays faces over each other. A solver of many bodies needs the points of a few simple pairs, fast; they are found here
without looking for the distance first.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxrb.collision.manifold import Manifold
from jaxrb.collision.touch_boxes import touch_boxes
from jaxrb.collision.touch_plane import STANDING, touch_plane
from jaxrb.collision.touch_round import touch_box_capsule, touch_box_sphere, touch_cores
from jaxrb.errors import WrongStructure
from jaxrb.geometry.primitives import Box, Capsule, Composite, HalfSpace, Pose, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import stack

# Number of points and way of each pair of kinds in its one order; those with a half-space apart.
_WAYS: dict[tuple[type, type], tuple[int, Callable[..., Manifold]]] = {
    (Sphere, Sphere): (1, touch_cores),
    (Sphere, Capsule): (1, touch_cores),
    (Capsule, Capsule): (2, touch_cores),
    (Box, Sphere): (1, touch_box_sphere),
    (Box, Capsule): (2, touch_box_capsule),
    (Box, Box): (4, touch_boxes),
}
_OTHERS = 4


def contact_points(shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose) -> Manifold:
    """All points in which two shapes touch or would touch if they came nearer. One pair; `vmap` for pairs and worlds.

    A `Manifold` of `slots(shape_a, shape_b)` points, near or far: the caller takes those whose distance it cares for.
    The answer of (b, a) for shapes of unlike kinds is that of (a, b) with the normal turned round. Floating type: that
    of the poses. Everything is reckoned in the frame of one of the two; only the last sum is in world coordinates.

    Closed forms: half-spaces with every shape, spheres and capsules among themselves and with boxes, boxes. For all
    others `separation` and `manifold`, which compile for seconds. A composite on a half-space gives the points of all
    its parts; elsewhere those of the pair of parts that is nearest, since a manifold has one normal: to stand on
    several parts at once, ask for the pairs of parts.

    Derivatives are finite everywhere; where features tie they are those of one. The distances follow
    d(distance) = n · (dp_b − dp_a) for translations.

    Raises:
        WrongStructure: two half-spaces, a shape or pose of another type.
    """
    for name, shape, pose in (("a", shape_a, pose_a), ("b", shape_b, pose_b)):
        if not isinstance(shape, Shape) or not isinstance(pose, Pose):
            raise WrongStructure(
                f"contact_points: {name} is given as {type(shape).__name__} with {type(pose).__name__}, but must be a "
                "Shape with a Pose(position, orientation)"
            )
    dtype = jnp.result_type(*(x for x in jax.tree.leaves((pose_a, pose_b))))

    def of_one_type(x: Any) -> Any:
        return jnp.asarray(x, dtype) if jnp.issubdtype(jnp.result_type(x), jnp.inexact) else x

    return _touching(*jax.tree.map(of_one_type, (shape_a, pose_a, shape_b, pose_b)))


def slots(shape_a: Shape, shape_b: Shape) -> int:
    """How many points `contact_points` gives for two shapes, valid or not.

    Raises:
        WrongStructure: two half-spaces.
    """
    if isinstance(shape_b, HalfSpace):
        if isinstance(shape_a, HalfSpace):
            raise WrongStructure(
                "contact_points: two half-spaces are no pair; both are without end and stand still"
            )
        shape_a, shape_b = shape_b, shape_a
    if isinstance(shape_b, Composite):
        each = [slots(shape_a, part) for part, _ in shape_b.parts]
        return sum(each) if isinstance(shape_a, HalfSpace) else max(each)
    if isinstance(shape_a, Composite):
        return max(slots(part, shape_b) for part, _ in shape_a.parts)
    if isinstance(shape_a, HalfSpace):
        return STANDING.get(type(shape_b), _OTHERS)
    one, other = type(shape_a), type(shape_b)
    return next((_WAYS[k][0] for k in ((one, other), (other, one)) if k in _WAYS), _OTHERS)


def _touching(shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose) -> Manifold:
    count = slots(shape_a, shape_b)
    if isinstance(shape_b, HalfSpace) or _comes_second(shape_a, shape_b):
        turned = _touching(shape_b, pose_b, shape_a, pose_a)
        return turned._replace(normal=-turned.normal)
    if isinstance(shape_a, Composite):
        parts = [_touching(s, pose_a.compose(p), shape_b, pose_b) for s, p in shape_a.parts]
        return _nearest(parts, count)
    if isinstance(shape_b, Composite):
        parts = [_touching(shape_a, pose_a, s, pose_b.compose(p)) for s, p in shape_b.parts]
        return _side_by_side(parts) if isinstance(shape_a, HalfSpace) else _nearest(parts, count)
    if isinstance(shape_a, HalfSpace) and type(shape_b) in STANDING:
        return touch_plane(shape_a, pose_a, shape_b, pose_b)
    if (type(shape_a), type(shape_b)) in _WAYS:
        return _WAYS[type(shape_a), type(shape_b)][1](shape_a, pose_a, shape_b, pose_b)
    return _searched(shape_a, pose_a, shape_b, pose_b)


def _comes_second(shape_a: Shape, shape_b: Shape) -> bool:
    kinds = (type(shape_a), type(shape_b))
    return kinds not in _WAYS and kinds[::-1] in _WAYS


def _searched(shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose) -> Manifold:
    # Only here: what loads and compiles the search is not paid for by those who do not need it.
    from jaxrb.collision.manifold import manifold
    from jaxrb.collision.narrowphase import separation

    contact = separation(shape_a, pose_a, shape_b, pose_b)
    return manifold(contact, shape_a, pose_a, shape_b, pose_b, capacity=_OTHERS, margin=jnp.inf)


def _named(parts: list[Manifold]) -> list[Manifold]:
    """With the number of the part in the names of its points."""
    count = len(parts)
    return [
        part._replace(feature=jnp.where(part.valid, part.feature * count + k, -1))
        for k, part in enumerate(parts)
    ]


def _side_by_side(parts: list[Manifold]) -> Manifold:
    """The points of parts that all have one normal."""
    parts = _named(parts)
    joined = {
        name: jnp.concatenate([getattr(part, name) for part in parts])
        for name in ("position", "distance", "feature", "valid")
    }
    overflow = jnp.any(stack(*(part.overflow for part in parts)))
    return Manifold(normal=parts[0].normal, overflow=overflow, **joined)


def _nearest(parts: list[Manifold], count: int) -> Manifold:
    """The points of the part that has the nearest one, in `count` slots."""
    best: Any = None
    reach: Any = None
    for part in _named(parts):
        more = count - len(part.valid)
        padded = part._replace(
            position=jnp.pad(part.position, ((0, more), (0, 0))),
            distance=jnp.pad(part.distance, (0, more)),
            feature=jnp.pad(part.feature, (0, more), constant_values=-1),
            valid=jnp.pad(part.valid, (0, more)),
        )
        near = jnp.min(jnp.where(part.valid, part.distance, jnp.inf))
        if best is None:
            best, reach = padded, near
            continue
        closer = near < reach
        best = jax.tree.map(lambda x, y, closer=closer: jnp.where(closer, x, y), padded, best)
        reach = jnp.where(closer, near, reach)
    return best
