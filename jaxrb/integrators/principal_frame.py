"""Principal axes of one inertia tensor by Jacobi's rotations, elementwise: no call to LAPACK for each body."""

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.math.arrays import Array, components, stack

# Convergence is quadratic: five sweeps bring any tensor to round-off, the sixth is for nearly equal moments.
SWEEPS = 6


def principal_frame(six: Array) -> jax.Array:
    """A rotation matrix (3, 3) whose columns are principal axes of the tensor xx, yy, zz, xy, xz, yz (6,).

    In no order of the moments; a diagonal tensor gives the identity. (Jacobi 1846; Golub and Van Loan, "Matrix
    Computations", section 8.5.) It is a constant to derivatives, which it would not have at equal moments.
    """
    xx, yy, zz, xy, xz, yz = components(lax.stop_gradient(six))
    one, zero = jnp.ones_like(xx), jnp.zeros_like(xx)
    start = (
        jnp.stack([xx, yy, zz]),
        jnp.stack([yz, xz, xy]),
        jnp.stack([one, zero, zero, zero, one, zero, zero, zero, one]),
    )

    def turn(index, carry):
        # The three planes in turn: roll the axes so that the plane is always that of the first two.
        moments, products, frame = carry
        p, q, r = moments
        a, b, c = products  # entries (q, r), (p, r), (p, q)
        gap = q - p
        size = jnp.abs(gap) + jnp.sqrt(gap * gap + 4.0 * c * c)
        t = jnp.where(
            size > 0, 2.0 * c * jnp.where(gap >= 0, 1.0, -1.0) / jnp.where(size > 0, size, 1.0), 0.0
        )
        cosine = 1.0 / jnp.sqrt(1.0 + t * t)
        sine = t * cosine
        new = jnp.stack([q + t * c, r, p - t * c])
        # Rolled: the axes (p, q, r) become (q, r, p).
        off = jnp.stack([cosine * b - sine * a, zero, sine * b + cosine * a])
        u, v, w = frame[0:3], frame[3:6], frame[6:9]
        return new, off, jnp.concatenate([sine * u + cosine * v, w, cosine * u - sine * v])

    _, _, frame = lax.fori_loop(0, 3 * SWEEPS, turn, start)
    return stack(frame[0:3], frame[3:6], frame[6:9])
