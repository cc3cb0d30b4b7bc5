"""The same bits: in fresh processes, and of a world whatever the batch around it.

JAXRB_PROCESSES=20 asks so many processes; JAXRB_LONG=1 asks of contact too. Both print what they found.
"""

import os
import pathlib
import subprocess
import sys

import jax
import numpy as np
import same_bits

CONTACT = os.environ.get("JAXRB_LONG") == "1"


def test_fresh_processes_give_the_same_bits():
    count = int(os.environ.get("JAXRB_PROCESSES", "3"))
    program = pathlib.Path(same_bits.__file__)
    environment = {**os.environ, "JAX_ENABLE_X64": "1" if jax.config.jax_enable_x64 else "0"}
    found = set()
    command = [sys.executable, str(program), *(["contact"] if CONTACT else [])]
    for _ in range(count):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found.add(done.stdout.strip())
    print(f"{count} processes, {len(found)} different results: {found}")
    assert len(found) == 1
    assert len(next(iter(found)).split()) == 1 + CONTACT


def differing(batches, which):
    """Largest difference of world 0 between batches, in units of the last place of the largest number of each array."""
    worst = 0.0
    first, *others = [jax.tree.leaves(batch[which]) for batch in batches]
    for other in others:
        for a, b in zip(first, other, strict=True):
            a, b = np.asarray(a)[0], np.asarray(b)[0]
            worst = max(worst, float(np.max(np.abs(a - b)) / np.spacing(np.max(np.abs(a)) + 1e-3)))
    return worst


def test_a_world_has_the_same_bits_in_any_batch_of_free_bodies():
    """Asked of contact too; there it was measured, and is not promised: a solve is stopped for a whole batch."""
    batches = [same_bits.ends(CONTACT, worlds) for worlds in (1, 3, 8)]
    found = [differing(batches, which) for which in range(1 + CONTACT)]
    print(f"units of the last place by which a world differs from batch to batch: {found}")
    assert found[0] == 0.0
