"""Two triangle meshes: the pairs of triangles that meet, and how far apart the surfaces are."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.checks import raise_if_overflowed
from jaxrb.collision.triangles import closest_points, triangles_meet
from jaxrb.geometry.hierarchy import Hierarchy, descend, hierarchy_of, walk
from jaxrb.geometry.mesh import TriangleMesh
from jaxrb.geometry.primitives import Pose
from jaxrb.math.arrays import Array
from jaxrb.math.safe import norm

_LANES = 512  # pairs of triangles that one turn of a loop tests


class MeshTree(eqx.Module):
    """A triangle mesh with a hierarchy of boxes over its triangles: made once, moved by poses.

    Where the vertices themselves move, `refitted` keeps the tree and fits its boxes anew.
    """

    mesh: TriangleMesh
    hierarchy: Hierarchy

    @classmethod
    def of(cls, mesh: TriangleMesh) -> "MeshTree":
        """Build the tree on the host."""
        corners = np.asarray(mesh.corners())
        return cls(mesh, hierarchy_of(corners.min(axis=1), corners.max(axis=1)))

    def refitted(self, vertices: Array) -> "MeshTree":
        """The same mesh with its vertices (n, 3) [m] moved."""
        mesh = eqx.tree_at(lambda mesh: mesh.vertices, self.mesh, vertices)
        corners = mesh.corners()
        return MeshTree(mesh, self.hierarchy.refitted(corners.min(axis=1), corners.max(axis=1)))


class TrianglePairs(NamedTuple):
    """Triangles of two meshes that have a point in common.

    `first`, `second` (capacity,): their numbers, −1 beyond `count`. `box_tests`, `triangle_tests`: what was looked at,
    where all pairs would be `all_pairs`. `overflow`: capacity was too small, and pairs are missing.
    """

    first: Array
    second: Array
    count: Array
    box_tests: Array
    triangle_tests: Array
    all_pairs: int
    overflow: Array

    @property
    def saved(self) -> Array:
        """The share of pair tests that the hierarchy saves."""
        return 1.0 - (self.box_tests + self.triangle_tests) / self.all_pairs

    def raise_if_overflowed(self) -> None:
        """Raise `LimitExceeded` where pairs are missing. Does nothing while being traced."""
        raise_if_overflowed(
            self.overflow,
            f"triangle pairs: more than capacity={self.first.shape[-1]} (or eight times as many whose boxes meet); "
            "raise capacity",
        )


def meeting_triangles(
    a: MeshTree, pose_a: Pose, b: MeshTree, pose_b: Pose, *, capacity: int = 8192
) -> TrianglePairs:
    """Every pair of triangles of two meshes that have a point in common. Pure, of fixed size: use it under jit.

    Args:
        a, b: meshes with their trees, in poses of their own.
        capacity: most pairs; `overflow` tells where that was too few.
    """
    rotation, translation = _relative(pose_a, pose_b)
    found = walk(a.hierarchy, b.hierarchy, rotation, translation, 0.0, 8 * capacity)
    corners_a = jnp.asarray(a.mesh.corners())
    corners_b = _placed(jnp.asarray(b.mesh.corners()), rotation, translation)

    count = found.count

    def turn(carry: tuple) -> tuple:
        place, kept, total = carry
        number = place + jnp.arange(_LANES)
        here = jnp.minimum(number, found.first.shape[0] - 1)
        pairs = jnp.stack([found.first[here], found.second[here]], axis=-1)
        passed = triangles_meet(_lanes(corners_a, pairs[:, 0]), _lanes(corners_b, pairs[:, 1])) & (
            number < count
        )
        rank = jnp.cumsum(passed, dtype=jnp.int32)
        kept = kept.at[jnp.where(passed, total + rank - 1, capacity)].set(pairs, mode="drop")
        return place + _LANES, kept, total + rank[-1]

    zero = jnp.zeros((), jnp.int32)
    start = (zero, jnp.full((capacity, 2), -1, jnp.int32), zero)
    _, kept, total = lax.while_loop(lambda carry: carry[0] < count, turn, start)
    all_pairs = len(a.mesh.triangles) * len(b.mesh.triangles)
    overflow = found.overflow | (total > capacity)
    return TrianglePairs(
        kept[:, 0], kept[:, 1], jnp.minimum(total, capacity), found.tests, count, all_pairs, overflow
    )


class MeshDistance(NamedTuple):
    """How far apart two surfaces are [m], 0 where they meet, with the nearest point of each in the world (3,).

    `overflow`: so many triangles are equally near that some were not looked at.
    """

    distance: Array
    point_a: Array
    point_b: Array
    triangle_a: Array
    triangle_b: Array
    overflow: Array


def mesh_distance(
    a: MeshTree, pose_a: Pose, b: MeshTree, pose_b: Pose, *, capacity: int = 8192
) -> MeshDistance:
    """The distance of two surfaces; a mesh inside another's hollow is as far as its nearest wall.

    The search finds the two nearest triangles; their distance is then formed anew from vertices and poses, so that
    it has first and second derivatives in both.
    """
    rotation, translation = jax.tree.map(lax.stop_gradient, _relative(pose_a, pose_b))
    corners_a = lax.stop_gradient(jnp.asarray(a.mesh.corners()))
    corners_b = _placed(lax.stop_gradient(jnp.asarray(b.mesh.corners())), rotation, translation)
    tree_a, tree_b = (lax.stop_gradient(jax.tree.map(jnp.asarray, tree.hierarchy)) for tree in (a, b))

    *guess, count = descend(tree_a, tree_b, rotation, translation)
    capacity = max(capacity, len(guess[0]))

    def nearest(pairs: tuple[Array, Array], valid: Array) -> tuple:
        one, other = _lanes(corners_a, pairs[0]), _lanes(corners_b, pairs[1])
        apart = jnp.where(triangles_meet(one, other), 0.0, closest_points(one, other).squared)
        squared = jnp.where(valid, apart, jnp.inf)
        best = jnp.argmin(squared)
        return squared[best], pairs[0][best], pairs[1][best]

    def turn(carry: tuple) -> tuple:
        """A block of the list; after the last of the first list, which is a guess, walk for the second."""
        place, lists, count, best, guessing, overflow = carry
        number = place + jnp.arange(_LANES)
        here = jnp.minimum(number, capacity - 1)
        mine = nearest((lists[0][here], lists[1][here]), number < count)
        best = jax.tree.map(lambda new, old: jnp.where(mine[0] < best[0], new, old), mine, best)
        done = guessing & (place + _LANES >= count)

        def all_within() -> tuple:
            found = walk(tree_a, tree_b, rotation, translation, jnp.sqrt(best[0]), capacity)
            return jnp.zeros_like(place), (found.first, found.second), found.count, found.overflow

        place, lists, count, overflow = lax.cond(
            done, all_within, lambda: (place + _LANES, lists, count, overflow)
        )
        return place, lists, count, best, guessing & ~done, overflow

    lists = tuple(jnp.pad(items, (0, capacity - len(items))) for items in guess)
    zero = jnp.zeros((), jnp.int32)
    never = (jnp.full((), jnp.inf, corners_a.dtype), zero, zero)
    start = (zero, lists, count, never, jnp.ones((), bool), jnp.zeros((), bool))
    *_, (squared, first, second), _, overflow = lax.while_loop(lambda c: (c[0] < c[2]) | c[4], turn, start)
    return _between(a.mesh, pose_a, b.mesh, pose_b, first, second, squared <= 0, overflow)


def _between(
    a: TriangleMesh,
    pose_a: Pose,
    b: TriangleMesh,
    pose_b: Pose,
    first: Any,
    second: Any,
    meet: Any,
    overflow: Any,
) -> MeshDistance:
    """The distance of two triangles, formed with derivatives in the frame of a."""
    rotation, translation = _relative(pose_a, pose_b)
    corners_a = jnp.asarray(a.vertices)[jnp.asarray(a.triangles.triangles)[first]]
    corners_b = _placed(
        jnp.asarray(b.vertices)[jnp.asarray(b.triangles.triangles)[second]], rotation, translation
    )
    found = closest_points(corners_a, corners_b)
    between = jnp.where(meet, 0.0, 1.0) * (found.point_b - found.point_a)
    point_a, point_b = (
        pose_a.position + pose_a.orientation.rotate(point)
        for point in (found.point_a, found.point_a + between)
    )
    return MeshDistance(norm(between), point_a, point_b, first, second, overflow)


def _relative(pose_a: Pose, pose_b: Pose) -> tuple[Array, Array]:
    """Rotation matrix (3, 3) and translation (3,) that place b in the frame of a."""
    rotation = pose_a.orientation.inverse() @ pose_b.orientation
    offset = jnp.asarray(pose_b.position) - jnp.asarray(pose_a.position)
    return rotation.as_matrix(), pose_a.orientation.unrotate(offset)


def _placed(corners: Array, rotation: Array, translation: Array) -> Array:
    return jnp.einsum("...j,ij->...i", corners, rotation, precision="highest") + translation


def _lanes(corners: Array, number: Array) -> Array:
    """Triangles (3, 3, lanes) of given numbers (lanes,)."""
    return corners.reshape(-1, 9)[number].T.reshape(3, 3, -1)
