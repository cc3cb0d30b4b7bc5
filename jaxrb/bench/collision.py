"""Speed of the narrow phase: CPU time of a pair in a batch, beside coal where it is installed."""

import importlib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.accuracy.timing import cpu_of_first, interleaved
from jaxrb.collision import separation
from jaxrb.collision.obb import oriented_boxes_gap
from jaxrb.draws import drawn
from jaxrb.geometry import Box, ConvexHull, Pose, stack_hulls
from jaxrb.geometry.bounds import OrientedBox
from jaxrb.math import Quaternion

PAIRS = 4096
CORNERS = (8, 16, 32, 64)
PEER_PAIRS = 512
BOXES = "box – box"


def rows() -> Iterator[dict[str, Any]]:
    """One row for each kind of pair and state: microseconds of CPU time a pair, seconds of the first call."""
    for pair, state, shapes, poses, peer in pairs():
        yield _row(pair, state, shapes, poses, peer)
        if pair == BOXES:
            yield _axes_row(state, shapes, poses)


def pairs() -> Iterator[tuple[str, str, Any, Any, Callable[[], Any] | None]]:
    """Kind and state, shapes and poses of `PAIRS` pairs, and coal's answer to the first `PEER_PAIRS` of them."""
    generator = drawn(0)
    dtype = jnp.result_type(float)
    half = generator.uniform(0.3, 1.0, size=(2, PAIRS, 3))
    for state, reach in (("apart", 3.5), ("overlapping", 0.6)):
        shapes = [Box(jnp.asarray(h, dtype)) for h in half]
        poses = _places(generator, reach, dtype)
        peer = _coal(lambda coal: [[coal.Box(*(2 * h)) for h in side] for side in half], poses)
        yield BOXES, state, shapes, poses, peer
    for corners in CORNERS:
        points = _on_sphere(generator, (2, 64, corners))
        hulls = [stack_hulls([ConvexHull(p) for p in side]) for side in points]
        shapes = [
            jax.tree.map(lambda x: jnp.tile(_device(x, dtype), (PAIRS // 64, 1, 1)), side) for side in hulls
        ]
        for state, reach in (("apart", 2.3), ("overlapping", 0.6)):
            poses = _places(generator, reach, dtype)
            peer = _coal(lambda coal, points=points: [_coal_hulls(coal, side) for side in points], poses)
            yield f"hulls of {corners}", state, shapes, poses, peer


def _axes_row(state: str, shapes: Any, poses: Any) -> dict[str, Any]:
    """The signed gap alone: exact where the boxes overlap, a lower bound of the distance where not."""
    boxes = [OrientedBox(pose, shape.half_extents) for shape, pose in zip(shapes, poses)]
    run = jax.jit(jax.vmap(oriented_boxes_gap))
    slope = jax.jit(jax.vmap(jax.value_and_grad(oriented_boxes_gap)))
    first = cpu_of_first(lambda: run(*boxes))
    seconds = interleaved([lambda: run(*boxes), lambda: slope(*boxes)], rounds=5)
    return {
        "pair": "box – box, fifteen axes alone",
        "state": state,
        "µs a pair": seconds[0] / PAIRS * 1e6,
        "with gradient, ratio": seconds[1] / seconds[0],
        "first call [CPU s]": first,
        "overlapping": float(jnp.mean(run(*boxes) < 0)),
        "coal [µs]": None,
    }


def jobs_of(shapes: Any, poses: Any) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """All pairs' contacts, and their distances with the gradient by the place of a."""
    run = jax.jit(jax.vmap(separation))
    slope = jax.jit(jax.vmap(jax.value_and_grad(lambda p, *rest: _distance(p, *rest))))
    moved = (poses[0].position, poses[0].orientation, shapes[0], shapes[1], poses[1])
    return partial(run, shapes[0], poses[0], shapes[1], poses[1]), partial(slope, *moved)


def _row(pair: str, state: str, shapes: Any, poses: Any, peer: Callable[[], Any] | None) -> dict[str, Any]:
    run, slope = jobs_of(shapes, poses)
    first = cpu_of_first(run)
    seconds = interleaved([run, slope, peer] if peer else [run, slope], rounds=5)
    row = {
        "pair": pair,
        "state": state,
        "µs a pair": seconds[0] / PAIRS * 1e6,
        "with gradient, ratio": seconds[1] / seconds[0],
        "first call [CPU s]": first,
        "overlapping": float(jnp.mean(run().distance < 0)),
    }
    return row | {"coal [µs]": seconds[2] / PEER_PAIRS * 1e6 if peer else None}


def _distance(position: Any, orientation: Any, shape_a: Any, shape_b: Any, pose_b: Any) -> Any:
    return separation(shape_a, Pose(position, orientation), shape_b, pose_b).distance


def _device(x: Any, dtype: Any) -> Any:
    return jnp.asarray(x, dtype if np.asarray(x).dtype.kind == "f" else jnp.int32)


def _on_sphere(generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    points = generator.normal(size=(*shape, 3))
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def _places(generator: np.random.Generator, reach: float, dtype: Any) -> tuple[Pose, Pose]:
    """Poses of pairs whose centres are `reach` apart, turned at random."""
    aside = _on_sphere(generator, (PAIRS,)) * reach
    turns = generator.normal(size=(2, PAIRS, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    zero = np.zeros((PAIRS, 3))
    one, other = (
        Pose(jnp.asarray(p, dtype), Quaternion(jnp.asarray(q, dtype))) for p, q in zip((zero, aside), turns)
    )
    return one, other


def _coal(built: Callable[[Any], Any], poses: tuple[Pose, Pose]) -> Callable[[], Any] | None:
    """The same pairs in coal, one after the other; None where it is not installed."""
    try:
        coal: Any = importlib.import_module("coal")
    except ImportError:
        return None
    shapes = built(coal)
    matrices = [np.asarray(pose.orientation.as_matrix(), float) for pose in poses]
    positions = [np.asarray(pose.position, float) for pose in poses]
    places = [[coal.Transform3s(m[i], p[i]) for i in range(PEER_PAIRS)] for m, p in zip(matrices, positions)]
    request = coal.DistanceRequest()

    def run() -> Any:
        for i in range(PEER_PAIRS):
            one, other = (side[i % len(side)] for side in shapes)
            result = coal.DistanceResult()
            coal.distance(one, places[0][i], other, places[1][i], request, result)
        return jnp.zeros(())

    return run


def _coal_hulls(coal: Any, side: np.ndarray) -> list[Any]:
    hulls = []
    for corners in side:
        vertices = coal.StdVec_Vec3s()
        vertices.extend([np.asarray(v, float) for v in corners])
        hulls.append(coal.Convex.convexHull(vertices, True, ""))
    return hulls
