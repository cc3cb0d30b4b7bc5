"""What `smoothed_gradient` gives: the gradient of a blurred loss, how well it is known, and its bias."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrb.math.arrays import Array, Scalar

INTERPOLATED = "interpolated"


class SmoothedGradient(eqx.Module):
    """The gradient of the smoothed loss E f(x + s z), estimated from `samples`; not the gradient of f.

    * `gradient`, `standard_error`: trees like `at`, None for leaves that are no floating arrays.
      At "interpolated" the error is that of chance alone: `share` · `bias` comes on top.
    * `value` ± `value_error`: the smoothed loss.
    * `bias`, `bias_error`: what the first-order estimate is off the zeroth-order one of the same samples, and the
      standard error of that; trees, None at order 0, which has none. Several errors of bias mean that the loss jumps.
    * `share`: of the first-order estimate in the gradient. `not_finite`: samples of which loss or gradient are not.
    """

    gradient: Any
    standard_error: Any
    value: Scalar
    value_error: Scalar
    bias: Any
    bias_error: Any
    share: Scalar
    not_finite: Array
    order: int | str = eqx.field(static=True)
    samples: int = eqx.field(static=True)

    @property
    def relative_error(self) -> Scalar:
        """Length of the standard error over that of the gradient, all leaves in their own units."""
        return _length(self.standard_error) / _length(self.gradient)

    def as_dict(self) -> dict[str, Any]:
        """Plain data, leaf by leaf."""
        parts = {"gradient": self.gradient, "standard_error": self.standard_error, "bias": self.bias,
                 "bias_error": self.bias_error}  # fmt: skip
        found: dict[str, Any] = {
            "order": self.order,
            "samples": self.samples,
            "share_of_first_order": float(self.share),
        }
        found |= {"value": float(self.value), "value_error": float(self.value_error)}
        for name, tree in parts.items():
            leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
            found[name] = {jax.tree_util.keystr(path): np.asarray(leaf).tolist() for path, leaf in leaves}
        return found

    def summary(self) -> str:
        """The estimate in words: what it is the gradient of, how well it is known, how far its parts disagree."""
        kind = f"interpolated: {float(self.share):.2f} of first order"
        if self.order != INTERPOLATED:
            kind = "first order: mean of gradients" if self.order else "zeroth order: values alone"
        lines = [
            f"Smoothed gradient ({kind}), {self.samples} samples: of the loss blurred by noise, not of the loss.",
            f"Smoothed loss {float(self.value):.6g} ± {float(self.value_error):.1g}.",
        ]
        rows = jax.tree_util.tree_flatten_with_path(self.gradient)[0]
        for (path, leaf), error in zip(rows, jax.tree.leaves(self.standard_error), strict=True):
            slope, off = (
                np.array2string(
                    np.asarray(x), formatter={"float_kind": lambda v, digits=digits: f"{v:.{digits}g}"}
                )
                for x, digits in ((leaf, 5), (error, 2))
            )
            lines.append(f"  {jax.tree_util.keystr(path) or 'value'}: {slope} ± {off}")
        if self.bias is not None:
            off, error = float(_length(self.bias)), float(_length(self.bias_error))
            means = "the loss jumps within the noise" if off > 4.0 * error else "no more than chance"
            lines.append(f"  First order less zeroth order: {off:.3g}, known to {error:.1g}: {means}.")
        return "\n".join(lines)


def _length(tree: Any) -> Scalar:
    return jnp.sqrt(sum(jnp.sum(jnp.asarray(leaf) ** 2) for leaf in jax.tree.leaves(tree)))
