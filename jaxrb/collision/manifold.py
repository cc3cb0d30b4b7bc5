"""Where two shapes touch: not one point but the outline of the common face, as a rigid contact needs it.

The face of a that looks most at b and the face of b that looks most at a are laid over each other; the corners of what
they have in common, each with its own distance, are the manifold. Every point is named by the corners and edges that
make it, so that a solver finds it again in the next step.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxrb.collision.contact import Contact
from jaxrb.collision.faces import Face, face_along, padded, placed
from jaxrb.errors import WrongStructure
from jaxrb.geometry.primitives import HalfSpace, Pose
from jaxrb.geometry.shape import Shape
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import divide, unit_or
from jaxrb.math.vector import cross, dot

# A face is in contact where its normal differs from the contact's by less: 1 − cos of 0.8°. Elsewhere an edge crosses
# an edge, and one point is all there is.
_FLAT = 1e-4
# Of two faces equally parallel the first is the reference, and stays it while the other is no better than by this.
_PREFERENCE = 1e-3


class Manifold(NamedTuple):
    """Up to `capacity` points of contact of one pair of shapes.

    * `position` (capacity, 3) [m] in W, midway between the two surfaces.
    * `normal` (3,): unit vector from a to b in W, the same for all points.
    * `distance` (capacity,) [m] along it: negative where they overlap; the depth is −distance.
    * `feature` (capacity,): whole number that names corner or edges; the same point in the next step has the same.
    * `valid` (capacity,): which points there are. `overflow`: a face had more edges than could be looked at.
    """

    position: Array
    normal: Vector
    distance: Array
    feature: Array
    valid: Array
    overflow: Array


def manifold(
    contact: Contact,
    shape_a: Shape,
    pose_a: Pose,
    shape_b: Shape,
    pose_b: Pose,
    *,
    capacity: int = 4,
    margin: Scalar = 0.0,
) -> Manifold:
    """The points of contact of two shapes whose nearest points are known (`separation`). One pair; `vmap` for many.

    Boxes and hulls among themselves and on half-spaces, capsules lying on them; for all other pairs, and where an edge
    crosses an edge, the one point midway between the nearest points.

    Args:
        capacity: most points; of more the deepest is kept, then always the one farthest from those kept.
        margin: points farther apart than this [m] are left out, so that contacts may be known before they close.
    """
    if capacity < 1:
        raise WrongStructure(f"manifold: capacity is {capacity}, but must be at least 1")
    if isinstance(shape_b, HalfSpace):
        turned = manifold(
            contact.flipped(), shape_b, pose_b, shape_a, pose_a, capacity=capacity, margin=margin
        )
        return turned._replace(normal=-turned.normal)
    lone = _nearest_only(contact, capacity, margin)
    toward_b = _seen_by(pose_b, -contact.normal)
    other = face_along(shape_b, toward_b)
    if other is None:
        return lone
    if isinstance(shape_a, HalfSpace):
        return _on_plane(contact, other, shape_b, pose_b, capacity, margin)
    own = face_along(shape_a, _seen_by(pose_a, contact.normal))
    if own is None:
        return lone
    middle = 0.5 * (contact.point_a + contact.point_b)
    own, other = placed(own, pose_a, middle), placed(other, pose_b, middle)
    second = other.alignment > own.alignment + _PREFERENCE
    reference, incident = (
        Face(*(jnp.where(second, x, y) for x, y in zip(padded(p, k), padded(q, k))))
        for k in [max(len(own.there), len(other.there))]
        for p, q in ((other, own), (own, other))
    )
    rounding = jnp.asarray(shape_a.rounding) + jnp.asarray(shape_b.rounding)
    # Capsules are rounded on one side only; the point midway shifts by half of the difference.
    shift = (
        0.5 * (jnp.asarray(shape_a.rounding) - jnp.asarray(shape_b.rounding)) * jnp.where(second, -1.0, 1.0)
    )
    points, heights, names, found = _common_outline(reference, incident)
    heights = heights - rounding
    # Beyond a thousand faces names may repeat; a solver then starts from a neighbour's force, no more.
    faces = (2 * (reference.number * 1024 + incident.number) + second).astype(jnp.int32)
    names = faces * len(names) + names
    near = found & (heights <= margin)
    kept, valid = _spread(points, heights, near, capacity)
    halfway = points[kept] + (shift - 0.5 * (heights[kept] + rounding))[:, None] * reference.normal
    normal = jnp.where(second, -reference.normal, reference.normal)
    whole = Manifold(
        jnp.where(valid[:, None], halfway + middle, 0.0),
        normal,
        jnp.where(valid, heights[kept], 0.0),
        jnp.where(valid, names[kept], -1),
        valid,
        own.overflow | other.overflow,
    )
    flat = (reference.alignment > 1.0 - _FLAT) & valid[0]
    return Manifold(*(jnp.where(flat, x, y) for x, y in zip(whole, lone)))


def _nearest_only(contact: Contact, capacity: int, margin: Scalar) -> Manifold:
    first = jnp.arange(capacity) == 0
    near = first & (contact.distance <= margin)
    middle = 0.5 * (contact.point_a + contact.point_b)
    return Manifold(
        jnp.where(near[:, None], middle, 0.0),
        contact.normal,
        jnp.where(near, contact.distance, 0.0),
        jnp.where(near, 0, -1).astype(jnp.int32),
        near,
        jnp.zeros((), bool),
    )


def _on_plane(
    contact: Contact,
    face: Face,
    shape: Shape,
    pose: Pose,
    capacity: int,
    margin: Scalar,
) -> Manifold:
    """The corners of the face that lie within the half-space or near it; those of other faces lie higher."""
    normal = contact.normal
    lying = placed(face, pose, contact.point_a)
    rounding = jnp.asarray(shape.rounding)
    heights = lying.start @ normal - rounding
    near = lying.there & (heights <= margin)
    kept, valid = _spread(lying.start, heights, near, capacity)
    points = lying.start[kept] - (rounding + 0.5 * heights[kept])[:, None] * normal
    names = face.corner[kept].astype(jnp.int32)
    return Manifold(
        jnp.where(valid[:, None], points + contact.point_a, 0.0),
        normal,
        jnp.where(valid, heights[kept], 0.0),
        jnp.where(valid, names, -1),
        valid,
        face.overflow,
    )


def _common_outline(reference: Face, incident: Face) -> tuple[Array, Array, Array, Array]:
    """Corners (m, 3) of what two convex faces share, seen along the normal of the first, with the heights (m,) of the
    second above it, a name for each (m,) and which there are (m,).
    """
    normal, k = reference.normal, len(reference.there)
    inward, inward_b = (
        cross(jnp.broadcast_to(normal, face.start.shape) * sign, face.end - face.start)
        for face, sign in ((reference, 1.0), (incident, jnp.sign(dot(incident.normal, normal))))
    )
    size = jnp.max(jnp.abs(jnp.where(reference.there[:, None], reference.end - reference.start, 0.0)))
    slack = 16 * jnp.finfo(size.dtype).eps * size * size

    def within(points: Array, corners: Array, normals: Array, there: Array) -> Array:
        sides = jnp.einsum("ej,pej->pe", normals, points[:, None] - corners)
        return jnp.all((sides >= -slack) | ~there, axis=1)

    plane = reference.start[0]
    corners = incident.start
    corners_in = incident.there & within(corners, reference.start, inward, reference.there)
    # A corner of the reference face, lifted along its normal to the incident face.
    lift = divide(
        jnp.einsum("pj,j->p", incident.start[0] - reference.start, incident.normal),
        dot(normal, incident.normal),
    )
    lifted = reference.start + lift[:, None] * normal
    lifted_in = reference.there & within(lifted, incident.start, inward_b, incident.there)
    # The point of each incident edge above each reference edge.
    along = incident.end - incident.start
    reach = jnp.einsum("ej,iej->ie", inward, reference.start - incident.start[:, None])
    rate = jnp.einsum("ej,ij->ie", inward, along)
    t = divide(reach, rate)
    crossing = incident.start[:, None] + t[..., None] * along[:, None]
    edge = reference.end - reference.start
    s = jnp.einsum("ej,iej->ie", edge, crossing - reference.start) / jnp.sum(
        jnp.where(reference.there[:, None], edge * edge, 1.0 / 3.0), axis=1
    )
    cross_in = (rate != 0) & (t >= 0) & (t <= 1) & (s >= 0) & (s <= 1)
    cross_in &= incident.there[:, None] & reference.there[None]
    points = jnp.concatenate([corners, lifted, crossing.reshape(-1, 3)])
    found = jnp.concatenate([corners_in, lifted_in, cross_in.ravel()])
    return points, (points - plane) @ normal, jnp.arange(2 * k + k * k, dtype=jnp.int32), found


def _spread(points: Array, heights: Array, near: Array, capacity: int) -> tuple[Array, Array]:
    """Numbers (capacity,) of the deepest point and then of those farthest from all before, and which there are."""
    lowest = jnp.argmin(jnp.where(near, heights, jnp.inf))
    kept, valid = [lowest], [near[lowest]]
    apart = jnp.where(near, jnp.sum((points - points[lowest]) ** 2, axis=1), -1.0)
    # Points of one place are one: a corner on an edge is found as corner and as crossing.
    same = 1e4 * jnp.finfo(points.dtype).eps * jnp.max(apart)
    for _ in range(capacity - 1):
        farthest = jnp.argmax(apart)
        kept.append(farthest)
        valid.append(apart[farthest] > same)
        apart = jnp.minimum(apart, jnp.where(near, jnp.sum((points - points[farthest]) ** 2, axis=1), -1.0))
    return jnp.stack(kept), jnp.stack(valid)


def _seen_by(pose: Pose, direction: Vector) -> Vector:
    return unit_or(pose.orientation.unrotate(direction), direction)
