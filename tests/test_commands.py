"""The command line and the notebooks, as a user runs them. They choose float64 themselves, so once is enough."""

import json
import pathlib
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxrb.data import TUMBLING_BRICK

ROOT = pathlib.Path(__file__).resolve().parent.parent
JAXRB = pathlib.Path(sys.executable).with_name("jaxrb")

pytestmark = pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"),
    reason="commands choose their own precision: run once, with the float64 suite",
)


def jaxrb(*arguments, cwd=None):
    command = [str(JAXRB), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False, timeout=300)


@pytest.fixture(scope="module")
def demonstration(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    done = jaxrb("demo", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)


def test_demo_draws_its_pictures(demonstration):
    folder, found = demonstration
    for picture in found["pictures"]:
        assert (folder / picture).stat().st_size > 10_000


def test_demo_shows_the_drift_of_the_lecture(demonstration):
    _, found = demonstration
    last = [row for row in found["drift"] if row["iterations"] == 5000 and row["method"] == "ExplicitEuler"]

    def row(representation, renormalised, torque):
        wanted = {"representation": representation, "renormalised": renormalised, "torque": torque}
        (match,) = [r for r in last if wanted.items() <= r.items()]
        return match

    for torque in (False, True):
        matrix, quaternion = row("rotation matrix", False, torque), row("quaternion", False, torque)
        assert matrix["scale_error"] > 0.1
        assert matrix["skew"] > 0.1
        assert 0.01 < quaternion["scale_error"] < matrix["scale_error"]
        assert row("quaternion", True, torque)["scale_error"] < 1e-15
        assert row("rotation matrix", True, torque)["skew"] < 1e-5
    assert (
        row("quaternion", True, True)["attitude_error_rad"]
        > row("quaternion", True, False)["attitude_error_rad"]
    )


def test_demo_fits_the_bundled_truth(demonstration):
    _, found = demonstration
    assert "I_xx" in found["fit_summary"]
    assert "scale" in found["fit_summary"]


def test_errors_are_told_in_a_line_and_exit_with_one(tmp_path):
    done = jaxrb("fit", tmp_path / "nothing.npz")
    assert done.returncode == 1
    assert "nothing.npz" in done.stderr
    assert "Traceback" not in done.stderr


def test_wrong_command_line_exits_with_two():
    assert jaxrb("fit").returncode == 2


def test_fit_of_the_bundled_recording_prints_json():
    done = jaxrb("fit", TUMBLING_BRICK, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)


def test_simulate_runs_saves_and_draws(tmp_path):
    run = (
        "simulate",
        "block_on_incline",
        "--duration",
        "0.1",
        "--json",
        "--save",
        "run.npz",
        "--plot",
        "run.png",
    )
    done = jaxrb(*run, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["steps"] == 50
    assert facts["precision"] == "float64"
    assert facts["friction_work_j"] < 0
    assert (tmp_path / "run.png").stat().st_size > 10_000
    with np.load(tmp_path / "run.npz") as saved:
        assert saved["time"][-1] == pytest.approx(0.1)


MODEL = """<mujoco model="spin"><option timestep="0.01"/><worldbody><body pos="0 0 1"><freejoint/>
<geom type="box" size=".1 .05 .02" density="700"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("command", "key"),
    [
        (("plan", "spin.xml", "1e-6", "--duration", "0.5"), "tolerance"),
        (("gradient-check", "spin.xml", "--duration", "0.2", "--of", "z"), "scene"),
    ],
)
def test_models_are_scenes_of_every_command(command, key, tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "spin.xml").write_text(MODEL)
    done = jaxrb(*command, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert key in json.loads(done.stdout)


def test_simulate_suggests_the_scene_that_was_meant():
    done = jaxrb("simulate", "domino-rows")
    assert done.returncode == 1
    assert "did you mean domino_row" in done.stderr


@pytest.mark.parametrize("notebook", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda f: f.name)
def test_notebook_runs(notebook, tmp_path):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    content = nbformat.read(notebook, as_version=4)
    images = [o for c in content.cells for o in c.get("outputs", []) if "image/png" in o.get("data", {})]
    assert images, "the stored notebook has no picture to look at"
    client = nbclient.NotebookClient(content, timeout=240, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
