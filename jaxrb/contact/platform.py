"""On what kind of device a program will run."""

import jax


def on_accelerator() -> bool:
    """Whether all lanes of a `vmap` run side by side, so that loops over them would only wait."""
    return jax.default_backend() != "cpu"
