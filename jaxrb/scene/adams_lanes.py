"""Adams runs over many bodies: which lanes go together, and how they are compiled.

On a CPU, bodies that do not act on each other run in groups whose ring of derivatives stays in the first-level cache.
"""

import functools
import os
import pathlib
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrb.body.state import PER_BODY, State, finite_per_body
from jaxrb.effects.dynamics import Dynamics
from jaxrb.effects.effect import Force
from jaxrb.integrators.adams import stepped
from jaxrb.integrators.adams_motion import Motion, joined
from jaxrb.integrators.adams_weights import Scheme
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.scene.scene import Scene
from jaxrb.scene.status import sound

VECTOR_WIDTH = (
    "JAXRB_VECTOR_WIDTH"  # environment: 512, 256, … bits for XLA's CPU loops; 0 leaves XLA's own choice
)
_CACHE_BYTES = 48 * 1024


class Ends(eqx.Module):
    """What is left of a run: the last and the saved states, and for each body (n,) what tells its quality.

    states: at the times asked for, or at the two ends.
    begun: reason code of the first state. finite: whether the last one is.
    drift: of the orientation from a rotation, before it was projected.
    roughness: the part of the last derivatives that alternates from step to step, times the step; a smooth solution
        has next to none.
    """

    final: State
    states: State
    begun: Array
    finite: Array
    drift: Array
    roughness: Array


class _Group(eqx.Module):
    """The run of one group."""

    final: State
    saved: State | None
    drift: Array
    roughness: Array


def independent(scene: Scene) -> bool:
    """Whether no body feels another, so that they may run in groups."""
    return all(
        isinstance(effect, Force) and type(effect).wrench_on is Force.wrench_on and effect.bodies is None
        for effect in scene.effects
    )


def group_size(scene: Scene, state: State) -> int:
    """Bodies that run together: all, or as many as the cache takes, a multiple of 16."""
    count = scene.count
    if not independent(scene) or jax.default_backend() != "cpu":
        return count
    numbers = 12 * 13 * state.dtype.itemsize  # of a quaternion body that also moves, at order 10
    size = max(16, _CACHE_BYTES // numbers // 16 * 16)
    return min(count, size)


def groups(count: int, size: int) -> np.ndarray:
    """Numbers of the bodies in each group (groups, size); the last body is repeated to fill the last group."""
    rows = -(-count // size)
    return np.minimum(np.arange(rows * size, dtype=np.int32), count - 1).reshape(rows, size)


def run(
    scene: Scene,
    state: State,
    torque: Vector | None,
    span: Scalar,
    times: Array | None,
    index: Array,
    used: int | Array,
    cycles: int | Array,
    scheme: Scheme,
) -> Ends:
    """Run the bodies of the first `used` rows of `index` (groups, size); results in the order of `index`.

    With whole numbers `used` and `cycles` it can be differentiated; with traced ones it compiles once for all.
    """
    found = _found(scene, state, torque, span, times, index, used, cycles, scheme)
    states = found.saved
    if states is None:
        states = jax.tree.map(lambda first, last: jnp.stack([first, last]), state, found.final)
    return Ends(
        found.final, states, sound(state, True), finite_per_body(found.final), found.drift, found.roughness
    )


def _found(
    scene: Scene,
    state: State,
    torque: Vector | None,
    span: Scalar,
    times: Array | None,
    index: Array,
    used: int | Array,
    cycles: int | Array,
    scheme: Scheme,
) -> _Group:
    dynamics = scene.prepared(state.dtype)
    if index.shape == (1, scene.count):
        return _of_group(dynamics, state, torque, span, times, cycles, scheme)
    everything = _Lanes(dynamics, state, torque)

    def one(row: Array) -> _Group:
        lanes = everything.taken(row)
        return _of_group(lanes.dynamics, lanes.state, lanes.torque, span, times, cycles, scheme)

    if isinstance(used, int):
        return _joined(lax.map(one, index[:used]), scene.count)
    shapes = jax.eval_shape(one, index[0])
    empty = jax.tree.map(lambda leaf: jnp.zeros((index.shape[0], *leaf.shape), leaf.dtype), shapes)

    def put(number: Array, groups: _Group) -> _Group:
        def written(groups: Array, group: Array) -> Array:
            return lax.dynamic_update_index_in_dim(groups, group, number, 0)

        return jax.tree.map(written, groups, one(index[number]))

    return _joined(lax.fori_loop(0, used, put, empty), scene.count)


class _Lanes(eqx.Module):
    """Everything of a run that belongs to its bodies."""

    dynamics: Dynamics
    state: State
    torque: Vector | None

    def taken(self, row: Array) -> "_Lanes":
        """The same for the bodies in a row."""
        dynamics = self.dynamics
        per_body: Any = _Lanes(
            Dynamics(
                0, 0, 0,  # type: ignore[arg-type]
                tuple(effect._axes() for effect in dynamics.effects),  # type: ignore[attr-defined]
                tuple(point._axes() for point in dynamics.fixed_points),
            ),
            PER_BODY,
            None if self.torque is None else 0,  # type: ignore[arg-type]
        )  # fmt: skip
        return jax.tree.map(
            lambda axis, leaves: leaves if axis is None else jax.tree.map(lambda leaf: leaf[row], leaves),
            per_body,
            self,
            is_leaf=lambda leaf: leaf is None,
        )


def _of_group(
    dynamics: Dynamics,
    state: State,
    torque: Vector | None,
    span: Scalar,
    times: Array | None,
    cycles: int | Array,
    scheme: Scheme,
) -> _Group:
    motion = Motion.of(dynamics, state, torque)

    start = joined(motion.parts(state))
    rows, ring, saved = stepped(motion.field(), start, state.time, span, cycles, scheme, times)
    final = motion.state(state.time + span, list(rows))
    drift = final.orientation.drift()
    states = None
    if saved is not None and times is not None:
        states = jax.vmap(lambda time, rows: _projected(motion.state(time, list(rows))))(times, saved)
    step = span / jnp.asarray(scheme.steps(cycles), rows.dtype)
    return _Group(
        _projected(final),
        states,
        lax.stop_gradient(jnp.maximum(jnp.abs(drift.scale), drift.skew)),
        lax.stop_gradient(step * _roughness(ring)),
    )


def _projected(state: State) -> State:
    return eqx.tree_at(lambda s: s.orientation, state, state.orientation.normalise())


def _roughness(ring: Array) -> Array:
    """Largest highest difference of the ring's derivatives, scaled to the size of an alternating part, (n,)."""
    differences = ring
    for _ in range(ring.shape[0] - 1):
        differences = 0.5 * (differences[1:] - differences[:-1])
    return jnp.max(jnp.abs(differences[0]), axis=0)


def _joined(groups: _Group, count: int) -> _Group:
    """The groups' results, (groups, …, size, …), with one axis over the `count` bodies."""

    def of(leaf: Array, lead: int) -> Array:
        leaf = jnp.moveaxis(leaf, 0, lead)
        joined = leaf.reshape(*leaf.shape[:lead], -1, *leaf.shape[lead + 2 :])
        return joined[(slice(None),) * lead + (slice(count),)]

    def of_state(state: State, lead: int) -> State:
        bodies = jax.tree.map(lambda leaf: of(leaf, lead), eqx.tree_at(lambda s: s.time, state, None))
        return eqx.tree_at(lambda s: s.time, bodies, state.time[0], is_leaf=lambda leaf: leaf is None)

    saved = None if groups.saved is None else of_state(groups.saved, 1)
    return _Group(of_state(groups.final, 0), saved, of(groups.drift, 0), of(groups.roughness, 0))


@functools.cache
def compiler_options() -> dict[str, int] | None:
    """Options for `jax.jit`: 512-bit vectors on CPUs that have them, where XLA prefers 256 (1.2–2 times the speed).

    The environment variable `JAXRB_VECTOR_WIDTH` sets another width in bits; 0 leaves the choice to XLA.
    """
    if jax.default_backend() != "cpu":
        return None
    wanted = os.environ.get(VECTOR_WIDTH)
    if wanted is not None and wanted.isdigit():
        return {"xla_cpu_prefer_vector_width": int(wanted)} if int(wanted) else None
    return {"xla_cpu_prefer_vector_width": 512} if _has_avx512() else None


def _has_avx512() -> bool:
    try:
        return "avx512f" in pathlib.Path("/proc/cpuinfo").read_text()
    except OSError:
        return False


@functools.cache
def compiled() -> Any:
    """`run` as a program of its own with the options for this machine, for traced numbers of groups and cycles."""
    return jax.jit(run, static_argnames=("scheme",), compiler_options=compiler_options())


differentiable = jax.jit(run, static_argnames=("used", "cycles", "scheme"))
