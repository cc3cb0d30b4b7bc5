"""What a scene does not ask of contact is not in its program; what it asks wrongly is refused, naming the remedy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from contact_scenes import DOWN
from jax.interpreters import partial_eval

import jaxrb as rb
from jaxrb.effects.rigid_contact import RigidContact

FLOOR = rb.HalfSpace()
BALL = rb.Body.from_shape(rb.Sphere(0.1), 500.0)
BOX = rb.Body.from_shape(rb.Box((0.1, 0.1, 0.1)), 500.0)


def program(scene):
    """Number of equations of a step after dead code is removed, and the primitives in it."""
    closed = jax.make_jaxpr(lambda scene, s: rb.step(scene, s))(scene, scene.state())
    live, _ = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    names = []

    def walk(jaxpr):
        for equation in jaxpr.eqns:
            names.append(equation.primitive.name)
            for value in equation.params.values():
                for sub in value if isinstance(value, (tuple, list)) else (value,):
                    if hasattr(sub, "eqns") or hasattr(sub, "jaxpr"):
                        walk(getattr(sub, "jaxpr", sub))

    walk(live)
    return names


def test_laws_that_are_not_asked_for_are_not_compiled():
    bare, friction, restitution = (
        program(rb.Scene(BALL, rb.RigidContact(FLOOR, **laws)))
        for laws in ({}, {"friction": 0.5}, {"restitution": 0.5})
    )
    assert len(bare) < len(friction)
    assert len(bare) < len(restitution)
    assert restitution.count("scan") == bare.count("scan") + 1  # the rounds of impacts
    assert friction.count("scan") == bare.count("scan")
    without = program(rb.Scene(BALL))
    assert "while" not in without
    assert "while" in bare


def test_scene_in_which_nothing_can_meet_has_no_contact_in_its_program():
    alone = rb.Scene(BALL, rb.RigidContact())
    assert program(alone) == program(rb.Scene(BALL))
    path = rb.rollout(alone, alone.state(), dt=1e-3, steps=1)
    assert path.contact is None
    pair = rb.replicate(BALL, 2)
    apart = rb.Scene(pair, rb.RigidContact(groups=(1, 2), masks=(1, 2)))
    assert program(apart) == program(rb.Scene(pair))


def meetings(scene):
    contact = scene.prepared(jnp.zeros(()).dtype).contact
    return sorted((int(i), int(j)) for m in contact.meetings for i, j in zip(m.first, m.second))


def test_pairs_that_never_meet_are_not_in_the_program():
    """Bits of groups and masks: each one's mask must hold a bit of the other's group. `bodies` leaves out others."""
    four = rb.replicate(BALL, 4)
    assert meetings(rb.Scene(four, rb.RigidContact())) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    chain = rb.RigidContact(groups=(1, 2, 4, 8), masks=(2, 5, 10, 4))
    assert meetings(rb.Scene(four, chain)) == [(0, 1), (1, 2), (2, 3)]
    # One-sided consent is none.
    assert meetings(rb.Scene(four, rb.RigidContact(groups=(1, 2, 4, 4), masks=(2, 1, 1, 0)))) == [(0, 1)]
    assert meetings(rb.Scene(four, rb.RigidContact(bodies=(0, 2)))) == [(0, 2)]
    few, every = (program(rb.Scene((four, BOX), rb.RigidContact(bodies=b))) for b in ((0, 1), None))
    assert len(few) < 0.9 * len(every)


def test_balls_of_other_groups_pass_through_each_other(tolerance):
    pair = rb.replicate(BALL, 2)
    scene = rb.Scene(pair, rb.RigidContact(restitution=1.0, groups=(1, 2), masks=(1, 2)))
    state = scene.state(position=[(0, 0, 0), (0.3, 0, 0)], velocity=[(1, 0, 0), (-1, 0, 0)])
    final = rb.rollout(scene, state, dt=1e-2, steps=50).final
    assert np.asarray(final.velocity)[:, 0] == pytest.approx([1, -1], abs=1e-6)


@pytest.mark.parametrize(
    ("bodies", "effects", "words"),
    [
        (rb.Body(1.0, 1.0), rb.RigidContact(FLOOR), "has no shape"),
        (rb.replicate(rb.Body(1.0, 1.0, name="thing"), 2), rb.RigidContact(), "thing.*has no shape"),
        (rb.Body(1.0, 1.0, FLOOR), rb.RigidContact(), "half-space"),
        (
            rb.replicate(BALL, 2),
            (rb.RigidContact(FLOOR), rb.FixedPoint((0, 0, 0.1), bodies=(0,))),
            "FixedPoint",
        ),
        (rb.replicate(BALL, 2), rb.RigidContact(FLOOR, friction=np.ones(3)), "friction"),
        (rb.replicate(BALL, 2), rb.RigidContact(groups=(1, 2, 3)), "groups.*2 bodies"),
        (rb.replicate(BALL, 2), rb.RigidContact(masks=(1,)), "masks.*2 bodies"),
        (rb.replicate(BALL, 2), rb.RigidContact(groups=(1.5, 2)), "groups"),
        (rb.replicate(BALL, 2), rb.RigidContact(bodies=(0, 2)), "bodies"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_scenes_that_cannot_be_are_refused(bodies, effects, words):
    with pytest.raises(rb.WrongStructure, match=words):  # noqa: PT012 - some show only when the program is traced
        scene = rb.Scene(bodies, effects)
        scene.prepared(jnp.zeros(()).dtype)


def test_mesh_is_refused_as_body_and_as_obstacle():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    mesh = rb.TriangleMesh(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    scene = rb.Scene(rb.Body(1.0, 1.0, mesh), rb.RigidContact(FLOOR))
    with pytest.raises(rb.WrongStructure, match=r"not convex.*convex_hull"):
        scene.prepared(jnp.zeros(()).dtype)
    with pytest.raises(rb.WrongStructure, match=r"not convex.*convex_hull"):
        rb.RigidContact(mesh)


@pytest.mark.parametrize(
    ("error", "options", "words"),
    [
        (rb.InvalidInput, {"friction": -0.1}, "friction"),
        (rb.InvalidInput, {"restitution": 1.5}, "restitution"),
        (rb.InvalidInput, {"restitution": -0.5}, "restitution"),
        (rb.InvalidInput, {"friction": float("nan")}, "friction"),
        (rb.InvalidInput, {"recovery_speed": 0.0}, "recovery_speed"),
        (rb.InvalidInput, {"friction": [0.5, -0.5]}, "friction"),
        (rb.WrongStructure, {"combine": "harmonic"}, "combine.*geometric"),
        (rb.InvalidInput, {"capacity": 0}, "capacity"),
        (rb.InvalidInput, {"tolerance": 1.0}, "tolerance"),
        (rb.WrongStructure, {"against": 3.0}, "against"),
        (rb.WrongStructure, {"against": (FLOOR, FLOOR, "floor")}, "against"),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_laws_that_cannot_be_are_refused(error, options, words):
    with pytest.raises(error, match=words):
        RigidContact(**options)


def test_more_pairs_than_there_is_room_for_is_said():
    """Five balls in a heap, room for two pairs."""
    scene = rb.Scene(rb.replicate(BALL, 5), (rb.UniformGravity(DOWN), rb.RigidContact(capacity=2)))
    heap = [(0, 0, 0), (0.15, 0, 0), (0, 0.15, 0), (0, 0, 0.15), (0.1, 0.1, 0.1)]
    apart = [(k, 0, 0) for k in range(5)]
    assert bool(rb.rollout(scene, scene.state(position=apart), dt=1e-3, steps=3).status.ok)
    with pytest.raises(rb.RunFailed, match="capacity"):
        rb.rollout(scene, scene.state(position=heap), dt=1e-3, steps=3)
    path = rb.rollout(scene, scene.state(position=heap), dt=1e-3, steps=3, on_error="flag")
    assert not bool(path.status.ok)
    assert int(path.contact.overflow[-1]) == 0
    assert np.isfinite(np.asarray(path.final.position)).all()
    with pytest.raises(rb.LimitExceeded, match="capacity"):
        rb.step(scene, scene.state(position=heap))
    traced = jax.jit(lambda state: rb.step(scene, state))(scene.state(position=heap))
    assert np.isnan(np.asarray(traced.position)).all()


@pytest.mark.parametrize(
    ("run", "mend"),
    [
        (lambda scene, s: rb.solve(scene, s, t1=1.0), "rb.rollout"),
        (lambda scene, s: rb.solve_smooth(scene, s, t1=1.0), "rb.rollout"),
        (lambda scene, s: rb.free_flight(scene, s, 1.0), "rb.rollout"),
        (
            lambda scene, s: rb.rollout(
                scene, s, dt=1e-3, steps=2, method=rb.ImplicitMidpoint(), adjoint="reversible"
            ),
            "checkpoint",
        ),
    ],
    ids=["solve", "solve_smooth", "free_flight", "reversible"],
)
def test_runs_that_know_only_forces_refuse_contact(run, mend):
    scene = rb.Scene(BALL, rb.RigidContact(FLOOR))
    with pytest.raises(rb.WrongStructure, match=f"RigidContact.*{mend}"):
        run(scene, scene.state(position=(0, 0, 0.2)))
