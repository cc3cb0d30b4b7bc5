"""What joints cannot do is refused with a mend; what a scene does not ask for is not in its program."""

import jax
import jax.numpy as jnp
import joint_scenes as js
import numpy as np
import pytest

import jaxrb as rb
from jaxrb.accuracy.cost import count_equations
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.scene.joint_library import JOINT_SCENES, chain
from jaxrb.scene.library import example_of

BOX = rb.Body.from_shape(rb.Box((0.1, 0.2, 0.3)), 500.0)
PAIR = rb.replicate(BOX, 2)
BALL = rb.BallJoint((0, 0, 0.3), bodies=(0, None))


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: rb.BallJoint(bodies=3), "give two body numbers"),
        (lambda: rb.Scene(BOX, rb.BallJoint(bodies=(1, None))), "no body 1 in a scene of 1"),
        (lambda: rb.Scene(PAIR, rb.BallJoint(bodies=(1, 1))), "joined to itself"),
        (lambda: rb.Scene(PAIR, rb.BallJoint(bodies=((0, 1), (1,)))), "equally many"),
        (lambda: rb.Scene(PAIR, rb.BallJoint(np.zeros((3, 3)), bodies=((0, 1), None))), "one value a joint"),
        (lambda: rb.Hinge(bodies=(0, None), drives=rb.UniformGravity()), "give JointSpring"),
        (lambda: rb.Scene(BOX, (BALL, rb.FixedPoint((0, 0, 0.3)))), "BallJoint"),
        (lambda: rb.Scene(BOX, (BALL, rb.PrescribedMotion(lambda t, _: (t, t, t), body=0))), "JointServo"),
        (lambda: rb.joint_error(rb.Scene(BOX), rb.Scene(BOX).state()), "no joints"),
        (lambda: rb.BallJoint(bodies=(0, None)).coordinate(rb.Scene(BOX).state()), "no one coordinate"),
    ],
)  # fmt: skip
def test_wrong_structure_is_refused(build, said):
    with pytest.raises(WrongStructure, match=said):
        build()


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: rb.Hinge((0, 0, 0), bodies=(0, None)), "Hinge.axis"),
        (lambda: rb.Distance(0.0, bodies=(0, None)), "must be positive"),
        (lambda: rb.JointLimit(1.0, 0.5, 10.0), "swap them"),
        (lambda: rb.JointSpring(-1.0), "must not be negative"),
    ],
)
def test_wrong_numbers_are_refused(build, said):
    with pytest.raises(InvalidInput, match=said):
        build()


def test_methods_that_fly_freely_between_pushes_refuse_joints():
    scene = rb.Scene(BOX, BALL)
    state = scene.state((0, 0, -0.3))
    for method in rb.METHODS:
        taken = method in (
            "ExplicitEuler",
            "SemiImplicitEuler",
            "VelocityVerlet",
            "RungeKutta4",
            "ImplicitMidpoint",
        )
        assert rb.METHODS[method]().takes_joints == taken
    with pytest.raises(WrongStructure, match="RungeKutta4"):
        rb.rollout(scene, state, dt=1e-3, steps=1, method="MoserVeselov")
    with pytest.raises(WrongStructure, match="checkpoint"):
        rb.rollout(scene, state, dt=1e-3, steps=1, method="ImplicitMidpoint", adjoint="reversible")
    with pytest.raises(WrongStructure, match=r"rb\.solve"):
        rb.solve_smooth(scene, state, t1=1.0, tolerance=1e-6)


def test_a_start_that_opens_a_joint_is_refused_by_how_much_or_assembled(dtype, tolerance):
    scene = rb.Scene(BOX, BALL)
    with pytest.raises(InvalidInput, match=r"body 0 and the world is open by 0\.1 m"):
        scene.state((0, 0, -0.2))
    with pytest.raises(InvalidInput, match=r"opens with 0\.5"):
        scene.state((0, 0, -0.3), velocity=(0.5, 0, 0))
    state = scene.state((0.1, 0, -0.35), velocity=(0.5, 0, 0), assemble=True)
    assert float(rb.joint_error(scene, state).gap.max()) < tolerance(float64=1e-14, float32=1e-6)
    # Free to turn about the joint, it keeps what part of its motion the joint allows.
    assert 0.1 < float(state.velocity[0, 0]) < 0.5


def test_what_cannot_be_assembled_is_refused():
    apart = rb.Scene(
        BOX, (rb.BallJoint(bodies=(0, None)), rb.BallJoint((0, 0, 0.3), (0, 0, 1.0), bodies=(0, None)))
    )
    with pytest.raises(InvalidInput, match="stay open by"):
        apart.state((0, 0, 0.1), assemble=True)


def test_a_scene_without_joints_has_none_in_its_program():
    def text(scene):
        state = scene.state((0, 0, -0.3))
        return jax.jit(lambda scene, s: rb.step(scene, s)).lower(scene, state).as_text(debug_info=True)

    assert "RungeKutta4/joints" in text(rb.Scene(BOX, BALL))
    assert "RungeKutta4/joints" not in text(rb.Scene(BOX, rb.UniformGravity()))


def equations(scene, state):
    return count_equations(jax.make_jaxpr(lambda scene, s: rb.step(scene, s))(scene, state).jaxpr)


def test_the_program_does_not_grow_with_the_number_of_joints():
    sizes = [equations(example.scene, example.state()) for example in (chain(20), chain(40))]
    assert sizes[0] == sizes[1]


def test_scenes_by_name_start_closed(dtype):
    """The others run in `test_joint_motion.py` and `contact/test_contact_joints.py`."""
    tested = {"double_pendulum", "chain", "bricard", "doll_on_floor", "cart"}
    assert set(JOINT_SCENES) == {"door", "four_bar", "ragdoll"} | tested
    for name in ("door", "four-bar", "ragdoll"):
        assert example_of(name).state().dtype == dtype


def test_hanging_rod_and_cantilever_show_their_reactions(tolerance):
    """A rod at rest pulls with its weight; one held level by a weld also with the moment of its weight."""
    rod = js.rod(1.0, 2.0)
    effects = (
        rb.UniformGravity((0, 0, -10.0)),
        rb.BallJoint((0, 0, 0.5), (0, 0, 0), bodies=(0, None)),
        rb.Weld((0.5, 0, 0), (5.0, 0, 0), bodies=(1, None)),
    )
    scene = rb.Scene((rod, rod), effects)
    hung, held = rb.joint_reactions(scene, scene.state([(0, 0, -0.5), (4.5, 0, 0)]))
    most = tolerance(float64=1e-10, float32=1e-4)
    np.testing.assert_allclose(hung.force, [[0, 0, 20.0]], atol=most)
    np.testing.assert_allclose(hung.torque, [[0, 0, 0]], atol=most)
    np.testing.assert_allclose(held.force, [[0, 0, 20.0]], atol=most)
    np.testing.assert_allclose(held.torque, [[0, 10.0, 0]], atol=most)


def test_drives_push_as_they_say():
    stop = rb.JointLimit(-1.0, 1.0, stiffness=100.0, dissipation=0.5)
    x, v = jnp.asarray([-1.1, 0.0, 1.1, 1.1]), jnp.asarray([0.0, 9.0, 1.0, -9.0])
    np.testing.assert_allclose(stop.effort(x, v), [10.0, 0.0, -15.0, 0.0], rtol=1e-5)
    servo = rb.JointServo(target=1.0, stiffness=10.0, damping=1.0, effort_limit=3.0)
    np.testing.assert_allclose(
        servo.effort(jnp.asarray([0.0, 0.9]), jnp.asarray([0.0, 0.5])), [3.0, 0.5], rtol=1e-4
    )
    motor = rb.JointMotor(speed=2.0, gain=1.0, effort_limit=0.5)
    np.testing.assert_allclose(motor.effort(x[:2], jnp.asarray([1.8, 9.0])), [0.2, -0.5], rtol=1e-4)


def test_a_step_too_long_for_its_joints_is_flagged():
    scene = rb.Scene(js.rod(1.0, 1.0), rb.BallJoint((0, 0, 0.5), bodies=(0, None)))
    state = scene.state((0, 0, -0.5), velocity=(20.0, 0, 0), angular_velocity=(0, -40.0, 0))
    with pytest.warns(rb.JaxrbWarning, match="quarter"):
        path = rb.rollout(scene, state, dt=0.2, steps=2, method="ExplicitEuler", on_error="flag")
    assert not bool(path.status.ok)
    assert int(path.status.first_bad_step[0]) == 1
