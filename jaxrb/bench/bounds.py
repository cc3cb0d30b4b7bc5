"""Bounding volumes beside each other: how tight, how often wrong, how dear. Then the hierarchy and the broad phase.

Random hulls of 16 points, elongated, at random poses. A false alarm is a pair whose volumes overlap though the hulls do
not; the truth is the exact distance.
"""

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.timing import interleaved
from jaxrb.collision.broadphase import body_pairs
from jaxrb.collision.mesh_pairs import MeshTree, meeting_triangles, mesh_distance
from jaxrb.collision.narrowphase import separation
from jaxrb.collision.obb import oriented_boxes_gap
from jaxrb.draws import drawn
from jaxrb.geometry.bounds import bounding_box, bounding_sphere, boxes_gap, oriented_box, spheres_gap
from jaxrb.geometry.hull import ConvexHull, stack_hulls
from jaxrb.geometry.mesh import TriangleMesh
from jaxrb.geometry.primitives import Pose
from jaxrb.math.quaternion import Quaternion

SHAPES, PAIRS = 32, 4096
BODIES = (10, 30, 100, 300, 1000, 3000, 10_000)


def rows() -> Iterator[dict[str, Any]]:
    """One row a bounding volume, then rows of the hierarchy and the broad phase."""
    yield from _volumes()
    yield from _hierarchy()
    yield from _broad_phase()


def _row(what: str, **figures: Any) -> dict[str, Any]:
    keys = ("volume / hull", "false alarms [%]", "ns a test", "ns to move", "CPU [ms]", "found", "note")
    return {"what": what} | {key: figures.get(key, "") for key in keys}


def _volumes() -> Iterator[dict[str, Any]]:
    random = drawn(0)
    hulls = [ConvexHull(random.normal(size=(16, 3)) * random.uniform(0.2, 1.0, 3)) for _ in range(SHAPES)]
    volumes = np.array([float(hull.mass_properties(1.0).mass) for hull in hulls])
    first, second = random.integers(0, SHAPES, (2, PAIRS))
    poses = _poses(random, 2 * PAIRS, 2.5)
    here, there = (jax.tree.map(lambda x, s=s: x[s], poses) for s in (slice(PAIRS), slice(PAIRS, None)))
    stacked = stack_hulls(hulls)
    sides = [jax.tree.map(lambda x, k=k: jnp.asarray(x)[k], stacked) for k in (first, second)]
    distance = jax.jit(jax.vmap(separation))(sides[0], here, sides[1], there).distance
    apart = np.asarray(distance) > 0
    balls = _side_by_side([bounding_sphere(hull) for hull in hulls])
    boxes = _side_by_side([oriented_box(hull) for hull in hulls])
    kinds: dict[str, tuple[Any, Any, Any, Any]] = {}
    aligned = np.mean([float(bounding_box(hull).volume) for hull in hulls] / volumes)
    kinds["sphere"] = (
        balls,
        lambda v, p: v.moved(p),
        spheres_gap,
        np.mean(np.asarray(balls.volume) / volumes),
    )
    kinds["axis-aligned box"] = (stacked, bounding_box, boxes_gap, aligned)
    kinds["oriented box"] = (
        boxes, lambda v, p: v.moved(p), oriented_boxes_gap, np.mean(np.asarray(boxes.volume) / volumes)
    )  # fmt: skip
    for name, (source, move, gap, ratio) in kinds.items():
        own = [jax.tree.map(lambda x, k=k: jnp.asarray(x)[k], source) for k in (first, second)]
        moved = jax.jit(jax.vmap(move))
        placed = [moved(side, pose) for side, pose in zip(own, (here, there))]
        test = jax.jit(jax.vmap(gap))
        alarms = np.asarray(test(*placed)) <= 0
        costs = interleaved([partial(test, *placed), partial(moved, own[0], here)])
        yield _row(
            name,
            **{
                "volume / hull": float(ratio),
                "false alarms [%]": 100 * float((alarms & apart).sum() / apart.sum()),
                "ns a test": 1e9 * costs[0] / PAIRS,
                "ns to move": 1e9 * costs[1] / PAIRS,
                "note": f"{(~alarms & ~apart).sum()} meeting pairs missed of {(~apart).sum()}",
            },
        )


def _side_by_side(items: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *items)


def _poses(random: np.random.Generator, count: int, spread: float) -> Pose:
    dtype = jax.dtypes.canonicalize_dtype(float)
    turns = jax.vmap(Quaternion.exp)(jnp.asarray(random.normal(size=(count, 3)) * 2.0, dtype))
    return Pose(jnp.asarray(random.uniform(0, spread, (count, 3)), dtype), turns)


def _hierarchy() -> Iterator[dict[str, Any]]:
    """Two spheres of 20,480 triangles, one turned and moved."""
    mesh = TriangleMesh(*_sphere(5))
    start = time.process_time()
    tree = MeshTree.of(mesh)
    yield _row(
        "hierarchy: build",
        **{"CPU [ms]": 1e3 * (time.process_time() - start), "found": tree.hierarchy.leaves},
    )
    dtype = jax.dtypes.canonicalize_dtype(float)
    tree = jax.tree.map(lambda x: jnp.asarray(x, dtype if x.dtype.kind == "f" else x.dtype), tree)
    here, turn = Pose.identity(dtype), Quaternion.exp(jnp.asarray([0.3, 0.2, 0.1], dtype))
    contacts = jax.jit(lambda pose: meeting_triangles(tree, here, tree, pose))
    distance = jax.jit(lambda pose: mesh_distance(tree, here, tree, pose))
    for offset in (0.5, 1.0, 1.9, 2.1):
        pose = Pose(jnp.asarray([offset, 0.01, 0.02], dtype), turn)
        found = contacts(pose)
        found.raise_if_overflowed()
        cost = interleaved([partial(contacts, pose), partial(distance, pose)])
        note = f"{100 * float(found.saved):.3f} % of {found.all_pairs} pair tests saved"
        yield _row(
            f"contacts at {offset} radii",
            **{"CPU [ms]": 1e3 * cost[0], "found": int(found.count), "note": note},
        )
        gap = float(distance(pose).distance)
        yield _row(f"distance at {offset} radii", **{"CPU [ms]": 1e3 * cost[1], "note": f"{gap:.6f} radii"})


def _broad_phase() -> Iterator[dict[str, Any]]:
    """Bodies of half extents 0.2 to 0.5 m, one to each cubic metre."""
    random = drawn(0)
    dtype = jax.dtypes.canonicalize_dtype(float)
    for count in BODIES:
        center, half = random.uniform(0, count ** (1 / 3), (count, 3)), random.uniform(0.2, 0.5, (count, 3))
        low, high = jnp.asarray(center - half, dtype), jnp.asarray(center + half, dtype)
        search = jax.jit(lambda low, high, capacity=6 * count: body_pairs(low, high, capacity))
        found = search(low, high)
        found.raise_if_overflowed()
        (cost,) = interleaved([partial(search, low, high)])
        note = f"{1e6 * cost / count:.2f} µs a body, {int(found.tests)} box tests"
        yield _row(
            f"broad phase, {count} bodies",
            **{"CPU [ms]": 1e3 * cost, "found": int(found.count), "note": note},
        )


def _sphere(divisions: int) -> tuple[np.ndarray, np.ndarray]:
    """An icosahedron whose triangles are cut in four and pushed out to the unit sphere: 20 · 4^divisions triangles."""
    hull = ConvexHull(_icosahedron())
    vertices, triangles = np.asarray(hull.vertices, float), np.asarray(hull.triangles)
    for _ in range(divisions):
        sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], -1).reshape(-1, 2), axis=1)
        edges, edge = np.unique(sides, axis=0, return_inverse=True)
        middle = len(vertices) + edge.reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[edges].mean(axis=1)])
        (a, b, c), (ab, bc, ca) = triangles.T, middle.T
        corners = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(t, -1) for t in corners])
    return vertices / np.linalg.norm(vertices, axis=-1, keepdims=True), triangles


def _icosahedron() -> np.ndarray:
    golden = 0.5 * (1 + 5**0.5)
    signs = np.array([[x, y * golden, 0] for x in (-1, 1) for y in (-1, 1)])
    return np.concatenate([signs, np.roll(signs, 1, axis=1), np.roll(signs, 2, axis=1)])
