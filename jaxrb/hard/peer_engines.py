"""Flights in other engines, in whichever Python has them: a program of its own, which knows nothing of jaxrb.

    python peer_engines.py mjx < flights.json > states.json

A flight is an object of `kind` ("free", "boxes", "ellipsoid", "cylinder"), `masses` (n) [kg], `inertia` (n, 6) xx, yy,
zz, xy, xz, yz [kg m²], `half` (3,) [m] of a box around the shape, `places` (n, 3), `turns` (n, 4) wxyz, `velocities`,
`spins` (n, 3), `dt`, `steps`, `friction`, `damping` [N s/m and N m s/rad] of the medium.
The answer has for each flight `saves` + 1 rows of (n, 13): place, turn, velocity in the world, spin in the body.
"""

import importlib
import json
import sys

import numpy as np

GRAVITY = -9.81
SAVES = 20


def model_text(flight: dict, method: str | None = None) -> str:
    """The flight in MJCF; contact is MuJoCo's default, but for friction. `method`: else RK4 where nothing acts."""
    free = flight["kind"] == "free"
    half = flight["half"][1:] if flight["kind"] == "cylinder" else flight["half"]
    size = " ".join(repr(float(x)) for x in half)
    shape = f'<geom type="{flight["kind"].removesuffix("es")}" size="{size}"/>'
    if free:  # Brax needs a shape, if only one that touches nothing
        shape = '<geom type="sphere" size="0.1" contype="0" conaffinity="0"/>'
    damped = flight.get("damping", 0.0)
    joint = f'<joint type="free" damping="{damped!r}"/>' if damped else "<freejoint/>"
    bodies = "".join(
        f'<body>{joint}<inertial pos="0 0 0" mass="{mass!r}" fullinertia="{" ".join(map(repr, six))}"/>'
        f"{shape}</body>"
        for mass, six in zip(flight["masses"], flight["inertia"], strict=True)
    )
    floor = "" if free else '<geom type="plane" size="50 50 1"/>'
    kind, down = method or ("RK4" if free else "Euler"), 0.0 if free else GRAVITY
    return (
        f'<mujoco><option timestep="{flight["dt"]!r}" gravity="0 0 {down}" integrator="{kind}"/>'
        f'<default><geom friction="{flight["friction"]} 0 0" condim="3"/></default>'
        f"<worldbody>{floor}{bodies}</worldbody></mujoco>"
    )


def start(flight: dict) -> tuple[np.ndarray, np.ndarray]:
    """qpos and qvel, of which MuJoCo keeps the spin of a free joint in the body's axes."""
    place = np.concatenate([np.asarray(flight["places"], float), np.asarray(flight["turns"], float)], axis=1)
    speed = np.concatenate(
        [np.asarray(flight["velocities"], float), np.asarray(flight["spins"], float)], axis=1
    )
    return place.ravel(), speed.ravel()


def rows(place: np.ndarray, speed: np.ndarray, count: int) -> np.ndarray:
    """(k, n, 13) from (k, 7 n) and (k, 6 n)."""
    place, speed = (np.asarray(part, float).reshape(len(part), count, -1) for part in (place, speed))
    return np.concatenate([place, speed], axis=-1)


def in_mujoco(flights: list[dict]) -> list[np.ndarray]:
    """MuJoCo in C, float64."""
    mujoco = importlib.import_module("mujoco")

    found = []
    for flight in flights:
        model = mujoco.MjModel.from_xml_string(model_text(flight))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = start(flight)
        kept = [(data.qpos.copy(), data.qvel.copy())]
        for _ in range(SAVES):
            for _ in range(flight["steps"] // SAVES):
                mujoco.mj_step(model, data)
            kept.append((data.qpos.copy(), data.qvel.copy()))
        places, speeds = zip(*kept, strict=True)
        found.append(rows(np.stack(places), np.stack(speeds), len(flight["masses"])))
    return found


def in_mjx(flights: list[dict]) -> list[np.ndarray]:
    """MJX in JAX: flights of one structure are worlds of one program."""
    import jax

    mujoco, mjx = importlib.import_module("mujoco"), importlib.import_module("mujoco.mjx")

    def path(model, data, steps):
        def save(now, _):
            now = jax.lax.fori_loop(0, steps // SAVES, lambda _, d: mjx.step(model, d), now)
            return now, (now.qpos, now.qvel)

        first = (data.qpos, data.qvel)
        later = jax.lax.scan(save, data, None, length=SAVES)[1]
        return jax.tree.map(lambda a, b: jax.numpy.concatenate([a[None], b]), first, later)

    def worlds(group):
        models = [mujoco.MjModel.from_xml_string(model_text(flight)) for flight in group]
        put = [mjx.put_model(model) for model in models]
        if (
            len({jax.tree.structure(model) for model in put}) > 1
        ):  # bodies of equal moments are another program
            return [worlds([flight])[0] for flight in group]
        stacked = jax.tree.map(lambda *x: jax.numpy.stack(x), *put)
        datas = [mjx.make_data(model) for model in models]
        begun = [d.replace(qpos=jax.numpy.asarray(q), qvel=jax.numpy.asarray(v))
                 for d, (q, v) in zip(datas, map(start, group), strict=True)]  # fmt: skip
        data = jax.tree.map(lambda *x: jax.numpy.stack(x), *begun)
        run = jax.jit(jax.vmap(lambda m, d: path(m, d, group[0]["steps"])))
        places, speeds = run(stacked, data)
        count = len(group[0]["masses"])
        return [rows(q, v, count) for q, v in zip(np.asarray(places), np.asarray(speeds), strict=True)]

    return _by_structure(flights, worlds)


def in_brax(flights: list[dict]) -> list[np.ndarray | None]:
    """Brax with its own "positional" dynamics; boxes and free bodies, of which it has the shapes."""
    import jax
    from brax.io import mjcf
    from brax.positional import pipeline

    def worlds(group):
        if group[0]["kind"] in ("ellipsoid", "cylinder"):
            return [None] * len(group)
        found = []
        system = mjcf.loads(model_text(group[0], "Euler"))  # the only one it has
        masses = jax.numpy.asarray([flight["masses"] for flight in group])
        inertia = jax.numpy.asarray([_matrices(flight) for flight in group])
        begun = [start(flight) for flight in group]
        q, qd = (jax.numpy.stack([jax.numpy.asarray(part[i]) for part in begun]) for i in (0, 1))

        def path(mass, tensor, q, qd):
            own = system.tree_replace({"link.inertia.mass": mass, "link.inertia.i": tensor})
            state = pipeline.init(own, q, qd)

            def save(now, _):
                now = jax.lax.fori_loop(
                    0, group[0]["steps"] // SAVES, lambda _, s: pipeline.step(own, s, jax.numpy.zeros(0)), now
                )
                return now, (now.x.pos, now.x.rot, now.xd.vel, now.xd.ang)

            first = (state.x.pos, state.x.rot, state.xd.vel, state.xd.ang)
            later = jax.lax.scan(save, state, None, length=SAVES)[1]
            return jax.tree.map(lambda a, b: jax.numpy.concatenate([a[None], b]), first, later)

        parts = jax.jit(jax.vmap(path))(masses, inertia, q, qd)
        for place, turn, velocity, spin in zip(*map(np.asarray, parts), strict=True):
            found.append(np.concatenate([place, turn, velocity, _unturned(turn, spin)], axis=-1))
        return found

    return _by_structure(flights, worlds)


def _matrices(flight: dict) -> np.ndarray:
    return np.asarray([[[a, d, e], [d, b, f], [e, f, c]] for a, b, c, d, e, f in flight["inertia"]])


def _unturned(wxyz: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A vector of the world in the body's axes."""
    w, u = wxyz[..., :1], -wxyz[..., 1:]
    t = 2 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def _accepted(flight: dict) -> bool:
    """Whether MuJoCo's compiler, which all of them use, takes such a body."""
    mujoco = importlib.import_module("mujoco")

    try:
        mujoco.MjModel.from_xml_string(model_text(flight))
    except ValueError:
        return False
    return True


def _by_structure(flights: list[dict], worlds) -> list:
    groups: dict[tuple, list[int]] = {}
    for i, flight in enumerate(flights):
        key = (flight["kind"], len(flight["masses"]), flight["dt"], flight["steps"], tuple(flight["half"]))
        groups.setdefault(key if flight["kind"] != "ellipsoid" else key[:4], []).append(i)
    found = [None] * len(flights)
    groups = {key: [i for i in members if _accepted(flights[i])] for key, members in groups.items()}
    for members in filter(None, groups.values()):
        for i, answer in zip(members, worlds([flights[i] for i in members]), strict=True):
            found[i] = answer
    return found


ENGINES = {"mujoco": in_mujoco, "mjx": in_mjx, "brax": in_brax}

if __name__ == "__main__":
    answers = ENGINES[sys.argv[1]](json.load(sys.stdin))
    print(json.dumps([None if answer is None else answer.tolist() for answer in answers]))
