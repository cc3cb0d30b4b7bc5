"""Recordings that come with jaxrb."""

from pathlib import Path

# Simulated, so that the truth is known; `jaxrb.data.make_tumbling_brick` says how.
TUMBLING_BRICK = Path(__file__).with_name("tumbling_brick.npz")
