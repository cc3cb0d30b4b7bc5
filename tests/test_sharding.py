"""Worlds laid over several devices and processes: the same bits as on one."""

import os
import subprocess
import sys
import tempfile
import time

import jax
import jax.numpy as jnp
import pytest

import jaxrb as rb
from jaxrb.errors import WrongStructure

_WORLDS = """
import sys, warnings
import jax, numpy as np
import jaxrb as rb

def world(i, drag=0.1):
    effects = (rb.UniformGravity(), rb.LinearDrag(drag)) if i % 2 else (rb.UniformGravity(),)
    scene = rb.Scene(rb.Body(1.0 + i, (1.0, 2.0, 2.5)), effects)
    return scene, scene.state(angular_velocity=(0.1 * i, 1.0, 0.2))

def run(worlds, **options):
    return rb.rollout_worlds(worlds, dt=0.02, steps=40, save_every=10, **options)

def alike(one, other):
    pairs = zip(jax.tree.leaves(list(one)), jax.tree.leaves(list(other)), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)
"""

_DEVICES = """
worlds = [world(i) for i in range(19)]
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    many = run(worlds, sharding=jax.make_mesh((8,), ("worlds",)))
print(jax.device_count(), alike(run(worlds), many), [str(w.message)[:70] for w in said])
"""

_PROCESSES = """
number, address = int(sys.argv[1]), sys.argv[2]
jax.distributed.initialize(address, 2, number, coordinator_bind_address=address)
mesh = jax.make_mesh((jax.device_count(),), ("worlds",))
worlds = [world(i) for i in range(8)]  # two a device: of one the compiler may round the last digit otherwise
print(jax.process_count(), alike(run(worlds), run(worlds, sharding=mesh)))
try:
    run([world(0), world(1, 0.1 + number)], sharding=mesh)
except rb.JaxrbError as error:
    print(type(error).__name__, error)
"""

_LONG = """
number, address = int(sys.argv[1]), sys.argv[2]
jax.distributed.initialize(address, 2, number, coordinator_bind_address=address, heartbeat_timeout_seconds=5)
mesh = jax.make_mesh((jax.device_count(),), ("worlds",))
run([world(2 * i) for i in range(4)], sharding=mesh)
print("running", flush=True)
scenes = [world(2 * i) for i in range(4)]
rb.rollout_worlds(scenes, dt=1e-6, steps=2_000_000_000, save_every=2_000_000_000, sharding=mesh)
"""


def start(program, *arguments, flags=""):
    command = [sys.executable, "-W", "ignore", "-c", _WORLDS + program, *arguments]
    environment = {**os.environ, "XLA_FLAGS": flags}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ended(process):
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out


def test_eight_devices_give_the_bits_of_one_and_say_what_they_add():
    """Bad input [49]: a batch that does not divide by the devices."""
    out = ended(start(_DEVICES, flags="--xla_force_host_platform_device_count=8"))
    assert out.startswith("8 True")
    # Ten worlds of one structure and nine of the other.
    assert "10 worlds of one structure over 8 devices: 6 copies" in out
    assert "9 worlds of one structure over 8 devices: 7 copies" in out


@pytest.fixture
def addresses():
    """Sockets in the file system, nobody else's: a port seen free may be another's a moment later, which happened."""
    with tempfile.TemporaryDirectory() as place:  # a short path: a socket's is 107 characters at most
        yield [f"unix:{place}/{number}" for number in range(2)]


def test_a_killed_process_ends_the_other_soon_and_says_how_to_go_on(addresses):
    """Killed: the second, and the first, in which JAX's service runs."""
    pairs = []
    for lost, where in zip((1, 0), addresses, strict=True):
        pairs.append((lost, [start(_LONG, str(number), where) for number in range(2)]))
    try:
        for _, both in pairs:
            for process in both:
                while "running" not in process.stdout.readline():
                    assert process.poll() is None, process.stderr.read()
        time.sleep(1.0)  # within the run, not before it
        killed = time.monotonic()
        for lost, both in pairs:
            both[lost].kill()
        for lost, both in pairs:
            _, told = both[1 - lost].communicate(timeout=60)
            assert time.monotonic() - killed < 15.0
            assert both[1 - lost].returncode != 0
            assert f"process {1 - lost} of 2" in told
            assert "Start all of them again" in told
    finally:
        for _, both in pairs:
            for process in both:
                process.kill()
                process.communicate()


def test_two_processes_give_the_bits_of_one_and_must_agree_on_the_worlds(addresses):
    both = [start(_PROCESSES, str(number), addresses[0]) for number in range(2)]
    for process in both:
        lines = [line for line in ended(process).splitlines() if not line.startswith("[Gloo]")]
        assert lines[0] == "2 True"
        assert lines[1].startswith(
            "InvalidInput rollout_worlds: the worlds of process 0 differ from those of [1]"
        )


def test_sharded_worlds_can_be_differentiated_inside_a_program(dtype):
    body = rb.Body(1.0, (1.0, 2.0, 2.5))
    scene = rb.Scene(body, rb.UniformGravity())
    mesh = jax.make_mesh((1,), ("worlds",))

    def height(speed, sharding):
        worlds = [(scene, scene.state(velocity=(0.0, 0.0, factor * speed))) for factor in (1.0, 2.0)]
        paths = rb.rollout_worlds(worlds, dt=0.05, steps=4, sharding=sharding, on_error="flag")
        return sum(path.final.position[0, 2] for path in paths)

    given = jnp.asarray(0.3, dtype)
    slope = jax.jit(jax.grad(lambda speed: height(speed, mesh)))(given)
    assert slope == pytest.approx(3 * 0.2, rel=1e-5)


def test_what_is_no_mesh_is_refused():
    scene = rb.Scene(rb.Body(1.0, 1.0))
    with pytest.raises(WrongStructure, match="make_mesh"):
        rb.rollout_worlds([(scene, scene.state())], dt=0.1, steps=1, sharding="all")
