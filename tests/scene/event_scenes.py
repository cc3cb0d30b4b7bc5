"""Scenes of one impact whose end is known in closed form, as functions of their numbers, and those ends.

The closed forms are written for themselves: roots of quadratics, and Newton's and Coulomb's laws at one point solved by
hand. Their derivatives are those of these formulas.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import jaxrb as rb

EVENTS = 2


def ended(scene, start, t1, **options):
    """Positions, velocities and angular momenta of the bodies' spins in W at `t1`, as one vector."""
    path = rb.solve_events(scene, start, t1=t1, max_events=EVENTS, on_error="flag", **options)
    final = path.final
    spin = jax.vmap(lambda body, q, w: q.rotate(body.apply(w)))(
        scene.stacked().inertia, final.orientation, final.angular_velocity
    )
    parts = [final.position.ravel(), final.velocity.ravel(), spin.ravel()]
    return jnp.concatenate(parts), path.status.ok & (path.events.count == 1)


def ball_on_plane(n):
    """A ball that meets a tilted plane once."""
    effects = (
        rb.UniformGravity(n["gravity"]),
        rb.RigidContact(rb.HalfSpace(n["normal"], n["offset"]), friction=n["mu"], restitution=n["e"]),
    )
    ball = rb.Body(n["mass"], n["moment"], rb.Sphere(n["radius"]))
    scene = rb.Scene(ball, effects)
    return ended(scene, scene.state(n["position"][None], None, n["velocity"][None], n["spin"][None]), n["t1"])


def ball_on_plane_exact(n):
    normal = n["normal"] / jnp.linalg.norm(n["normal"])
    x, v, g, r = n["position"], n["velocity"], n["gravity"], n["radius"]
    fall, speed, height = g @ normal, v @ normal, x @ normal - n["offset"] - r
    tau = (-speed - jnp.sqrt(speed**2 - 2 * fall * height)) / fall
    x, v = x + tau * v + 0.5 * tau**2 * g, v + tau * g
    impulse = at_point(
        v + jnp.cross(n["spin"], -r * normal), normal, 1 / n["mass"], r**2 / n["moment"], n["e"], n["mu"]
    )
    v, rest = v + impulse / n["mass"], n["t1"] - tau
    spin = n["moment"] * n["spin"] + jnp.cross(-r * normal, impulse)
    return jnp.concatenate([x + rest * v + 0.5 * rest**2 * g, v + rest * g, spin])


def at_point(v, normal, straight, turning, e, mu):
    """The impulse on a ball, or between two, by which the point's velocity v becomes what the laws ask.

    Along the normal its mobility is `straight`, across it `straight + turning`.
    """
    along = v @ normal
    across = v - along * normal
    pressing = -(1 + e) * along / straight
    size = jnp.linalg.norm(across)
    stops = size / (straight + turning)
    return pressing * normal - jnp.minimum(mu * pressing, stops) * across / size


def two_balls(n):
    """Two balls of different size that meet off centre while both fall."""
    bodies = rb.Body(n["masses"], rb.SphericalInertia(n["moments"]), rb.Sphere(n["radii"]), jnp.zeros((2, 3)))
    effects = (
        rb.UniformGravity(n["gravity"]),
        rb.RigidContact(friction=n["mu"], restitution=n["e"]),
    )
    scene = rb.Scene(bodies, effects)
    return ended(scene, scene.state(n["positions"], None, n["velocities"], n["spins"]), n["t1"])


def two_balls_exact(n):
    x, v, r, m, moments = n["positions"], n["velocities"], n["radii"], n["masses"], n["moments"]
    apart, closing = x[1] - x[0], v[1] - v[0]
    a, b, c = closing @ closing, apart @ closing, apart @ apart - (r[0] + r[1]) ** 2
    tau = c / (-b + jnp.sqrt(b * b - a * c))
    x, v = x + tau * v + 0.5 * tau**2 * n["gravity"], v + tau * n["gravity"]
    normal = (x[1] - x[0]) / (r[0] + r[1])
    levers = jnp.stack([r[0] * normal, -r[1] * normal])
    points = v + jnp.cross(n["spins"], levers)
    impulse = at_point(
        points[1] - points[0], normal, jnp.sum(1 / m), jnp.sum(r**2 / moments), n["e"], n["mu"]
    )
    given = jnp.stack([-impulse, impulse])
    v, rest = v + given / m[:, None], n["t1"] - tau
    spin = moments[:, None] * n["spins"] + jnp.cross(levers, given)
    x = x + rest * v + 0.5 * rest**2 * n["gravity"]
    return jnp.concatenate([x.ravel(), (v + rest * n["gravity"]).ravel(), spin.ravel()])


def box_on_plane(n):
    """A box that falls without turning and meets the floor with one corner."""
    effects = (
        rb.UniformGravity(n["gravity"]),
        rb.RigidContact(rb.HalfSpace(), friction=n["mu"], restitution=n["e"]),
    )
    body = rb.Body(n["mass"], rb.PrincipalInertia(n["inertia"]), rb.Box(n["half"]))
    scene = rb.Scene(body, effects)
    turned = rb.Quaternion.exp(n["turn"][None])
    return ended(scene, scene.state(n["position"][None], turned, n["velocity"][None]), n["t1"])


def box_on_plane_exact(n, corner):
    """`corner` (3,) of signs: which corner is the lowest."""
    turn = rb.Quaternion.exp(n["turn"]).as_matrix()
    lever = turn @ (corner * n["half"])
    x, v, g = n["position"], n["velocity"], n["gravity"]
    height = x[2] + lever[2]
    tau = (-v[2] - jnp.sqrt(v[2] ** 2 - 2 * g[2] * height)) / g[2]
    x, v = x + tau * v + 0.5 * tau**2 * g, v + tau * g
    arm = jnp.array([[0, -lever[2], lever[1]], [lever[2], 0, -lever[0]], [-lever[1], lever[0], 0]])
    inverse = turn @ jnp.diag(1 / n["inertia"]) @ turn.T
    mobility = jnp.eye(3) / n["mass"] - arm @ inverse @ arm
    impulse = of_law(mobility, v, -n["e"] * v[2], n["mu"])
    v, rest = v + impulse / n["mass"], n["t1"] - tau
    spin = jnp.cross(lever, impulse)
    return jnp.concatenate([x + rest * v + 0.5 * rest**2 * g, v + rest * g, spin])


def of_law(mobility, v, target, mu):
    """λ with (v + W λ)_z = target and λ_t = −μ λ_z (v + W λ)_t/|…|, or that which stops the point if that is less."""
    sticks = jnp.linalg.solve(mobility, jnp.array([0.0, 0.0, 1.0]) * target - v)

    def slides(impulse, mobility, v, target, mu):
        after = v + mobility @ impulse
        size = jnp.linalg.norm(after[:2])
        return jnp.append(impulse[:2] * size + mu * impulse[2] * after[:2], after[2] - target)

    stuck = jnp.linalg.norm(sticks[:2]) <= mu * sticks[2]
    # The branch that is not taken solves a problem that does slide.
    mu = jnp.where(stuck, 1e-3, mu)

    def newton(impulse, law):
        return impulse - jnp.linalg.solve(
            lax.stop_gradient(jax.jacfwd(slides)(impulse, *law)), slides(impulse, *law)
        )

    pressing = jnp.append(-mu * v[:2] / jnp.linalg.norm(v[:2]), 1.0)
    start = pressing * (target - v[2]) / (mobility @ pressing)[2]
    fixed = lax.stop_gradient((mobility, v, target, mu))
    found, _ = lax.scan(lambda i, _: (newton(i, fixed), None), lax.stop_gradient(start), None, length=30)
    found = newton(lax.stop_gradient(found), (mobility, v, target, mu))
    return jnp.where(stuck, sticks, found)


def _direction(random):
    v = random.normal(size=3)
    return v / np.linalg.norm(v)


def ball_numbers(seed):
    """Numbers of a `ball_on_plane` that meets it once before `t1`."""
    random = np.random.default_rng(seed)
    normal = _direction(random) + np.array([0, 0, 2.0])
    unit = normal / np.linalg.norm(normal)
    radius, offset = random.uniform(0.05, 0.3), random.uniform(-0.3, 0.3)
    gravity = -random.uniform(2, 12) * unit + random.normal(size=3)
    velocity = -random.uniform(0.2, 3) * unit + random.normal(size=3)
    height = random.uniform(0.2, 1.5)
    fall, speed = gravity @ unit, velocity @ unit
    tau = (-speed - np.sqrt(speed**2 - 2 * fall * height)) / fall
    e = random.uniform(0.3, 1.0)
    up = -e * (speed + fall * tau)
    position = (offset + radius + height) * unit + np.cross(unit, random.normal(size=3))
    mass = random.uniform(0.2, 3)
    return {
        "position": position, "velocity": velocity, "spin": 5 * random.normal(size=3), "gravity": gravity,
        "normal": normal, "offset": offset, "radius": radius, "mass": mass,
        "moment": random.uniform(0.3, 0.6) * mass * radius**2, "e": e, "mu": random.uniform(0.02, 1.0),
        "t1": tau + random.uniform(0.2, 0.8) * 2 * up / -fall,
    }  # fmt: skip


def pair_numbers(seed):
    """Numbers of `two_balls` that meet before `t1`."""
    random = np.random.default_rng(seed)
    radii, masses = random.uniform(0.05, 0.3, 2), random.uniform(0.2, 3, 2)
    way = _direction(random)
    aside = np.cross(way, _direction(random))
    aside *= random.uniform(0, 0.8) * radii.sum() / np.linalg.norm(aside)
    gap, speed = random.uniform(0.2, 1.0), random.uniform(0.5, 3.0)
    first = random.normal(size=3)
    positions = np.stack([first, first + (radii.sum() + gap) * way + aside])
    common = random.normal(size=3)
    return {
        "positions": positions, "velocities": np.stack([common, common - speed * way]),
        "spins": 5 * random.normal(size=(2, 3)), "gravity": random.normal(size=3), "radii": radii,
        "masses": masses, "moments": random.uniform(0.3, 0.6, 2) * masses * radii**2,
        "e": random.uniform(0.0, 1.0), "mu": random.uniform(0.02, 1.0),
        "t1": (gap + radii.sum()) / speed + random.uniform(0.1, 0.5),
    }  # fmt: skip


def box_numbers(seed):
    """Numbers of a `box_on_plane` that meets it with one corner, and the signs of that corner."""
    random = np.random.default_rng(seed)
    half, turn = random.uniform(0.05, 0.2, 3), random.normal(size=3)
    matrix = np.asarray(rb.Quaternion.exp(jnp.asarray(turn)).as_matrix(), float)
    corner = -np.sign(matrix[2])
    lowest = (matrix @ (corner * half))[2]
    mass, speed, gravity = random.uniform(0.5, 3), random.uniform(0.5, 3.0), random.uniform(2, 12)
    height = random.uniform(0.2, 1.0)
    tau = (-speed + np.sqrt(speed**2 + 2 * gravity * height)) / gravity
    inertia = (
        mass
        / 3
        * np.array([half[1] ** 2 + half[2] ** 2, half[0] ** 2 + half[2] ** 2, half[0] ** 2 + half[1] ** 2])
    )
    return {
        "position": np.array([*random.normal(size=2), height - lowest]),
        "velocity": np.array([*random.normal(size=2), -speed]), "turn": turn,
        "gravity": np.array([0, 0, -gravity]), "half": half, "mass": mass,
        "inertia": inertia * random.uniform(0.97, 1.03, 3), "e": random.uniform(0.3, 1.0),
        "mu": random.uniform(0.02, 0.6), "t1": tau + 1e-4,
    }, corner  # fmt: skip
