"""Beyond the list of bad inputs: what was found in use."""

import functools
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import QUICK

import jaxrb as rb
from jaxrb import cli
from jaxrb.accuracy.mujoco_modules import mujoco_modules
from jaxrb.body.euler_equation import solver
from jaxrb.errors import WrongStructure
from jaxrb.geometry.bounds import bounding_box


def run(command):
    environment = os.environ | {"JAX_PLATFORMS": "cpu"}
    return subprocess.run(command, shell=True, env=environment, capture_output=True, text=True, check=False)


def test_a_reader_that_leaves_is_no_error():
    """`jaxrb … | head`"""
    printing = (
        "from jaxrb import cli; cli.COMMANDS = {'x': lambda: lambda: print('x' * 10**6)}; cli.main(['x'])"
    )
    done = run(f'{sys.executable} -c "{printing}" | head -c 1')
    assert done.stdout == "x"
    assert not done.stderr


def test_mujoco_writes_no_file_where_it_is_run(tmp_path):
    pytest.importorskip("mujoco")
    program = """
from jaxrb.accuracy.mujoco_modules import mujoco_modules
mujoco, rollout = mujoco_modules("rollout")
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><body><freejoint/><geom size=".1" mass="1"/></body></worldbody></mujoco>')
data = mujoco.MjData(model)
data.qvel[:] = 1e300
for _ in range(3):
    mujoco.mj_step(model, data)
assert abs(data.qvel).max() < 1e3  # it was reset, which it says in a file
"""
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    assert not list(tmp_path.iterdir())
    assert len(mujoco_modules("rollout")) == 2


@pytest.mark.parametrize("end", ["x", None, True, [1.0, 2.0]])
def test_an_end_that_is_no_number_is_refused(end):
    scene = rb.Scene(rb.Body(1.0, 1.0))
    with pytest.raises(WrongStructure, match="t1"):
        rb.solve(scene, scene.state(), t1=end)


def test_a_pose_may_be_given_as_a_tuple():
    part = (rb.Sphere(0.1), rb.Pose((0.0, 1.0, 2.0), rb.Quaternion(np.asarray([1.0, 0.0, 0.0, 0.0]))))
    shape = rb.Composite((part, part))

    @functools.partial(jax.jit, compiler_options=QUICK)
    def found():
        return bounding_box(shape).low, shape.mass_properties(1.0).center_of_mass

    low, center = found()
    assert np.allclose(low, [-0.1, 0.9, 1.9])
    assert np.allclose(center, [0.0, 1.0, 2.0])


def test_centres_of_mass_of_another_number_of_bodies_are_refused():
    moments = rb.PrincipalInertia(np.tile([1.0, 2.0, 2.5], (4, 1)))
    with pytest.raises(
        WrongStructure, match=r"bodies axes differ: mass \(4,\).*center_of_mass \(3,\).*replicate"
    ):
        rb.Body([1.0, 2.0, 3.0, 4.0], moments, center_of_mass=np.zeros((3, 3)))


def test_one_centre_of_mass_and_one_shape_serve_all_bodies_of_an_axis():
    """They failed inside `vmap`, with its own words."""
    moments = rb.PrincipalInertia(np.tile([1.0, 2.0, 2.5], (4, 1)))
    body = rb.Body([1.0, 2.0, 3.0, 4.0], moments, rb.Box((0.1, 0.1, 0.2)), (0.0, 0.0, 0.1))
    assert body.center_of_mass.shape == (4, 3)
    assert body.shape.half_extents.shape == (4, 3)
    scene = rb.Scene(body, (rb.UniformGravity(), rb.QuadraticDrag(0.4, 0.02)))
    assert rb.energy(scene, scene.state()).shape == ()
    single = rb.Body(1.0, rb.PrincipalInertia([1.0, 2.0, 2.5]), rb.Box((0.1, 0.1, 0.2)), (0.0, 0.0, 0.1))
    assert single.center_of_mass.shape == (3,)

    def mass_of_world(mass):
        return rb.momentum(rb.Scene(rb.Body(mass, moments)), scene.state(velocity=(1.0, 0, 0)))[0]

    assert np.allclose(jax.vmap(mass_of_world)(jnp.ones((2, 4))), 4.0)


@pytest.mark.parametrize("size", [1e-20, 1e-13, 1.0, 1e12])
def test_a_full_inertia_has_an_inverse_whatever_its_size(size, tolerance):
    """In float32 the determinant of 1e-13 kg m² is no number."""
    matrix = np.asarray([[1.0, 0.1, 0.0], [0.1, 1.5, 0.1], [0.0, 0.1, 1.2]])
    six = jnp.asarray(size * np.asarray([1.0, 1.5, 1.2, 0.1, 0.0, 0.1]))
    inverse = solver(rb.FullInertia(six)).inverted().as_matrix()
    exact = np.linalg.inv(matrix) / size
    assert np.abs(np.asarray(inverse, float) / exact.max() - exact / exact.max()).max() < tolerance(
        float64=1e-15, float32=1e-6
    )


@pytest.mark.parametrize("debug", [False, True])
def test_debug_finds_the_first_result_that_is_no_number(monkeypatch, capsys, debug):
    monkeypatch.setattr(cli, "COMMANDS", {"x": lambda: lambda: print(jax.jit(jnp.sqrt)(-1.0))})
    if not debug:
        cli.main(["x"])
        assert "nan" in capsys.readouterr().out
        return
    with pytest.raises(SystemExit):
        cli.main(["x", "--debug"])
    said = capsys.readouterr().err
    assert "Traceback" in said
    assert "jaxrb: --debug found a result that is no number: invalid value (nan)" in said


def test_debug_shows_where_an_error_comes_from(monkeypatch, capsys):
    monkeypatch.setattr(cli, "COMMANDS", {"x": lambda: lambda: rb.Body(-1.0, 1.0)})
    for arguments, shown in (["x"], False), (["x", "--debug"], True):
        with pytest.raises(SystemExit):
            cli.main(arguments)
        said = capsys.readouterr().err
        assert ("Traceback" in said) == shown
        assert "jaxrb: Body.mass is -1.0 kg" in said
