"""The distance of two shapes: which way is taken for which pair."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxrb.collision import closed_forms, cores, features
from jaxrb.collision.batch import search
from jaxrb.collision.boxes import contact_of_boxes
from jaxrb.collision.contact import Contact
from jaxrb.collision.stages import Found
from jaxrb.errors import WrongStructure
from jaxrb.geometry.primitives import Box, Capsule, Composite, HalfSpace, Pose, Sphere
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array
from jaxrb.math.kept import kept
from jaxrb.math.vector import matmul, matvec


def separation(shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose) -> Contact:
    """How far apart two shapes are, or how deep they overlap: a `Contact` in W.

    A pure function of one pair; `jax.jit`, `jax.vmap` and `jax.grad` apply to it, and a vmapped batch is computed as
    one however many axes are mapped over. It is exact up to round-off of the largest coordinate in the frame of one
    of the two shapes, never of world coordinates, and the answer of (b, a) is that of (a, b) with the sign of the
    normal changed, bit by bit.

    Ways: formulas for half-spaces, spheres, capsules, and box with sphere or box; for all others GJK where they are
    apart.
    Where polytopes overlap, branch and bound over arcs of normals gives their exact depth and proves it (`arcs.py`).
    Of smooth shapes that overlap (ellipsoid, cylinder, cone) the depth is a local minimum found from the best
    direction of inscribed polytopes; `upper` then is what these prove and `lower` what that direction proves, some
    per cent apart. A composite is the nearest of its parts: the depth is that of the deepest pair of parts.

    Derivatives: those of the nearest features (`features.py`), finite everywhere; where features tie, those of one.
    Second derivatives of the distance are exact; those of the normal and the points are so for polytopes only.

    Raises:
        WrongStructure: two half-spaces, a shape or pose of another type.
    """
    for name, shape, pose in (("a", shape_a, pose_a), ("b", shape_b, pose_b)):
        if not isinstance(shape, Shape) or not isinstance(pose, Pose):
            raise WrongStructure(
                f"separation: {name} is given as {type(shape).__name__} with {type(pose).__name__}, but must be a "
                "Shape with a Pose(position, orientation)"
            )
    return _separation(shape_a, pose_a, shape_b, pose_b)


@jax.jit
def _separation(shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose) -> Contact:
    """Compiled as one also where it is called on its own: loops would be compiled anew at each call."""
    if isinstance(shape_a, Composite):
        return closed_forms.composite(
            [_separation(s, pose_a.compose(p), shape_b, pose_b) for s, p in shape_a.parts]
        )
    if isinstance(shape_b, Composite):
        return closed_forms.composite(
            [_separation(shape_a, pose_a, s, pose_b.compose(p)) for s, p in shape_b.parts]
        )
    if isinstance(shape_a, HalfSpace) and isinstance(shape_b, HalfSpace):
        raise WrongStructure("separation: two half-spaces are no pair; both are without end and stand still")
    first, second = (shape_a, pose_a), (shape_b, pose_b)
    if type(shape_a) is not type(shape_b) or _sizes(shape_a) != _sizes(shape_b):
        if _rank(shape_a) > _rank(shape_b):
            return _ordered(*second, *first).flipped()
        return _ordered(*first, *second)
    # Of one type: the order must not depend on who is called a, so the numbers decide.
    swap = _comes_after(first, second)

    def chosen(x: Any, y: Any) -> Any:
        # Not faces and edges: the search looks at them for few pairs, and exchanges them itself.
        return jnp.where(swap, x, y) if _real(x) else y

    one, other = (jax.tree.map(chosen, p, q) for p, q in ((second, first), (first, second)))
    contact = _ordered(one[0], one[1], other[0], other[1], swap)
    return jax.tree.map(lambda x, y: jnp.where(swap, x, y), contact.flipped(), contact)


_ORDER = (HalfSpace, Box, Sphere, Capsule)


def _rank(shape: Shape) -> Any:
    place = _ORDER.index(type(shape)) if type(shape) in _ORDER else len(_ORDER)
    return (place, type(shape).__name__, _sizes(shape))


def _sizes(shape: Shape) -> Any:
    return [jnp.shape(leaf) for leaf in jax.tree.leaves(shape)]


def _comes_after(one: Any, other: Any) -> Array:
    """Whether the numbers of `one` come after those of `other` in lexical order."""
    parts = []
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other)):
        x, y = jax.lax.stop_gradient((jnp.asarray(x), jnp.asarray(y)))
        parts.append(jnp.sign(x - y).ravel())
    signs = jnp.concatenate([part.astype(jnp.int8) for part in parts])
    return signs[jnp.argmax(signs != 0)] > 0


def _ordered(shape_a: Shape, pose_a: Pose, shape_b: Shape, pose_b: Pose, swap: Any = False) -> Contact:
    """The contact of a pair in the one order that its types have. Where `swap`, faces and edges are each other's."""
    dtype = jnp.result_type(*(x for x in jax.tree.leaves((shape_a, pose_a, shape_b, pose_b)) if _real(x)))
    shape_a, pose_a, shape_b, pose_b = jax.tree.map(
        lambda x: jnp.asarray(x, dtype) if _real(x) else jnp.asarray(x), (shape_a, pose_a, shape_b, pose_b)
    )
    turn_a, turn_b = pose_a.orientation.as_matrix(), pose_b.orientation.as_matrix()
    rotation = matmul(turn_a.T, turn_b)
    translation = matvec(turn_a.T, pose_b.position - pose_a.position)
    contact = _in_frame_of_a(shape_a, shape_b, rotation, translation, swap)
    contact = contact.grown(shape_a.rounding, shape_b.rounding)
    return Contact(
        contact.distance,
        matvec(turn_a, contact.normal),
        pose_a.position + matvec(turn_a, contact.point_a),
        pose_a.position + matvec(turn_a, contact.point_b),
        contact.lower,
        contact.upper,
    )


def _real(x: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(x), jnp.inexact)


def _in_frame_of_a(shape_a: Shape, shape_b: Shape, rotation: Array, translation: Array, swap: Any) -> Contact:
    """The contact of the cores."""
    if isinstance(shape_a, HalfSpace):
        return closed_forms.plane_and_core(shape_a, shape_b, rotation, translation)
    if isinstance(shape_a, Box) and isinstance(shape_b, Sphere):
        return closed_forms.sphere_and_box(shape_a, translation)
    if isinstance(shape_a, (Sphere, Capsule)) and isinstance(shape_b, (Sphere, Capsule)):
        half_a, half_b = (closed_forms.segment_of(shape) for shape in (shape_a, shape_b))
        return closed_forms.segments(half_a, half_b, rotation[:, 2], translation)
    if isinstance(shape_a, Box) and isinstance(shape_b, Box):
        return contact_of_boxes(shape_a, shape_b, rotation, translation)
    found = kept(search(shape_a, shape_b, rotation, translation, swap))
    sides = []
    for k, (shape, r, t) in enumerate(((shape_a, None, None), (shape_b, rotation, translation))):
        side = _polytope_side if cores.is_polytope(shape) else _smooth_side
        sides.append(side(shape, r, t, found, k))
    if all(cores.is_polytope(shape) for shape in (shape_a, shape_b)):
        corners = [side.points for side in sides]
        parts = features.of_polytopes(found.distance, found.normal, found.weights, *corners)
    else:
        parts = features.of_smooth(found.distance, found.normal, found.weights, *sides)
    distance, normal, point_a, point_b = parts
    return Contact(distance, normal, point_a, point_b, found.lower, found.upper)


def _polytope_side(shape: Shape, r: Array | None, t: Array | None, found: Found, k: int) -> features.Side:
    own = cores.corners(shape)[found.numbers[:, k]]
    return features.Side(own if r is None else own @ r.T + t, None)


def _smooth_side(shape: Shape, r: Array | None, t: Array | None, found: Found, k: int) -> features.Side:
    """The nearest points as points of the material, and the support point along a direction in a's frame."""
    stretch = cores.stretches(shape)
    frozen = found.points[k] if r is None or t is None else (found.points[k] - t) @ r
    material = stretch * jax.lax.stop_gradient(frozen / stretch)
    if r is None or t is None:
        return features.Side(material, shape.support)
    return features.Side(material @ r.T + t, lambda n: shape.support(n @ r) @ r.T + t)
