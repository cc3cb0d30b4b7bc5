"""Names by which other floors know parts of the contact solve."""

# What a reverse pass may keep of each step (`jax.ad_checkpoint.checkpoint_name`).
SOLVED = "contact solved"
