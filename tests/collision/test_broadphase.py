"""The broad phase: exactly the pairs whose boxes overlap, each once, or an overflow that is said."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

from jaxrb.collision.broadphase import body_pairs
from jaxrb.errors import LimitExceeded, WrongStructure

FEW, MANY, CAPACITY = 20, 300, 2500


def boxes(count, seed, dtype):
    """Boxes of very different sizes; some are points, some are equal, one is as large as all space."""
    random = np.random.default_rng(seed)
    center = random.uniform(0, count ** (1 / 3), (count, 3))
    half = random.uniform(0.05, 0.6, (count, 1)) * random.uniform(0.5, 1.0, (count, 3))
    half[3] = 0.0
    center[4], half[4] = center[5], half[5]
    half[6] = 100.0
    return (center - half).astype(dtype), (center + half).astype(dtype)


def expected(low, high, allowed=None):
    first, second = np.triu_indices(len(low), 1)
    near = ((low[first] <= high[second]) & (low[second] <= high[first])).all(1)
    near &= True if allowed is None else allowed[first, second]
    return {*zip(first[near].tolist(), second[near].tolist())}


def found(pairs):
    count = int(pairs.count)
    first, second = np.asarray(pairs.first), np.asarray(pairs.second)
    assert (first[count:] == -1).all()
    assert (second[count:] == -1).all()
    listed = list(zip(first[:count].tolist(), second[:count].tolist()))
    assert len({*listed}) == len(listed)
    return {*listed}


@pytest.fixture(scope="module")
def search():
    """Compiled once for few and once for many bodies."""
    return jax.jit(
        lambda low, high, groups, masks, margin: body_pairs(
            low, high, CAPACITY, groups=groups, masks=masks, margin=margin
        ),
        compiler_options=QUICK,
    )


def everything(count):
    return np.ones(count, np.int32), np.ones(count, np.int32)


@pytest.mark.parametrize("count", [FEW, MANY])
@pytest.mark.parametrize("seed", range(5))
def test_pairs_are_those_of_brute_force(count, seed, search, dtype):
    low, high = boxes(count, seed, dtype)
    pairs = search(low, high, *everything(count), 0.0)
    assert found(pairs) == expected(low, high)
    assert not pairs.overflow
    assert int(pairs.count) > count  # the large one meets all, and there are others


@pytest.mark.parametrize("count", [FEW, MANY])
def test_margin_widens_every_box_by_half_of_it(count, search, dtype):
    low, high = boxes(count, 0, dtype)
    margin = np.asarray(0.25, dtype)
    pairs = search(low, high, *everything(count), margin)
    assert found(pairs) == expected(low - margin / 2, high + margin / 2)
    assert len(found(pairs)) > len(expected(low, high))


@pytest.mark.parametrize("count", [FEW, MANY])
def test_groups_and_masks_forbid_pairs_in_both_directions(count, search, dtype):
    low, high = boxes(count, 1, dtype)
    random = np.random.default_rng(0)
    groups, masks = (random.integers(0, 8, count).astype(np.int32) for _ in range(2))
    allowed = ((groups[:, None] & masks[None]) != 0) & ((groups[None] & masks[:, None]) != 0)
    pairs = search(low, high, groups, masks, 0.0)
    assert found(pairs) == expected(low, high, allowed)
    assert 0 < len(found(pairs)) < len(expected(low, high))


@pytest.mark.parametrize("count", [FEW, MANY])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_box_that_is_not_finite_meets_every_other(count, value, search, dtype):
    """A body that left the finite numbers must not silently fall through the others."""
    low, high = boxes(count, 2, dtype)
    low[7, 1] = value
    pairs = search(low, high, *everything(count), 0.0)
    listed = found(pairs)
    assert {(min(7, i), max(7, i)) for i in range(count) if i != 7} <= listed
    others = {pair for pair in listed if 7 not in pair}
    assert others == {pair for pair in expected(low, high) if 7 not in pair}


@pytest.mark.parametrize("count", [FEW, MANY])
def test_more_pairs_than_capacity_are_said_aloud(count, dtype):
    """All bodies in one place: every pair overlaps."""
    low, high = np.zeros((count, 3), dtype), np.ones((count, 3), dtype)
    for capacity, enough in ((count * (count - 1) // 2, True), (count * (count - 1) // 2 - 1, False)):
        pairs = jax.jit(body_pairs, static_argnums=2, compiler_options=QUICK)(low, high, capacity)
        assert bool(pairs.overflow) is not enough
        assert int(pairs.count) == capacity
        assert found(pairs) <= expected(low, high)
        if enough:
            pairs.raise_if_overflowed()
        else:
            with pytest.raises(LimitExceeded, match=f"capacity={capacity}"):
                pairs.raise_if_overflowed()


@pytest.mark.parametrize("count", [FEW, MANY])
def test_worlds_side_by_side_are_each_what_they_are_alone(count, dtype):
    low, high = (np.stack(side) for side in zip(*(boxes(count, seed, dtype) for seed in range(4))))
    batch = jax.jit(jax.vmap(lambda *box: body_pairs(*box, CAPACITY)), compiler_options=QUICK)(low, high)
    for world in range(4):
        assert found(jax.tree.map(lambda x, world=world: x[world], batch)) == expected(
            low[world], high[world]
        )


def test_hierarchy_looks_at_far_fewer_than_all_pairs(search, dtype):
    low, high = boxes(MANY, 0, dtype)
    assert int(search(low, high, *everything(MANY), 0.0).tests) < MANY * (MANY - 1) / 2


def test_one_body_has_no_pairs_and_wrong_shapes_are_refused():
    alone = body_pairs(jnp.zeros((1, 3)), jnp.ones((1, 3)), 4)
    assert int(alone.count) == 0
    assert not alone.overflow
    with pytest.raises(WrongStructure, match=r"give \(n, 3\)"):
        body_pairs(jnp.zeros((2, 3)), jnp.ones((3, 3)), 4)
    with pytest.raises(WrongStructure, match="capacity is 0"):
        body_pairs(jnp.zeros((2, 3)), jnp.ones((2, 3)), 0)
    with pytest.raises(WrongStructure, match=r"groups \(3,\)"):
        body_pairs(jnp.zeros((2, 3)), jnp.ones((2, 3)), 4, groups=jnp.zeros(3, int))
