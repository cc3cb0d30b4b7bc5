"""Values computed once and kept, under any number of vmaps.

XLA forms a value again in every loop that reads it where it finds that cheap, and takes whole stages for cheap: two
boxes then cost twice as much. `lax.optimization_barrier` does not stop it; a branch that it cannot foresee does. But
`vmap` turns a branch on a mapped value into a choice between both sides, so here the branch is
put in when the program is lowered, when all axes are known.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

settled_p = Primitive("settled")
settled_p.multiple_results = True


def settled(values: Any) -> Any:
    """The same tree of arrays; what is formed from it reads memory and not the formulas behind it."""
    leaves, structure = jax.tree.flatten(values)
    return jax.tree.unflatten(structure, settled_p.bind(*leaves))


def _stored(*leaves: jax.Array) -> Sequence[jax.Array]:
    probe = leaves[0].ravel()[0]
    return lax.cond(
        (probe <= 0) | ~(probe <= 0), lambda x: x, lambda x: jax.tree.map(jnp.zeros_like, x), leaves
    )


def _some(function: Any, values: Sequence[Any]) -> list[Any]:
    """A function of several arrays applied to those that are numbers, leaving symbolic zeros as they are."""
    # Whole numbers have tangents of no type, which are nothing to store.
    real = [type(v) is not ad.Zero and getattr(v, "dtype", None) != jax.dtypes.float0 for v in values]
    if not any(real):
        return list(values)
    done = iter(function(*(v for v, one in zip(values, real) if one)))
    return [next(done) if one else v for v, one in zip(values, real)]


def _jvp(values: Sequence[Any], tangents: Sequence[Any]) -> tuple[Any, Any]:
    # Derivatives grow out of the same stages and have the same trouble: 200 s of compiling instead of 15.
    return settled_p.bind(*values), _some(settled_p.bind, tangents)


def _transpose(cotangents: Sequence[Any], *values: Any) -> list[Any]:
    return _some(settled_p.bind, cotangents)


def _batch(values: Sequence[Any], axes: Sequence[Any]) -> tuple[Any, Any]:
    return settled_p.bind(*values), list(axes)


settled_p.def_impl(jax.jit(_stored))
settled_p.def_abstract_eval(lambda *avals: list(avals))
mlir.register_lowering(settled_p, mlir.lower_fun(_stored, multiple_results=True))
ad.primitive_jvps[settled_p] = _jvp
ad.primitive_transposes[settled_p] = _transpose
batching.primitive_batchers[settled_p] = _batch
