"""Rigid contact: bodies do not overlap, and rub where they touch."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxrb.checks import check_count, check_tolerance, quantity
from jaxrb.effects.effect import Effect, check_indices, check_shapes
from jaxrb.effects.surfaces import obstacles_of
from jaxrb.errors import WrongStructure

SOLVERS = ("newton", "sparse")
COMBINE = ("mean", "geometric", "smaller", "larger", "product")


class RigidContact(Effect):
    """Contact of the bodies' shapes with what stands still (`against`), or with each other (`against=None`).

    Laws: no overlap; Coulomb's friction with its round cone; Newton's restitution at impacts. What is None is not in
    the program: without `friction` contact is frictionless, without `restitution` impacts are perfectly plastic. Steps
    with contact are of order 1; a body that touches nothing keeps the order of the method. (Moreau 1988 for the
    velocity law; Stewart and Trinkle 1996 for the step; `contact/solver.py` for the solve.)

    * `against`: a `Shape`, a pair (shape, `Pose`), or several of these, at rest in the world. A `HalfSpace` is a floor.
    * `friction` [1], `restitution` [1], in [0, 1]: for all, or one a body (n,). Of two bodies the coefficients are put
      together by `combine`: "mean", "geometric", "smaller", "larger" or "product"; against what stands still the
      body's own holds.
    * `rolling_resistance`, `spinning_resistance` b [m]: a couple of at most b times the load, across the normal and
      about it, that opposes how two bodies turn on each other, or holds them; given and combined as friction is.
    * `bodies`: those that take part, None all. `groups`, `masks`: a whole number a body read as bits; two bodies can
      touch where each one's mask holds a bit of the other's group. Pairs that cannot are not in the program.
    * `joined`: whether two bodies that a joint holds together may touch. By default not, as in MuJoCo: limbs overlap at
      their joint. Bodies with a joint between them and a third, or with one to the world, do touch.
    * `capacity`: most pairs of bodies near each other, by default six a body; a run in which there are more fails.
    * `recovery_speed` [m/s]: overlap (from the start, or by the curvature of a path) is pushed apart at most so fast.
    * `tolerance` [1]: of the solve, relative to the largest velocity that contact takes away; by default 1e-8 in
      float64 and 1e-4 in float32; of a crowd 1e-4 and 3e-3.
    * `solver`: "newton" (for piles of up to some hundreds), "sparse" (cost and memory linear in the bodies, for
      crowds: `contact/sparse.py`), None: by the number of bodies that meet each other.

    Bodies may be fixed, restricted or driven: what holds them takes what they cannot follow (`rb.rollout` only).
    Shapes come from `Body.shape`; every body that takes part must have one that is convex, or a `Composite` of such.
    """

    against: Any = None
    friction: Any = quantity((), nonnegative=True, default=None)
    restitution: Any = quantity((), nonnegative=True, at_most=1.0, default=None)
    rolling_resistance: Any = quantity((), nonnegative=True, unit="m", default=None, kw_only=True)
    spinning_resistance: Any = quantity((), nonnegative=True, unit="m", default=None, kw_only=True)
    recovery_speed: Any = quantity((), positive=True, unit="m/s", default=0.05)
    bodies: tuple[int, ...] | None = eqx.field(static=True, default=None, kw_only=True)
    groups: tuple[int, ...] | None = eqx.field(static=True, default=None, kw_only=True)
    masks: tuple[int, ...] | None = eqx.field(static=True, default=None, kw_only=True)
    combine: str = eqx.field(static=True, default="geometric", kw_only=True)
    capacity: int | None = eqx.field(static=True, default=None, kw_only=True)
    tolerance: float | None = eqx.field(static=True, default=None, kw_only=True)
    solver: str | None = eqx.field(static=True, default=None, kw_only=True)
    joined: bool = eqx.field(static=True, default=False, kw_only=True)

    def __post_init__(self):
        super().__post_init__()
        self.against = obstacles_of("RigidContact", self.against)
        if self.combine not in COMBINE:
            raise WrongStructure(f"RigidContact.combine: {self.combine!r}; give one of {', '.join(COMBINE)}")
        if self.solver not in (None, *SOLVERS):
            raise WrongStructure(
                f"RigidContact.solver: {self.solver!r}; give one of {', '.join(SOLVERS)}, or None"
            )
        if self.capacity is not None:
            check_count("RigidContact.capacity", self.capacity, 1)
        if self.tolerance is not None:
            check_tolerance("RigidContact.tolerance", self.tolerance)

    def check(self, count: int) -> None:
        check_shapes(self, count, "all bodies", "one value a body")
        if self.bodies is not None:
            check_indices("RigidContact", "bodies", self.bodies, count)
        for name in ("groups", "masks"):
            bits = getattr(self, name)
            if bits is not None and (
                len(bits) != count or not all(isinstance(b, (int, np.integer)) for b in bits)
            ):
                raise WrongStructure(
                    f"RigidContact.{name}: {bits!r}; give one whole number for each of the {count} bodies"
                )

    @property
    def resists(self) -> bool:
        """Whether it has couples that resist turning."""
        return self.rolling_resistance is not None or self.spinning_resistance is not None

    def chosen(self, count: int) -> tuple[int, ...]:
        """Numbers of the bodies that take part."""
        return tuple(range(count)) if self.bodies is None else tuple(sorted(self.bodies))

    def may_touch(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Whether the groups and masks let bodies (k,) and (k,) touch."""
        all_bits = np.asarray(-1)
        groups, masks = (all_bits if bits is None else np.asarray(bits) for bits in (self.groups, self.masks))
        group, mask = ((lambda i, b=b: b[i] if b.ndim else b) for b in (groups, masks))
        return ((group(first) & mask(second)) != 0) & ((group(second) & mask(first)) != 0)
