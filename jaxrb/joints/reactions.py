"""What joints make of impulses: a blow to one body is felt by all that hang on it, at the same moment.

An impulse p on the bodies brings with it those of the joints, −Jᵀ μ, with which no joint opens: J W (p − Jᵀ μ) = 0,
W the inverse of the mass matrix. So contact sees the bodies as M⁻¹ − M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J M⁻¹ moves them, its law and
its unknowns are those of free bodies, and joints are exact whatever the tolerance of the contact solve.

Tried and left: rows of joints as contacts without a cone, with the compliance of the contact solve (1e-5). Each body's
own 6×6 block, which preconditions that solve, does not know of its neighbours: one direction of Newton to 1e-6 takes 8
products of the matrix for a chain of 2 links, 33 for 10, 112 for 50, and joints stay open by the tolerance. As here it
takes none where bodies touch only what stands still.
(Gould, Hribar, Nocedal 2001, SIAM J. Sci. Comput. 23, 1376, for equality constraints within conjugate gradients.)
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.joints.banded import Banded, blocked, unblocked
from jaxrb.joints.pattern import Pattern, pattern_of
from jaxrb.math.arrays import Array, Scalar

_EXPLICIT = 256  # rows up to which an inverse written out is the cheaper to apply, and to compile


class JointReactions(eqx.Module):
    """The joints of n bodies at one pose. Motions (v, ω) and impulses (n, 6) are in W, ω and turning impulses too.

    `derivative` (rows, 2, 6): J, of body a and of body b of each row. `inverse` (n, 6, 6): W. `matrix`: J W Jᵀ, and
    `solved` (rows, rows) its inverse, None where the matrix is asked instead.
    """

    derivative: Array
    inverse: Array
    matrix: Banded
    solved: Array | None
    bodies: tuple[tuple[int, int], ...] = eqx.field(static=True)
    count: int = eqx.field(static=True)

    @property
    def pattern(self) -> Pattern:
        """Which rows meet."""
        return pattern_of(self.bodies, self.count)

    @property
    def diagonal(self) -> Scalar:
        """Of J W Jᵀ (rows,): by how much a joint's unit impulse opens it."""
        return unblocked(jnp.diagonal(self.matrix.diagonal, axis1=-2, axis2=-1), self.pattern.place)

    def against(self, inverse: Array) -> "JointReactions":
        """The same joints with another W (n, 6, 6)."""
        return reactions(self.derivative, inverse, self.bodies, self.count, often=False)

    def borne(self, impulse: Array) -> Array:
        """What the bodies feel (n, 6) of an impulse on them, that of the joints included."""
        return impulse - self.pushed(self.multipliers(impulse))

    def multipliers(self, impulse: Array) -> Scalar:
        """μ (rows,)."""
        opening = self.rate(jnp.sum(self.inverse * impulse[:, None, :], axis=-1))
        return _solved(self.matrix, self.pattern, opening) if self.solved is None else self.solved @ opening

    def rate(self, motion: Array) -> Scalar:
        """J u (rows,): how fast joints open."""
        padded = jnp.concatenate([motion, jnp.zeros_like(motion[:1])])
        return jnp.sum(self.derivative * padded[self.pattern.bodies], axis=(1, 2))

    def pushed(self, size: Scalar) -> Array:
        """Jᵀ μ (n, 6)."""
        rows = jnp.zeros((self.count + 1, 6), size.dtype)
        return rows.at[self.pattern.bodies].add(self.derivative * size[:, None, None])[: self.count]


def reactions(
    derivative: Array, inverse: Array, bodies: tuple[tuple[int, int], ...], count: int, *, often: bool
) -> JointReactions:
    """Rows J (rows, 2, 6) between `bodies`, with W (n, 6, 6), factorised; `often`: for many impulses."""
    pattern = pattern_of(bodies, count)
    index = np.minimum(pattern.bodies, count - 1)  # the world's derivatives are zero
    response = jnp.sum(inverse[index] * derivative[:, :, None, :], axis=-1)
    one, other, side_of_one, side_of_other = pattern.pairs
    entry = jnp.sum(derivative[one, side_of_one] * response[other, side_of_other], axis=-1)
    matrix = Banded.of_entries(one, other, entry, pattern.place, pattern.width)
    solved = None
    if often and len(bodies) <= _EXPLICIT:
        solved = jax.vmap(lambda unit: _solved(matrix, pattern, unit))(
            jnp.eye(len(bodies), dtype=entry.dtype)
        )
    return JointReactions(derivative, inverse, matrix, solved, bodies, count)


def _solved(matrix: Banded, pattern: Pattern, right: Scalar) -> Scalar:
    return unblocked(matrix.solve(blocked(right, pattern.place, pattern.width)), pattern.place)
