"""Newton's method on the sphere of normals, for the smallest overlap F(n) = h_a(n) + h_b(−n) near a known direction.

The gradient of a support function is the support point, so the gradient of F on the sphere is the part of the
difference w = x_a(n) − x_b(−n) across n, and its Hessian is that of the support functions less F times the identity.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.collision.gjk import Support
from jaxrb.collision.lanes import cross, first_of, row, unit
from jaxrb.math.vector import dot_of as dot


def tangents(normal: Any) -> tuple[Any, Any]:
    """Two unit vectors (3, L) across unit vectors (3, L) and each other."""
    x, y, z = normal
    flat = jnp.abs(z) < 0.7
    zero = jnp.zeros_like(x)
    first = unit(jnp.where(flat, jnp.stack([-y, x, zero]), jnp.stack([zero, -z, y])))
    return first, cross(normal, first)


def newton(
    supports: tuple[Support, Support], normal: Any, value: Any, scale: Any, turns: int
) -> tuple[Any, Any]:
    """Directions (3, L) and overlaps (L,) that are no worse, `turns` steps on; only steps that help are taken."""

    def difference(n: Any) -> Any:
        return supports[0](n)[0] - supports[1](-n)[0]

    def turn(_: Any, carry: Any) -> Any:
        normal, value = carry
        basis = tangents(normal)
        w = difference(normal)
        gradient = [dot(t, w) for t in basis]
        bent = [jax.jvp(difference, (normal,), (t,))[1] for t in basis]
        overlap = dot(normal, w)
        a = dot(basis[0], bent[0]) - overlap
        b = 0.5 * (dot(basis[0], bent[1]) + dot(basis[1], bent[0]))
        c = dot(basis[1], bent[1]) - overlap
        determinant = a * c - b * b
        convex = (determinant > 0) & (a + c > 0)
        safe = jnp.where(convex, determinant, 1.0)
        steps = [-(c * gradient[0] - b * gradient[1]) / safe, -(a * gradient[1] - b * gradient[0]) / safe]
        # Where the surface bends the other way a step downhill leads out of there.
        stiffness = jnp.abs(a) + jnp.abs(b) + jnp.abs(c)
        slope = [-g / jnp.where(stiffness > 0, stiffness, 1.0) for g in gradient]
        steps = [jnp.where(convex, step, down) for step, down in zip(steps, slope)]
        tried = unit(normal + steps[0] * basis[0] + steps[1] * basis[1])
        new = dot(tried, difference(tried))
        # Equal but for round-off is better too: near the minimum the value no longer tells, the step still does.
        better = new <= value + 4 * jnp.finfo(value.dtype).eps * scale
        return jnp.where(better, tried, normal), jnp.where(better, new, value)

    return lax.fori_loop(0, turns, turn, (normal, value))


class Ruling(NamedTuple):
    """Normals of a body that touch it along a whole straight line, where F has a kink: n · `axis` = `cosine`.

    `axis` (3, L): the axis of a cylinder or cone, an edge of a polytope; zero where there is none. `cosine` (L,).
    """

    axis: Any
    cosine: Any


def along_rulings(
    supports: tuple[Support, Support], normal: Any, value: Any, scale: Any, rulings: list[Ruling], turns: int
) -> tuple[Any, Any]:
    """`newton` among the normals of each ruling, and where those of both meet; nothing where there is none."""
    if not rulings:
        return normal, value

    def one(carry: Any, ruling: Ruling) -> Any:
        return _along(supports, carry[0], carry[1], scale, ruling, turns), None

    stacked = jax.tree.map(lambda *x: jnp.stack(x), *rulings)
    (normal, value), _ = lax.scan(one, (normal, value), stacked)
    if len(rulings) == 1:
        return normal, value
    return _where_both_meet(supports, normal, value, *rulings)


def _along(
    supports: tuple[Support, Support], normal: Any, value: Any, scale: Any, ruling: Ruling, turns: int
) -> Any:
    axis, cosine = ruling
    sine = jnp.sqrt(1.0 - cosine * cosine)
    tolerance = 4 * jnp.finfo(value.dtype).eps * scale

    def onto(n: Any) -> Any:
        """The nearest normal of the ruling, and whether there is one."""
        side = n - dot(n, axis) * axis
        return unit(cosine * axis + sine * unit(side)), (dot(side, side) > 1e-6) & (dot(axis, axis) > 0)

    def difference(n: Any) -> Any:
        return supports[0](n)[0] - supports[1](-n)[0]

    def turn(_: Any, carry: Any) -> Any:
        normal, value = carry
        level, there = onto(normal)
        tangent = cross(axis, level)
        w, bent = jax.jvp(difference, (level,), (tangent,))
        # On the circle n'' = −(n − (n · axis) axis).
        stiffness = dot(tangent, bent) - (dot(level, w) - cosine * dot(axis, w))
        step = -dot(tangent, w) / jnp.where(stiffness != 0, jnp.abs(stiffness), 1.0)
        tried, still = onto(level + jnp.clip(step, -0.5, 0.5) * tangent)
        new = dot(tried, difference(tried))
        better = there & still & (new <= value + tolerance)
        return jnp.where(better, tried, normal), jnp.where(better, new, value)

    return lax.fori_loop(0, turns, turn, (normal, value))


def _where_both_meet(
    supports: tuple[Support, Support], normal: Any, value: Any, one: Ruling, other: Ruling
) -> tuple[Any, Any]:
    """The two normals n with n · u = α and n · v = β, where they are better."""
    u, v, k = one.axis, other.axis, dot(one.axis, other.axis)
    across = 1.0 - k * k
    apart = (dot(u, u) > 0) & (dot(v, v) > 0) & (across > 1e-6)
    across = jnp.where(apart, across, 1.0)
    p, q = (one.cosine - k * other.cosine) / across, (other.cosine - k * one.cosine) / across
    rest = 1.0 - p * p - q * q - 2.0 * p * q * k
    height = jnp.sqrt(jnp.where(rest > 0, rest, 0.0) / across)
    for sign in (1.0, -1.0):
        tried = unit(p * u + q * v + sign * height * cross(u, v))
        new = dot(tried, supports[0](tried)[0] - supports[1](-tried)[0])
        better = apart & (rest >= 0) & (new <= value)
        normal, value = jnp.where(better, tried, normal), jnp.where(better, new, value)
    return normal, value


def best_of_many(
    supports: tuple[Support, Support], directions: Any, known: Any, scale: Any, count: int, turns: int = 8
) -> tuple[Any, Any]:
    """The best `count` directions (count, 3, L) and their overlaps (count, L), the best first, from several starts: the
    `known` ones (k, 3, L) and, of all `directions` (m, 3, L), the four with the smallest overlap. None of these are
    close to each other; where there are no more the last stands for the rest.
    """

    def value(normal: Any) -> Any:
        return dot(normal, supports[0](normal)[0]) - dot(normal, supports[1](-normal)[0])

    starts = jnp.stack([*known, *_apart(directions, jax.vmap(value)(directions), 4, 0.9)[0]])
    normals, depths = jax.vmap(lambda n: newton(supports, n, value(n), scale, turns))(starts)
    normals, depths = _apart(normals, depths, count, 0.995)
    return jnp.stack(normals), jnp.stack(depths)


def _apart(directions: Any, values: Any, count: int, cosine: float) -> tuple[list[Any], list[Any]]:
    """Of directions (m, 3, L) those `count` with the smallest values (m, L), each farther from those before than the
    angle of this cosine."""
    found, least = [], []
    for _ in range(count):
        smallest = values.min(axis=0)
        there = smallest < jnp.inf
        which = row(directions, first_of(values <= smallest))
        found.append(jnp.where(there, which, found[-1]) if found else which)
        least.append(jnp.where(there, smallest, least[-1]) if least else smallest)
        near = (directions * found[-1]).sum(axis=1) > cosine
        values = jnp.where(near, jnp.inf, values)
    return found, least
