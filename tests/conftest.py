"""Precision, tolerances and exact answers shared by all tests.

The precision of a run is JAX's own flag: with JAX_ENABLE_X64=1 in the environment everything runs in float64, without
it in float32. Every test runs in both; its tolerances are keyed by the type.

With JAXRB_CHECK_SHAPES=1 in the environment every annotated shape in jaxrb is checked by beartype at each call.
"""

import gc
import os
import pathlib

import jax
import jax.numpy as jnp
import pytest

if os.environ.get("JAXRB_CHECK_SHAPES") == "1":
    # Before anything of jaxrb is imported, or the hook finds its modules already loaded and checks nothing.
    from jaxtyping import install_import_hook

    install_import_hook("jaxrb", "shape_checks.checked")
    # There numbers of wrong shapes are given on purpose; beartype would refuse them before jaxrb can say why.
    collect_ignore_glob = ["test_bad_inputs_*.py"]

ORACLE = pathlib.Path(__file__).resolve().parent.parent.parent / "shared" / "oracle"


# Each compiled program keeps dozens of mappings of memory, of which Linux gives a process 65530; with none left, the
# compiler ends it by a segmentation fault.
_MAPPINGS = pathlib.Path("/proc/self/maps")
_MANY = 20_000


@pytest.fixture(scope="module", autouse=True)
def programs():
    """Forgets the programs of earlier files before they are too many for one process."""
    yield
    if _MAPPINGS.exists() and _MAPPINGS.read_bytes().count(b"\n") > _MANY:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(scope="session")
def dtype():
    """The floating type of this run."""
    return jnp.float64 if jax.config.jax_enable_x64 else jnp.float32


@pytest.fixture(scope="session")
def tolerance(dtype):
    """`tolerance(float64=…, float32=…)`: the one that holds in this run."""

    def of_this_run(*, float64: float, float32: float) -> float:
        return float64 if dtype == jnp.float64 else float32

    return of_this_run


@pytest.fixture(scope="session")
def oracle():
    """Folder of exact answers; they are large and not part of the repository."""
    if not ORACLE.is_dir():
        pytest.skip("the exact answers (shared/oracle next to the repository) are not here")
    return ORACLE
