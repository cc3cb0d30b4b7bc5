"""Values that a reverse pass keeps instead of finding them again: answers of searches and loops."""

from typing import Any

import jax
from jax.ad_checkpoint import checkpoint_name

_NAME = "jaxrb: found"

# For `jax.checkpoint`: keeps what is `kept`, and forms all else anew.
KEEP_FOUND = jax.checkpoint_policies.save_only_these_names(_NAME)


def kept(found: Any) -> Any:
    """The same tree of arrays, by a name that `KEEP_FOUND` knows."""
    return jax.tree.map(lambda leaf: checkpoint_name(leaf, _NAME), found)
