"""Print a hash of the end of runs, of free bodies and with contact: for fresh processes to be compared.

python same_bits.py          of free bodies
python same_bits.py contact  with contact too, which compiles for ten seconds
"""

import hashlib
import pathlib
import sys

import jax
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
import long_run_scene
from rotation_samples import QUICK

import jaxrb as rb


def digest(tree):
    """SHA-256 of every bit."""
    found = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        found.update(np.asarray(leaf).tobytes())
    return found.hexdigest()


def ends(contact, worlds=None):
    """The ends of the runs; of `worlds` equal but for their spins, in one batch."""
    found = []
    for scene, state in (long_run_scene.free(), *([long_run_scene.touching()] if contact else [])):

        def run(spin, scene=scene, state=state):
            start = rb.body.State(state.position, state.orientation, state.velocity, spin, state.time)
            return rb.rollout(scene, start, dt=1e-3, steps=60, save_every=60, on_error="flag").final

        if worlds is None:
            found.append(jax.jit(run, compiler_options=QUICK)(state.angular_velocity))
            continue
        spins = np.stack([np.asarray(state.angular_velocity) * (1 + 0.125 * k) for k in range(worlds)])
        found.append(jax.jit(jax.vmap(run), compiler_options=QUICK)(spins))
    return found


if __name__ == "__main__":
    print(*map(digest, ends("contact" in sys.argv[1:])))
